"""One run in closed loop, and all that happened in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from fgplan.driving import Observation, Outcome
from fgplan.regions import Letter
from fgplan.simulation.body import Body
from fgplan.simulation.errand import Errand, State, way_of
from fgplan.simulation.gaps import Still
from fgplan.simulation.people import Disc, People
from fgplan.simulation.policy import Command, Policy
from fgplan.simulation.world import World

Array = NDArray[np.float64]


class End(StrEnum):
    """How a run ended."""

    GOAL = "goal"
    COLLISION = "collision"
    TIMEOUT = "timeout"
    ERROR = "error"


@dataclass(frozen=True, eq=False)
class Episode:
    """What happened, step by step; S steps were made, so there are S + 1 states.

    Args:
        name: Of the world.
        end: How it ended.
        times: Shape (S + 1,) [s].
        robot: Rows (x, y, vx, vy), shape (S + 1, 4) [m, m/s].
        headings: Of the robot, shape (S + 1,) [rad].
        people: Positions, shape (S + 1, n, 2) [m]; not a number where somebody is not there.
        radii: Of robot and people, shape (1 + n,) [m].
        gaps: Least distance between the edges of the robot and anybody during each step, shape
            (S,) [m]; inf where nobody was there.
        blocked: Whether a wall stopped the robot in the step, shape (S,).
        outcomes: What the policy said, S of them.
        labels: Of the hypothesis followed, S of them.
        seconds: Which the policy took, shape (S,) [s].
        goal: At the end, shape (2,) [m].
        reference: Length of the shortest way [m].
        delays: Time each person lost against walking on alone, shape (n,) [s]; empty where
            people go nowhere in particular.
        discomfort: The gap below which people feel uneasy [m].
        entries: How often the robot came into each of the regions on its way.
        unsafe: Number of commands that the policy's own check calls a contact.
        mission: How the mission stood at the end, by where the robot was.
        word: The letters of where it was, facts included; empty without a mission.
        error: What the policy raised, in words.
    """

    name: str
    end: End
    times: Array
    robot: Array
    headings: Array
    people: Array
    radii: Array
    gaps: Array
    blocked: NDArray[np.bool_]
    outcomes: tuple[Outcome, ...]
    labels: tuple[str | None, ...]
    seconds: Array
    goal: Array
    reference: float
    delays: Array
    discomfort: float
    entries: tuple[int, ...] = ()
    unsafe: int = 0
    error: str = ""
    mission: State = State.NONE
    word: tuple[Letter, ...] = ()


@dataclass(frozen=True, eq=False)
class Moment:
    """What somebody who watches a run sees of each step.

    Args:
        observation: What the robot saw.
        command: What it did.
        people: All people, in truth.
    """

    observation: Observation
    command: Command
    people: People


Watch = Callable[[Moment], None]


def run(world: World, policy: Policy, watch: Watch | None = None) -> Episode:
    """Drive until the goal is reached, the time is up, or the rules say that it is over. With a
    mission the goal counts when the mission is satisfied, and where none is stated that is all.

    An error of the policy ends the run and is kept in it: thousands of runs must not be lost by
    one.

    Args:
        world: Made for this run.
        policy: Made for this run.
        watch: Told of each step.
    """
    rules, people, body = world.rules, world.people, Body(world.scenario, world.limits)
    stated = world.scenario.goal
    goal = np.full(2, np.nan) if stated is None else np.asarray(stated, dtype=float)
    errand = Errand(world.scenario)
    events = sorted(world.events, key=lambda event: event.time)
    log = _Log(body, people, int(np.ceil(rules.time_limit / rules.period)))
    step, end, error = 0, End.TIMEOUT, ""
    inside = [False for _ in world.via]
    entries = [0 for _ in world.via]
    while step * rules.period < rules.time_limit - 1e-9:
        elapsed = step * rules.period
        news, facts = None, dict[str, bool]()
        while events and events[0].time <= elapsed + 1e-9:
            event = events.pop(0)
            facts |= event.facts
            if event.goal is not None:
                goal = news = np.asarray(event.goal, dtype=float)
        errand.told(facts)
        observation = _observed(world, body, elapsed, news, facts)
        before = perf_counter()
        try:
            command = policy.step(observation)
        except Exception as problem:
            end, error = End.ERROR, f"{type(problem).__name__}: {problem}"
            break
        took = perf_counter() - before
        if watch is not None:
            watch(Moment(observation, command, people))
        gap, blocked = _moved(world, body, command, errand)
        step += 1
        log.add(body, people, command, took, gap, blocked)
        if gap < 0 and rules.contact_ends:
            end = End.COLLISION
            break
        for i, region in enumerate(world.via):
            now = bool(region.contains(body.position))
            entries[i] += now and not inside[i]
            inside[i] = now
        # Where no goal is stated there is nowhere to be.
        there = np.isnan(goal).any() or np.hypot(*(body.position - goal)) < rules.tolerance
        if all(entries) and there and errand.done:
            end = End.GOAL
            break
    delays = getattr(people, "delays", np.zeros(0))
    return log.episode(world, end, goal, _way(world, goal), delays, tuple(entries), error, errand)


def _observed(
    world: World, body: Body, elapsed: float, news: Array | None, facts: dict[str, bool]
) -> Observation:
    """What the robot is told at a step: of the world, of a new goal, and of facts."""
    time = round(world.scenario.now + elapsed, 9)
    seen = world.sensor(time, body, world.people)
    said = () if world.operator is None else world.operator(round(elapsed, 9), body, world.people)
    observation = Observation(
        time=time,
        position=body.position,
        velocity=body.velocity,
        heading=body.heading,
        yaw_rate=body.yaw_rate,
        detections=seen.detections,
        grid=seen.grid,
        goal=news,
        facts=facts,
        operator=said,
    )
    return observation if world.tamper is None else world.tamper(observation)


def _moved(world: World, body: Body, command: Command, errand: Errand) -> tuple[float, bool]:
    """Robot and people go on for a period: the least gap [m], and whether a wall was in the way."""
    rules, people = world.rules, world.people
    dt, gap, blocked = rules.period / rules.substeps, np.inf, False
    for _ in range(rules.substeps):
        disc = Disc(body.position, body.velocity, body.radius, rules.seen_by_people)
        was = Still(people.positions, people.velocities, people.present.copy())
        people.advance(dt, disc)
        body.advance(command, dt, world.grid)
        errand.moved(disc.position, body.position)
        gap = min(gap, rules.gap(disc, was, body, people, dt))
        blocked |= body.blocked
    return gap, blocked


def _way(world: World, goal: Array) -> float:
    """What the robot's path is compared with [m]: the shortest way, without one the straight."""
    reference = way_of(world.scenario) if world.reference is None else world.reference
    return (
        float(np.hypot(*(goal - world.scenario.robot.position))) if reference is None else reference
    )


