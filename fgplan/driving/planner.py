"""`Planner`: the object that a robot program holds. Observation in, decision out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import Belief, heading, visible
from fgplan.driving.guard import Guarded, Others, Tier, guard
from fgplan.driving.observation import Decision, Observation, Outcome
from fgplan.driving.pricing import Blockage
from fgplan.driving.pricing import update as update_blockages
from fgplan.driving.proposals import price, propose, route
from fgplan.driving.routing import Routes
from fgplan.driving.settings import Settings
from fgplan.driving.tracking import People, Tracker
from fgplan.errors import NoPlan
from fgplan.hypothesis import Hypothesis
from fgplan.mixture import Action, Component, Mixture
from fgplan.planner import plan
from fgplan.scenario import Robot, Scenario
from fgplan.trajectory import Trajectory
from fgplan.validation import validate

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

Source = Callable[[Scenario, Belief], Sequence[Hypothesis]]
"""Hypotheses beside the routes: their `log_prior` stands beside −β (J_i − min J) of those."""

STANDS = 0.05
"""A robot that is to move less than this in the next second waits [m]."""


@dataclass(frozen=True, eq=False)
class Memory:
    """What one step leaves for the next one.

    Args:
        scenario: What was known.
        observation: The last one that was believed; None before the first.
        people: Everybody who is followed.
        routes: The global plans.
        blockages: Where people stood in the way.
        mixture: The last plan, for a warm start.
        trajectory: What is being driven, from `observation.time` on.
        followed: Name of the hypothesis that is followed.
        jumped: Whether the last observation was refused because the robot jumped.
        nearest: Shortest way to the goal so far [m], and when it was reached [s].
    """

    scenario: Scenario
    observation: Observation | None = None
    people: People = field(default_factory=People)
    routes: Routes = field(default_factory=Routes)
    blockages: tuple[Blockage, ...] = ()
    mixture: Mixture | None = None
    trajectory: Trajectory | None = None
    followed: str | None = None
    jumped: bool = False
    nearest: tuple[float, float] = (np.inf, -np.inf)


class Planner:
    """Drives one robot: `step` takes what is seen now and returns what to do now, for hours.

    Args:
        scenario: Robot, goal, map, field of view and density to begin with; its tracks are not
            used, people come with the observations.
        settings: Everything else.
        sources: Hypotheses beside the routes, e.g. where an operator points.

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
        self.settings = settings
        self.sources = tuple(sources)
        self.memory = Memory(scenario.replace(tracks=()))
        d = scenario.density
        self._tracker = Tracker(d.Qc_people, d.sigma_track, d.sigma_speed, settings.tracking)

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
            decision = _halt(self.memory, self.settings, Outcome.NO_VALID_CONTROL, why)
        return replace(decision, seconds=perf_counter() - began)

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
        scenario = _now(memory.scenario, observation)
        people, refused = self._look(memory, scenario, observation)
        belief = people.belief(scenario.density.Qc_people)
        memory = replace(
            memory,
            scenario=scenario,
            observation=observation,
            people=people,
            mixture=None if memory.jumped else memory.mixture,
            jumped=False,
            nearest=memory.nearest if observation.goal is None else (np.inf, -np.inf),
        )
        repairs += refused
        if _reached(scenario, settings):
            return self._rest(memory, belief, Outcome.GOAL_REACHED, "goal reached", repairs)
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
        if memory.observation is None:
            people = replace(people, time=observation.time)
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

        def hypotheses(scenario: Scenario, belief: Belief) -> Sequence[Hypothesis]:
            ways = [
                (way, price(way, scenario, belief, memory.blockages, settings.pricing))
                for way in memory.routes.ways
            ]
            others = [h for source in self.sources for h in source(scenario, belief)]
            return propose(
                scenario,
                belief,
                ways,
                memory.followed,
                settings.commitment,
                settings.wait,
                others,
            )

        left = None
        if settings.deadline is not None:
            left = max(settings.deadline - (perf_counter() - began), 0.2 * settings.deadline)
        try:
            mixture = plan(
                scenario,
                belief=belief,
                hypotheses=hypotheses,
                solver=settings.solver,
                select=settings.select,
                inference=settings.inference,
                warm=memory.mixture,
                deadline=left,
            )
        except NoPlan as error:
            memory = replace(memory, mixture=None)
            return self._rest(memory, belief, Outcome.NO_VALID_CONTROL, str(error), repairs)
        chosen = _chosen(mixture)
        others = Others(
            scenario.density.times,
            np.stack([person.states for person in chosen.crowd.values()], axis=1)
            if chosen.crowd
            else np.zeros((len(scenario.density.times), 0, 4)),
            belief.radii,
        )
        safe = guard(
            scenario, belief, chosen.robot, others, settings.period, settings.guard, settings.lag
        )
        label = _route_of(chosen.label, memory.followed)
        driven = chosen.robot if safe.tier <= Tier.TOUCHING_NOBODY else safe.trajectory
        outcome, reason = self._outcome(memory, before, chosen, safe, label)
        nearest = _progress(memory, scenario)
        decision = Decision(
            time=scenario.now,
            action=_action(scenario, settings, safe, reason),
            outcome=outcome,
            reason=reason,
            trajectory=driven,
            mixture=mixture,
            label=label,
            repairs=repairs,
        )
        memory = replace(
            memory, mixture=mixture, trajectory=driven, followed=label, nearest=nearest
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
            when = "none" if np.isinf(safe.contact) else f"in {safe.contact:.1f} s"
            stops = np.linalg.norm(safe.trajectory.velocities[safe.step]) < STANDS
            outcome = Outcome.STOPPED if stops else Outcome.NO_VALID_CONTROL
            return outcome, f"{why}; no command is clear of people (contact: {when})"
        if safe.tier is Tier.AVOIDING:
            why += "; its command is not clear: the nearest clear one"
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
            return _halt(memory, settings, Outcome.BAD_OBSERVATION, problem), memory
        time = observation.time if np.isfinite(observation.time) else last.time
        since = max(time - last.time, 0.0) if time > last.time else settings.period
        state = memory.trajectory.at(since)
        robot = replace(memory.scenario.robot, position=state[:2], velocity=state[2:])
        if memory.trajectory.headings is not None:
            ahead = memory.trajectory.resampled(np.array([since]))
            assert ahead.headings is not None
            assert ahead.yaw_rates is not None
            robot = replace(
                robot, heading=float(ahead.headings[0]), yaw_rate=float(ahead.yaw_rates[0])
            )
        scenario = memory.scenario.replace(robot=robot, now=last.time + since)
        belief = self._tracker.predict(memory.people, scenario.now).belief(
            scenario.density.Qc_people
        )
        wanted = _shifted(memory.trajectory, since, scenario.density.times)
        if since > memory.trajectory.times[-1]:
            wanted = _standing(scenario)
        safe = self._guarded(scenario, belief, wanted)
        reason = f"{problem}; the last plan goes on"
        decision = Decision(
            time=scenario.now,
            action=_action(scenario, settings, safe, reason),
            outcome=Outcome.BAD_OBSERVATION,
            reason=reason,
            trajectory=safe.trajectory,
            label=memory.followed,
            repairs=(problem,),
        )
        return decision, memory

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
        safe = self._guarded(scenario, belief, _standing(scenario))
        decision = Decision(
            time=scenario.now,
            action=_action(scenario, self.settings, safe, reason),
            outcome=outcome,
            reason=reason,
            trajectory=safe.trajectory,
            label=memory.followed,
            repairs=repairs,
        )
        return decision, replace(memory, trajectory=safe.trajectory)

    def _guarded(self, scenario: Scenario, belief: Belief, wanted: Trajectory) -> Guarded:
        """A trajectory among people as they are predicted."""
        times = scenario.density.times
        predicted = Others(times, belief.predict(times)[0], belief.radii)
        settings = self.settings
        return guard(
            scenario, belief, wanted, predicted, settings.period, settings.guard, settings.lag
        )


def _now(scenario: Scenario, observation: Observation) -> Scenario:
    """What is known, with what an observation changes of it."""
    robot: Robot = replace(
        scenario.robot,
        position=np.asarray(observation.position, dtype=float),
        velocity=np.asarray(observation.velocity, dtype=float),
        heading=observation.heading,
        yaw_rate=float(observation.yaw_rate),
        covariance=observation.covariance,
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
    if scenario.goal is None:
        return False
    return float(np.hypot(*(scenario.goal - scenario.robot.position))) <= settings.goal_tolerance


def _chosen(mixture: Mixture) -> Component:
    """The selected component; where none is safe, the one that is safe longest."""
    if mixture.best is not None:
        return mixture.best
    return max(mixture.components, key=lambda c: c.check.first_contact)


def _route_of(label: str, followed: str | None) -> str:
    """The route of a component, whose label joins all hypotheses that ended in it."""
    routes = [route(part) for part in label.split("+")]
    return followed if followed in routes else routes[0]


def _progress(memory: Memory, scenario: Scenario) -> tuple[float, float]:
    """Shortest way to the goal so far, and when."""
    if scenario.goal is None or not memory.routes.ways:
        return np.inf, scenario.now
    length = min(way.length for way in memory.routes.ways)
    best, when = memory.nearest
    return (length, scenario.now) if length < best - 0.1 else (best, max(when, -np.inf))


def _standing(scenario: Scenario) -> Trajectory:
    robot = scenario.robot
    now = robot.model.state(robot, heading(scenario))
    return robot.model.braking(robot, now, scenario.density.times, 1.0)


def _shifted(trajectory: Trajectory, since: float, times: Array) -> Trajectory:
    """What is left of a trajectory, on the clock of now."""
    ahead = trajectory.resampled(trajectory.times[0] + times + since)
    return replace(ahead, times=times)


def _action(scenario: Scenario, settings: Settings, safe: Guarded, reason: str) -> Action:
    trajectory, step = safe.trajectory, safe.step
    velocity = trajectory.velocities[step]
    kind = "follow" if safe.tier <= Tier.TOUCHING_NOBODY else "avoid"
    if float(np.linalg.norm(velocity)) < 1e-3:
        kind = "stop"
    return Action(
        kind,
        float(trajectory.times[step]),
        trajectory.positions[step],
        velocity,
        scenario.robot.model.twist(trajectory, step, heading(scenario)),
        safe.tier is not Tier.LATEST_CONTACT,
        reason,
    )


def _halt(memory: Memory, settings: Settings, outcome: Outcome, reason: str) -> Decision:
    """The fastest stop, whatever is around: the last resort."""
    scenario = memory.scenario
    stop = _standing(scenario)
    times = np.array([0.0, settings.period])
    soon = stop.resampled(times)
    twist = scenario.robot.model.twist(soon, 1, heading(scenario))
    action = Action(
        "stop", settings.period, soon.positions[1], soon.velocities[1], twist, False, reason
    )
    return Decision(scenario.now, action, outcome, reason, stop, label=memory.followed)
