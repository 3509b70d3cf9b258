"""Operators of simulated robots: who holds the stick, and how badly.

An operator sees the world and says what a joystick would say; wrappers make them noisy, late or
unreliable. They are made anew for each run, with the run's own random numbers. They decide by the
time since the start of the run; what they say is stamped on the clock of the scenario.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import heading
from fgplan.errors import FgplanError, NoRoute
from fgplan.measuring import Measurement
from fgplan.routes import find_routes
from fgplan.shared_control import JoySample, Joystick, Stick, Waypoint, read_joy
from fgplan.simulation.body import Body
from fgplan.simulation.people import People
from fgplan.simulation.world import Operator, Setup, World
from fgplan.timing import arc_length

Array = NDArray[np.float64]

STICK = Stick(deadman=None, frame="map", sigma=0.1)
"""How the operators' sticks are read: x of the map is forward, S6 asks for σ = 0.1."""
FAR = 5.0
"""How far they want to go where no goal is stated [m]."""
AHEAD = 0.8
"""How far ahead on their way people look who steer [m]."""


class Hand(Protocol):
    """What an operator wishes."""

    def wish(self, time: float, body: Body, people: People) -> Array | None:
        """Velocity in the map frame, shape (2,) [m/s]; None where they do not hold the stick."""
        ...


@dataclass(frozen=True)
class Steady:
    """Holds the stick in one direction for a while.

    Args:
        direction: In the map frame [rad].
        first, last: From when to when, since the start of the run [s].
        speed: [m/s].
    """

    direction: float
    first: float
    last: float
    speed: float = 1.0

    def wish(self, time: float, body: Body, people: People) -> Array | None:
        if not self.first <= time < self.last:
            return None
        return self.speed * np.array([np.cos(self.direction), np.sin(self.direction)])


class GoalDirected:
    """Steers along the shortest way to a place, and knows nothing of people.

    Args:
        goal: Shape (2,) [m].
        world: With the map.
        speed: [m/s].
    """

    def __init__(self, goal: Array, world: World, speed: float = 0.9) -> None:
        self.goal, self.speed = np.asarray(goal, dtype=float), speed
        self._grid, self._radius = world.grid, world.scenario.robot.radius

    def wish(self, time: float, body: Body, people: People) -> Array | None:
        try:
            way = find_routes(self._grid, body.position, self.goal, self._radius, 1)[0].path
        except NoRoute:
            return None
        s = arc_length(way)
        at = min(AHEAD, float(s[-1]))
        target = np.array([np.interp(at, s, way[:, i]) for i in (0, 1)])
        return _towards(target - body.position, self.speed)


@dataclass(frozen=True)
class Adversary:
    """Steers at the nearest person, or where nobody is nearer, at the nearest wall.

    Args:
        world: With the map.
        speed: [m/s].
    """

    world: World
    speed: float = 1.0

    def wish(self, time: float, body: Body, people: People) -> Array | None:
        targets = [p for p, here in zip(people.positions, people.present, strict=True) if here]
        grid = self.world.grid
        if grid is not None:
            angles = np.linspace(0, 2 * np.pi, 36, endpoint=False)
            around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
            for length in np.arange(0.1, 4.0, 0.1):
                hit = grid.clearance(body.position + length * around, 0.0) < 0
                if hit.any():
                    targets.append(body.position + length * around[int(np.argmax(hit))])
                    break
        if not targets:
            return None
        apart = np.linalg.norm(np.array(targets) - body.position, axis=1)
        return _towards(targets[int(np.argmin(apart))] - body.position, self.speed)


@dataclass(frozen=True, eq=False)
class Held:
    """An operator with a stick in one hand.

    Args:
        hand: What they wish.
        period: Between two messages [s].
        rng: Of noise and losses.
        sigma: Standard deviation of the hand [m/s].
        dropped: Share of messages that are lost.
        delay: Messages arrive so late, but with the stamp of when they were made [s].
        stick: How it is read.
        start: Of the run, on the clock of the scenario [s].
    """

    hand: Hand
    period: float
    rng: np.random.Generator
    sigma: float = 0.1
    dropped: float = 0.0
    delay: float = 0.0
    stick: Stick = STICK
    start: float = 0.0
    waiting: deque[tuple[float, JoySample]] = field(default_factory=deque)

    def __call__(self, time: float, body: Body, people: People) -> tuple[Measurement, ...]:
        wish = self.hand.wish(time, body, people)
        noise, lost = self.rng.normal(0, self.sigma, 2), self.rng.random() < self.dropped
        if wish is not None and not lost:
            axes = np.clip((wish + noise) / self.stick.speed, -1, 1)
            stamp = round(self.start + time, 9)
            message = JoySample(stamp, (float(axes[1]), float(axes[0])), ())
            self.waiting.append((time + self.delay, message))
        said: list[Joystick] = []
        while self.waiting and self.waiting[0][0] <= time + 1e-9:
            said += self.stick.wish(self.waiting.popleft()[1], body.heading, self.period)
        return tuple(said)