class _Log:
    """Collects the steps of a run. Its memory is there from the start, so that a long run is seen
    to need no more of it; of a decision next to nothing is kept: an hour of them is gigabytes.

    Args:
        body, people: At the start.
        most: Steps.
    """

    def __init__(self, body: Body, people: People, most: int) -> None:
        self.radii = np.concatenate([[body.radius], people.radii])
        self.made = self.unsafe = 0
        self.robot = np.full((most + 1, 4), np.nan)
        self.headings = np.full(most + 1, np.nan)
        self.people = np.full((most + 1, *people.positions.shape), np.nan)
        self.seconds, self.gaps = np.full((2, most), np.nan)
        self.blocked = np.zeros(most, dtype=bool)
        self.outcomes: list[Outcome] = []
        self.labels: list[str | None] = []
        self._state(body, people)

    def _state(self, body: Body, people: People) -> None:
        k = self.made
        self.robot[k, :2], self.robot[k, 2:] = body.position, body.velocity
        self.headings[k] = body.heading
        self.people[k, people.present] = people.positions[people.present]

    def add(
        self, body: Body, people: People, command: Command, took: float, gap: float, blocked: bool
    ) -> None:
        k = self.made
        self.seconds[k], self.gaps[k], self.blocked[k] = took, gap, blocked
        self.outcomes.append(command.outcome)
        self.labels.append(command.label)
        self.unsafe += command.decision is not None and not command.decision.action.safe
        self.made += 1
        self._state(body, people)

    def episode(
        self, world: World, end: End, goal: Array, reference: float, delays: Array,
        entries: tuple[int, ...], error: str, errand: Errand,
    ) -> Episode:  # fmt: skip
        steps, states = slice(self.made), slice(self.made + 1)
        return Episode(
            name=world.name,
            end=end,
            times=np.arange(self.made + 1) * np.float64(world.rules.period),
            robot=self.robot[states],
            headings=self.headings[states],
            people=self.people[states],
            radii=self.radii,
            gaps=self.gaps[steps],
            blocked=self.blocked[steps],
            outcomes=tuple(self.outcomes),
            labels=tuple(self.labels),
            seconds=self.seconds[steps],
            goal=goal,
            reference=reference,
            delays=np.array(delays),
            discomfort=world.rules.discomfort,
            entries=entries,
            unsafe=self.unsafe,
            error=error,
            mission=errand.state,
            word=errand.word,
        )
