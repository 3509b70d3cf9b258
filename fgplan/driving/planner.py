"""`Planner`: the object that a robot program holds. Observation in, decision out."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from fgplan.backend import fastest
from fgplan.crowd import Belief, heading, seen, visible
from fgplan.driving.deliberation import Deliberation
from fgplan.driving.following import action_of, at_start_of, halt, shifted, standing
from fgplan.driving.guard import Guarded, Judge, Tier
from fgplan.driving.memory import Memory
from fgplan.driving.observation import Decision, Observation, Outcome
from fgplan.driving.operating import Operated
from fgplan.driving.pricing import update as update_blockages
from fgplan.driving.progress import progressed
from fgplan.driving.proposals import price, propose, route_of
from fgplan.driving.routing import Routes
from fgplan.driving.settings import Settings
from fgplan.driving.tracking import People, Tracker
from fgplan.errors import NoPlan
from fgplan.hypothesis import Hypothesis
from fgplan.mixture import Component, Mixture
from fgplan.obeying import closed
from fgplan.planner import plan
from fgplan.safety import People as Expected
from fgplan.scenario import Robot, Scenario
from fgplan.shared_control import Lead, pointed
from fgplan.trajectory import Trajectory
from fgplan.validation import validate

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

Source = Callable[[Scenario, Belief], Sequence[Hypothesis]]
"""Hypotheses beside the routes: their `log_prior` stands beside −β (J_i − min J) of those."""

FIXED = 1e-6
"""Variance of a position that is known [m²]."""
LAST_WORD = 0.15
"""Share of a deadline that is kept for the guard."""
LEAST = 0.2
"""Share of a deadline that a plan has, however long all before it took."""
STANDS = 0.05
"""A robot that is to move less than this in the next second waits [m]."""


class Planner:
    """Drives one robot: `step` takes what is seen now and returns what to do now.

    Args:
        scenario: Robot, goal, map, field of view and density to begin with; its tracks are the
            people seen before the first observation.
        settings: Everything else.
        sources: Hypotheses beside the routes, e.g. `CandidateGoals` where no goal is known.

    Raises:
        ScenarioError: the scenario makes no sense; all mistakes are named.
    """

    def __init__(
        self,
        scenario: Scenario,
        settings: Settings = Settings(),  # noqa: B008 - frozen
        sources: Sequence[Source] = (),
    ) -> None:
        validate(scenario)
        fastest()  # loaded before there is a deadline
        self.settings = settings
        self.sources = tuple(sources)
        d = scenario.density
        self._tracker = Tracker(d.Qc_people, d.sigma_track, d.sigma_speed, settings.tracking)
        self.memory = Memory(
            scenario.replace(tracks=(), data=()),
            people=self._tracker.recall(seen(scenario), scenario.now),
            operated=Operated(waiting=scenario.data),
        )

    def step(self, observation: Observation) -> Decision:
        """What to do until the next step. It never raises: what goes wrong is a stop that says so.

        Args:
            observation: What is known now.
        """
        began = perf_counter()
        try:
            decision, self.memory = self._decide(self.memory, observation, began)
        except Exception as error:  # a robot must stop, whatever is wrong with its planner
            why = f"{type(error).__name__}: {error}"
            decision = halt(self.memory, self.settings, Outcome.NO_VALID_CONTROL, why)
        mission = self.memory.scenario.mission
        return replace(decision, seconds=perf_counter() - began, mission=mission)

    def _decide(
        self, memory: Memory, observation: Observation, began: float
    ) -> tuple[Decision, Memory]:
        settings, robot = self.settings, memory.scenario.robot
        problem = settings.intake.problem(
            observation, memory.observation, robot.max_speed, memory.jumped
        )
        if problem is not None:
            memory = replace(memory, jumped="jumped" in problem)
            return self._carry_on(memory, observation, problem)
        observation, repairs = settings.intake.repaired(observation, robot.max_speed)
        scenario = _now(memory.scenario, observation, settings.period)
        known = memory.observation is not None and not memory.jumped
        came_from = memory.scenario.robot.position if known else None
        mission, unknown = progressed(scenario, came_from, observation.facts)
        elsewhere = not np.array_equal(scenario.goal, memory.scenario.goal)  # type: ignore[arg-type]
        further = elsewhere or mission != scenario.mission
        scenario = scenario.replace(mission=mission)
        operated, doubts = memory.operated.hear(observation.operator, scenario)
        scenario = scenario.replace(data=operated.data)
        people, refused = self._look(memory, scenario, observation)
        belief = people.belief(scenario.density.Qc_people)
        memory = replace(
            memory,
            scenario=scenario,
            observation=observation,
            people=people,
            operated=operated,
            mixture=None if memory.jumped else memory.mixture,
            jumped=False,
            nearest=(np.inf, -np.inf) if further else memory.nearest,
            deliberation=Deliberation(memory.followed, scenario.now)
            if further
            else memory.deliberation,
        )
        repairs += (*unknown, *refused, *doubts)
        if _reached(scenario, settings):
            what = "goal reached" if mission is None else "mission done"
            return self._rest(memory, belief, Outcome.GOAL_REACHED, what, repairs)
        before = memory.routes
        routes = before.update(scenario, settings.routing, memory.followed)
        memory = replace(memory, routes=routes)
        if routes.trouble is not None:
            outcome = Outcome(routes.trouble.code)
            return self._rest(memory, belief, outcome, str(routes.trouble), repairs)
        memory = self._price(memory, belief)
        return self._plan(memory, before, belief, repairs, began)

    def _look(
        self, memory: Memory, scenario: Scenario, observation: Observation
    ) -> tuple[People, tuple[str, ...]]:
        """The people after this look; whom the robot cannot see is not taken from a detector."""
        sees = _sight(scenario)
        detections = observation.detections
        if detections:
            mask = sees(np.array([d.position for d in detections], dtype=float))
            detections = tuple(d for d, seen in zip(detections, mask, strict=True) if seen)
        people = memory.people
        if memory.observation is None and observation.time < people.time:
            people = People(time=observation.time)  # on another clock
        return self._tracker.update(people, observation.time, detections, sees)

    def _price(self, memory: Memory, belief: Belief) -> Memory:
        blockages = update_blockages(
            memory.blockages,
            memory.scenario,
            belief,
            memory.routes.ways,
            self.settings.pricing,
            _sight(memory.scenario),
        )
        return replace(memory, blockages=blockages)

    def _plan(
        self,
        memory: Memory,
        before: Routes,
        belief: Belief,
        repairs: tuple[str, ...],
        began: float,
    ) -> tuple[Decision, Memory]:
        settings, scenario = self.settings, memory.scenario

        ways = [
            (way, price(way, scenario, belief, memory.blockages, settings.pricing))
            for way in memory.routes.ways
        ]
        operated = memory.operated.branched(memory.routes.ways, scenario.now, memory.followed)
        if scenario.data:
            leads = [Lead(way.path, cost.total) for way, cost in ways]
            operated = operated.seek(scenario, leads, settings.routing)
        proposed: list[Hypothesis] = []
        commitment = memory.deliberation.commitment(
            settings.commitment, scenario.now, settings.deliberation
        )

        def hypotheses(scenario: Scenario, belief: Belief) -> Sequence[Hypothesis]:
            others = [h for source in self.sources for h in source(scenario, belief)]
            if scenario.data:
                known = leads + [Lead(h.route, h.cost) for h in others if h.route is not None]
                via = operated.via[0]
                others += pointed(scenario, belief, known, None if via is None else via.path)
            found = propose(
                scenario,
                belief,
                ways,
                memory.followed,
                commitment,
                settings.wait,
                others,
                settings.starts,
            )
            proposed.extend(found)
            return operated.recalled(found, scenario.now, memory.followed)

        def heard(components: Sequence[Component]) -> tuple[Deliberation, Array]:
            scores = settings.select(components)
            deliberation = memory.deliberation.heard(
                components, scores, scenario.now, commitment, settings.deliberation
            )
            return deliberation, deliberation.steadied(components, scores, commitment)

        judge = self._judge(scenario, belief)
        left = None
        if settings.deadline is not None:
            left = (1 - LAST_WORD) * settings.deadline - (perf_counter() - began)
            left = max(left, LEAST * settings.deadline)
        try:
            mixture = plan(
                scenario,
                belief=belief,
                hypotheses=hypotheses,
                solver=settings.solver,
                select=lambda components: heard(components)[1],
                inference=settings.inference,
                warm=memory.mixture,
                deadline=left,
                check=judge.check,
            )
        except NoPlan as error:
            memory = replace(memory, mixture=None)
            return self._rest(memory, belief, Outcome.NO_VALID_CONTROL, str(error), repairs)
        chosen = _chosen(mixture, judge)
        safe = judge.command(chosen.robot, _expected(chosen, judge))
        known = {way.label for way in memory.routes.ways}
        label = _taken(chosen.label, safe.tier, memory.followed, known)
        driven = chosen.robot if safe.tier <= Tier.TOUCHING_NOBODY else safe.trajectory
        outcome, reason = self._outcome(memory, before, chosen, safe, label)
        nearest = _progress(memory, scenario)
        deliberation, _ = heard(mixture.components)
        operated, intent = operated.note(proposed, scenario, label).understand(
            mixture, scenario, driven
        )
        decision = Decision(
            time=scenario.now,
            action=action_of(scenario, safe, reason),
            outcome=outcome,
            reason=reason,
            trajectory=driven,
            mixture=mixture,
            label=label,
            repairs=repairs,
            intent=intent,
        )
        memory = replace(
            memory,
            operated=operated,
            mixture=mixture,
            trajectory=driven,
            started=scenario.now,
            followed=label,
            deliberation=deliberation.following(label, scenario.now),
            nearest=nearest,
        )
        return decision, memory

    def _outcome(
        self, memory: Memory, before: Routes, chosen: Component, safe: Guarded, label: str
    ) -> tuple[Outcome, str]:
        """How the step ended, and why."""
        why = f"hypothesis {chosen.label}, {chosen.start}"
        if not chosen.feasible:
            why = f"no hypothesis is safe ({'; '.join(chosen.check.problems)})"
        if safe.tier is Tier.LATEST_CONTACT:
            stops = np.linalg.norm(safe.trajectory.velocities[safe.step]) < STANDS
            outcome = Outcome.STOPPED if stops else Outcome.NO_VALID_CONTROL
            return outcome, f"{why}; no command is clear of people (in {safe.contact:.1f} s)"
        if safe.tier is Tier.AVOIDING:
            why += "; its command is not clear: the nearest clear one"
        if safe.tier is Tier.YIELDING:
            why += f"; no command is clear: at rest before somebody comes in {safe.contact:.1f} s"
        if safe.tier is Tier.PASSING:
            why += "; no stop is clear, but to go on is"
        if memory.followed is not None and label != memory.followed:
            known = any(way.label == memory.followed for way in before.ways)
            gone = not any(way.label == memory.followed for way in memory.routes.ways)
            if known and gone:
                return Outcome.REPLANNING, f"{memory.followed} leads on no longer; {why}"
            return Outcome.SWITCHING, f"from {memory.followed}; {why}"
        soon = chosen.robot.at(1.0)[:2]
        if np.linalg.norm(soon - memory.scenario.robot.position) < STANDS:
            return Outcome.WAITING, why
        since = _progress(memory, memory.scenario)[1]
        if memory.scenario.now - since > self.settings.stall:
            return (
                Outcome.NO_PROGRESS,
                f"no nearer to the goal for {self.settings.stall:g} s; {why}",
            )
        return Outcome.FOLLOWING, why

    def _carry_on(
        self, memory: Memory, observation: Observation, problem: str
    ) -> tuple[Decision, Memory]:
        """Without a usable observation: the last safe plan goes on, or the robot stops."""
        settings, last = self.settings, memory.observation
        if last is None or memory.trajectory is None:
            return halt(memory, settings, Outcome.BAD_OBSERVATION, problem), memory
        # A clock that stands, runs back or is none at all says that one more period is over.
        since = observation.time - memory.started
        if not 0 < since < np.inf:
            since = settings.period
        ahead = shifted(memory.trajectory, since, memory.scenario.density.times)
        scenario = memory.scenario.replace(
            robot=at_start_of(ahead, memory.scenario.robot), now=memory.started + since
        )
        belief = self._tracker.predict(memory.people, scenario.now).belief(
            scenario.density.Qc_people
        )
        late = scenario.now - last.time > settings.blind
        safe = self._guarded(scenario, belief, standing(scenario) if late else ahead)
        reason = f"{problem}; {'the robot stops' if late else 'the last plan goes on'}"
        decision = Decision(
            time=scenario.now,
            action=action_of(scenario, safe, reason),
            outcome=Outcome.BAD_OBSERVATION,
            reason=reason,
            trajectory=safe.trajectory,
            label=memory.followed,
            repairs=(problem,),
        )
        driven = safe.trajectory if late or safe.tier > Tier.TOUCHING_NOBODY else ahead
        return decision, replace(memory, trajectory=driven, started=scenario.now)

    def _rest(
        self,
        memory: Memory,
        belief: Belief,
        outcome: Outcome,
        reason: str,
        repairs: tuple[str, ...],
    ) -> tuple[Decision, Memory]:
        """Come to rest, or stay at it, and keep out of the way of nobody's feet."""
        scenario = memory.scenario
        safe = self._guarded(scenario, belief, standing(scenario))
        decision = Decision(
            time=scenario.now,
            action=action_of(scenario, safe, reason),
            outcome=outcome,
            reason=reason,
            trajectory=safe.trajectory,
            label=memory.followed,
            repairs=repairs,
        )
        return decision, replace(memory, trajectory=safe.trajectory, started=scenario.now)

    def _judge(self, scenario: Scenario, belief: Belief) -> Judge:
        settings = self.settings
        return Judge(closed(scenario), belief, settings.period, settings.guard, settings.lag)

    def _guarded(self, scenario: Scenario, belief: Belief, wanted: Trajectory) -> Guarded:
        """A trajectory among people as they are predicted."""
        times = scenario.density.times
        predicted = Expected(times, belief.predict(times)[0], belief.radii)
        return self._judge(scenario, belief).command(wanted, predicted)