class Replay:
    """A log of Joy messages, played from the start of the run.

    Args:
        path: Of the log.
        period: Between two looks at it [s].
        stick: How it is read.
        start: Of the run, on the clock of the scenario [s].
    """

    def __init__(
        self, path: Path, period: float, stick: Stick | None = None, start: float = 0.0
    ) -> None:
        self.stick, self.period = Stick() if stick is None else stick, period
        self.start = start
        samples = sorted(read_joy(path), key=lambda sample: sample.stamp)
        first = samples[0].stamp if samples else 0.0
        self._left = deque(replace(sample, stamp=sample.stamp - first) for sample in samples)
        self._latest: JoySample | None = None

    def __call__(self, time: float, body: Body, people: People) -> tuple[Measurement, ...]:
        while self._left and self._left[0].stamp <= time + 1e-9:
            self._latest = self._left.popleft()
        latest = self._latest
        if latest is None or time - latest.stamp > self.stick.timeout:
            return ()
        if self.stick.problem(latest) is not None:
            return ()
        message = replace(latest, stamp=round(self.start + time, 9))
        return self.stick.wish(message, body.heading, self.period)


class Names:
    """Names places while the robot drives, each once, beside what another operator says.

    Args:
        places: When each is named, since the start of the run [s], and the place.
        beside: Who holds the stick; None is nobody.
    """

    def __init__(
        self, places: Sequence[tuple[float, Waypoint]], beside: Operator | None = None
    ) -> None:
        self._left = deque(sorted(places, key=lambda place: place[0]))
        self._beside = beside

    def __call__(self, time: float, body: Body, people: People) -> tuple[Measurement, ...]:
        said = list(() if self._beside is None else self._beside(time, body, people))
        while self._left and self._left[0][0] <= time + 1e-9:
            said.append(self._left.popleft()[1])
        return tuple(said)


def goal_of(world: World) -> Array:
    """Where the operator wants to go: the goal, else straight on, the way the robot looks or moves,
    else along x; shape (2,) [m]."""
    scenario = world.scenario
    if scenario.goal is not None:
        return np.asarray(scenario.goal, dtype=float)
    ahead = heading(scenario)
    return scenario.robot.position + FAR * np.array([np.cos(ahead), np.sin(ahead)])


def _steers(world: World, degrees: float) -> Hand:
    """30° off the goal for 1.5 s, from 1 s on."""
    ahead = goal_of(world) - world.scenario.robot.position
    return Steady(float(np.arctan2(ahead[1], ahead[0]) + np.deg2rad(degrees)), 1.0, 2.5)


def _held(hand: Callable[[World], Hand], world: World, seed: int, **how: float) -> Operator:
    rng, start = np.random.default_rng([seed, 1]), world.scenario.now
    return Held(hand(world), world.rules.period, rng, start=start, **how)  # type: ignore[arg-type]


def _to_goal(world: World) -> Hand:
    return GoalDirected(goal_of(world), world)


Maker = Callable[[World, int], Operator]
"""Makes the operator of a run from its world and its seed."""

OPERATORS: dict[str, Maker] = {
    "left": partial(_held, partial(_steers, degrees=30.0), dropped=0.2),
    "right": partial(_held, partial(_steers, degrees=-30.0), dropped=0.2),
    "goal-directed": partial(_held, _to_goal),
    "noisy": partial(_held, _to_goal, sigma=0.4),
    "delayed": partial(_held, _to_goal, delay=0.3),
    "dropping": partial(_held, _to_goal, dropped=0.2),
    "adversary": partial(_held, Adversary),
}


class UnknownOperator(FgplanError, ValueError):
    """A name that no operator has."""


def operator_named(name: str) -> Maker:
    """The operator of a name; a name that ends in .jsonl is a log of Joy messages.

    Raises:
        UnknownOperator: there is none.
        FgplanError: the log cannot be read.
    """
    if name.endswith(".jsonl"):
        read_joy(name)
        return partial(_replay, Path(name))
    if name not in OPERATORS:
        near = get_close_matches(name, OPERATORS, n=3) or sorted(OPERATORS)
        raise UnknownOperator(
            f"operator: got {name!r}; give one of {', '.join(near)}, or a log that ends in .jsonl"
        )
    return OPERATORS[name]


def _replay(path: Path, world: World, seed: int) -> Operator:
    return Replay(path, world.rules.period, start=world.scenario.now)


@dataclass(frozen=True)
class WithOperator:
    """The worlds of a setup, and an operator in each.

    Args:
        setup: Makes the worlds.
        operator: Name of the operator.
    """

    setup: Setup
    operator: str

    def __call__(self, seed: int) -> World:
        world = self.setup(seed)
        return replace(world, operator=operator_named(self.operator)(world, seed))


def _towards(step: Array, speed: float) -> Array:
    length = float(np.hypot(*step))
    return np.asarray(step / length * speed) if length > 1e-9 else np.zeros(2)
