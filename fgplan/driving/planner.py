"""`Planner`: the object that a robot program holds. Observation in, decision out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from fgplan.backend import fastest
from fgplan.crowd import Belief, seen
from fgplan.driving.choice import chosen, expected, outcome, taken
from fgplan.driving.deliberation import Deliberation
from fgplan.driving.following import action_of, shifted
from fgplan.driving.guard import Guarded, Judge, Tier
from fgplan.driving.intake import Refused
from fgplan.driving.leading_on import leads_on
from fgplan.driving.memory import NOWHERE, Memory
from fgplan.driving.news import TRIES
from fgplan.driving.observation import Decision, Observation, Outcome
from fgplan.driving.operating import Operated
from fgplan.driving.pricing import update as update_blockages
from fgplan.driving.progress import progressed
from fgplan.driving.proposals import price, propose
from fgplan.driving.routing import Routes
from fgplan.driving.settings import Settings
from fgplan.driving.situation import reached, sight, updated
from fgplan.driving.tracking import People, Tracker
from fgplan.driving.unplanned import Unplanned, judge_of
from fgplan.errors import NoPlan
from fgplan.hypothesis import Hypothesis
from fgplan.mixture import Component
from fgplan.planner import plan
from fgplan.scenario import Scenario
from fgplan.shared_control import Lead, pointed
from fgplan.validation import validate

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

Source = Callable[[Scenario, Belief], Sequence[Hypothesis]]
"""Hypotheses beside the routes: their `log_prior` stands beside −β (J_i − min J) of those."""

LAST_WORD = 0.15
"""Share of a deadline that no plan has: half of it no search for a way has, either, and is left to
the guard alone."""
WAY_OUT = 0.25
"""Share of a deadline that is kept for a way out after a step whose plan was not clear."""
LEAST = 0.2
"""Share of a deadline that a plan has, however long all before it took."""


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

    @property
    def _unplanned(self) -> Unplanned:
        return Unplanned(self.settings, self._tracker)

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
            if self.memory.news.is_tried:
                why += f"; what was said before is left out after {TRIES} steps that broke"
            memory = self._broken(self.memory, observation)
            decision, self.memory = self._unplanned.stop(memory, observation, why)
        mission = self.memory.scenario.mission
        return replace(decision, seconds=perf_counter() - began, mission=mission)

    def _broken(self, memory: Memory, observation: Observation) -> Memory:
        """After a step that broke: what was said in it is tried again."""
        with suppress(Exception):
            said, _ = self.settings.intake.said(observation)
            return replace(memory, news=memory.news.broke(said))
        return memory

    def _refused(
        self, memory: Memory, refused: Refused, observation: Observation
    ) -> tuple[Decision, Memory]:
        """Nobody believes where the robot is; what else was said waits."""
        said, notes = self.settings.intake.said(observation)
        news = memory.news.keep(said, refused.time if refused.kind == "clock" else np.inf)
        memory = replace(memory, refused=refused, news=news)
        decision, memory = self._unplanned.carry_on(memory, refused)
        return replace(decision, repairs=(*decision.repairs, *notes)), memory

    def _decide(
        self, memory: Memory, observation: Observation, began: float
    ) -> tuple[Decision, Memory]:
        settings, robot = self.settings, memory.scenario.robot
        refused = settings.intake.refused(observation, memory.observation, memory.refused, robot)
        if refused is not None and settings.intake.is_new_clock(refused):
            memory, refused = memory.on_new_clock(), None
        if refused is not None:
            return self._refused(memory, refused, observation)
        observation, repairs = settings.intake.repaired(observation, robot.max_speed)
        observation = memory.news.told(observation)
        scenario = updated(memory.scenario, observation, settings.period)
        known = memory.observation is not None and not memory.jumped
        came_from = memory.scenario.robot.position if known else None
        mission, unknown = progressed(scenario, came_from, observation.facts)
        elsewhere = not np.array_equal(scenario.goal, memory.scenario.goal)  # type: ignore[arg-type]
        further = elsewhere or mission != scenario.mission
        scenario = scenario.replace(mission=mission)
        operated, doubts = memory.operated.hear(observation.operator, scenario)
        scenario = scenario.replace(data=operated.data)
        people, doubted = self._look(memory, scenario, observation)
        belief = people.belief(scenario.density.Qc_people)
        memory = replace(
            memory,
            scenario=scenario,
            observation=observation,
            people=people,
            operated=operated,
            mixture=None if memory.jumped else memory.mixture,
            refused=None,
            news=memory.news.used(observation),
            nearest=NOWHERE if further else memory.nearest,
            deliberation=Deliberation(memory.followed, scenario.now)
            if further
            else memory.deliberation,
        )
        repairs += (*unknown, *doubted, *doubts)
        if reached(scenario, settings.goal_tolerance):
            what = "goal reached" if mission is None else "mission done"
            return self._unplanned.rest(memory, belief, Outcome.GOAL_REACHED, what, repairs)
        before = memory.routes
        routes = before.update(scenario, settings.routing, memory.followed)
        new = {way.label for way in routes.ways if way.born == scenario.now}
        memory = replace(memory, deliberation=memory.deliberation.branched(new)).rerouted(routes)
        if routes.trouble is not None:
            outcome = Outcome(routes.trouble.code)
            return self._unplanned.rest(memory, belief, outcome, str(routes.trouble), repairs)
        memory = self._price(memory, belief)
        return self._plan(memory, before, belief, repairs, began)

    def _look(
        self, memory: Memory, scenario: Scenario, observation: Observation
    ) -> tuple[People, tuple[str, ...]]:
        """The people after this look; whom the robot cannot see is not taken from a detector."""
        sees = sight(scenario)
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
            sight(memory.scenario),
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
        """Weigh the hypotheses of this step, and do what the best one says."""
        settings, scenario = self.settings, memory.scenario
        proposed, memory = self._propose(memory, belief)
        recalled = memory.operated.recalled(proposed, scenario.now, memory.followed)
        judge = judge_of(scenario, belief, settings)
        left = None
        if settings.deadline is not None:
            kept = LAST_WORD if memory.clear else LAST_WORD + WAY_OUT
            left = (1 - kept) * settings.deadline - (perf_counter() - began)
            left = max(left, LEAST * settings.deadline)
        try:
            mixture = plan(
                scenario,
                belief=belief,
                hypotheses=lambda scenario, belief: recalled,
                solver=settings.solver,
                select=lambda components: self._heard(memory, components)[1],
                inference=settings.inference,
                warm=memory.mixture,
                deadline=left,
                check=judge.check,
            )
        except NoPlan as error:
            memory = replace(memory, mixture=None)
            ended = Outcome.NO_VALID_CONTROL
            return self._unplanned.rest(memory, belief, ended, str(error), repairs)
        followed = chosen(mixture, judge)
        safe, instead = self._safe(followed, judge, memory, began)
        known = {way.label for way in memory.routes.ways}
        label = taken(followed.label, safe.tier, memory.followed, known)
        driven = followed.robot if safe.tier <= Tier.TOUCHING_NOBODY else safe.trajectory
        end, reason = outcome(memory, before, followed, safe, instead, label, settings.stall)
        deliberation, _ = self._heard(memory, mixture.components)
        noted = memory.operated.note(proposed, scenario, label)
        operated, intent = noted.understand(mixture, scenario, driven)
        decision = Decision(
            time=scenario.now,
            action=action_of(scenario, safe, reason),
            outcome=end,
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
            clear=followed.check.clear,
            deliberation=deliberation,
        )
        return decision, memory.following(label)

    def _safe(
        self, followed: Component, judge: Judge, memory: Memory, began: float
    ) -> tuple[Guarded, str]:
        """What is done of a component, and what that is where it is not its own command: its own
        where that is clear and leads on, else a way out, or what is left of what is driven; where
        those are not clear, what the guard says. The way for which a plan that is clear is left
        goes over the whole horizon."""
        settings, planned, plan = self.settings, expected(followed, judge), followed.robot
        search, clear, until = settings.way_out, followed.check.clear, np.inf
        if settings.deadline is not None:
            until = began + (1 - LAST_WORD / 2) * settings.deadline
        if search is None or (
            clear and leads_on(search, judge, plan, settings.goal_tolerance, until)
        ):
            return judge.command(plan, planned), "the nearest clear one"
        way = search.search(judge.scenario, judge.belief, plan, until)
        if way is not None and (search.whole(way) or not clear):
            found = judge.clear(way)
            if found is not None:
                return found, "a way out"
        if memory.trajectory is not None:
            since, times = judge.scenario.now - memory.started, judge.scenario.density.times
            found = judge.clear(shifted(memory.trajectory, since, times))
            if found is not None:
                return found, "what is left of the last plan"
        return judge.command(plan, planned), "the nearest clear one"

    def _propose(self, memory: Memory, belief: Belief) -> tuple[tuple[Hypothesis, ...], Memory]:
        """The hypotheses of this step, and what is remembered of the operator for them."""
        settings, scenario, ways = self.settings, memory.scenario, memory.routes.ways
        priced = [
            (way, price(way, scenario, belief, memory.blockages, settings.pricing)) for way in ways
        ]
        operated = memory.operated.branched(ways, scenario.now, memory.followed)
        others = [h for source in self.sources for h in source(scenario, belief)]
        if scenario.data:
            leads = [Lead(way.path, cost.total) for way, cost in priced]
            operated = operated.seek(scenario, leads, settings.routing)
            leads += [Lead(h.route, h.cost) for h in others if h.route is not None]
            via = operated.via[0]
            others += pointed(scenario, belief, leads, None if via is None else via.path)
        found = propose(
            scenario,
            belief,
            priced,
            memory.followed,
            self._commitment(memory),
            settings.wait,
            others,
            settings.starts,
        )
        return found, replace(memory, operated=operated)

    def _commitment(self, memory: Memory) -> float:
        """What leaving the route that is followed costs now [nats]."""
        settings = self.settings
        return memory.deliberation.commitment(
            settings.commitment, memory.scenario.now, settings.deliberation
        )

    def _heard(self, memory: Memory, components: Sequence[Component]) -> tuple[Deliberation, Array]:
        """How much better other routes have looked of late, and the scores that come of it."""
        settings, commitment = self.settings, self._commitment(memory)
        scores = settings.select(components)
        deliberation = memory.deliberation.heard(
            components, scores, memory.scenario.now, commitment, settings.deliberation
        )
        return deliberation, deliberation.steadied(components, scores, commitment)