def _now(scenario: Scenario, observation: Observation, period: float) -> Scenario:
    """What is known, with what an observation changes of it."""
    covariance, most = observation.covariance, scenario.robot.max_speed
    if covariance is None and scenario.robot.max_acceleration * period >= 2 * most:
        # Every velocity is reached within a period: a plan begins with the one it likes.
        covariance = np.diag([FIXED, FIXED, most**2, most**2])
    robot: Robot = replace(
        scenario.robot,
        position=np.asarray(observation.position, dtype=float),
        velocity=np.asarray(observation.velocity, dtype=float),
        heading=observation.heading,
        yaw_rate=float(observation.yaw_rate),
        covariance=covariance,
    )
    changes = {"robot": robot, "now": float(observation.time)}
    if observation.grid is not None:
        changes["grid"] = observation.grid
    if observation.goal is not None:
        changes["goal"] = np.asarray(observation.goal, dtype=float)
    return scenario.replace(**changes)


def _sight(scenario: Scenario) -> Callable[[Array], Mask]:
    """Which points the robot would see somebody at."""

    def sees(points: Array) -> Mask:
        if scenario.field_of_view is None:
            return np.ones(len(points), dtype=bool)
        return visible(
            scenario.field_of_view,
            scenario.robot.position,
            heading(scenario),
            points,
            scenario.grid,
        )

    return sees


def _reached(scenario: Scenario, settings: Settings) -> bool:
    if scenario.mission is not None and not scenario.mission.done:
        return False
    if scenario.goal is None:
        return scenario.mission is not None
    return float(np.hypot(*(scenario.goal - scenario.robot.position))) <= settings.goal_tolerance


def _chosen(mixture: Mixture, judge: Judge) -> Component:
    """The selected component; where none is safe, the one that is safe longest.

    A route is left for a more probable one, not because the next command on it is not clear while
    another command near it is: else robot and people who meet would flip the route at every step.
    """
    best = mixture.best
    if best is None:
        return max(mixture.components, key=lambda c: c.check.first_contact)
    if best.check.clear or judge.command(best.robot, _expected(best, judge)).tier is Tier.AVOIDING:
        return best
    return next((c for c in mixture.components if c.check.clear), best)


def _taken(label: str, tier: Tier, followed: str | None, known: Collection[str]) -> str:
    """The route that a step takes; who only gets out of the way takes no other one."""
    if followed is not None and followed in known and tier > Tier.AVOIDING:
        return followed
    return route_of(label, followed)


def _expected(component: Component, judge: Judge) -> Expected:
    """The people of a plan."""
    times, radii = judge.scenario.density.times, judge.belief.radii
    if not component.crowd:
        return Expected(times, np.zeros((len(times), 0, 4)), radii)
    states = np.stack([person.states for person in component.crowd.values()], axis=1)
    return Expected(times, states, radii)


def _progress(memory: Memory, scenario: Scenario) -> tuple[float, float]:
    """Shortest way to the goal so far, and when."""
    if (scenario.goal is None and scenario.mission is None) or not memory.routes.ways:
        return np.inf, scenario.now
    length = min(way.to_go for way in memory.routes.ways)
    best, when = memory.nearest
    return (length, scenario.now) if length < best - 0.1 else (best, max(when, -np.inf))
