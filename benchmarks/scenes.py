"""Seeded scenes: a robot whose way random walkers cross, and the same world one step later.

People are what the density believes them to be: white noise on acceleration, seen with noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fgplan.scenario import Density, GivenPlan, Robot, Scenario, Track

Array = NDArray[np.float64]

DT = 0.2
"""Time between two states, and between two plans [s]: below h_c over the relative speed."""
MODERATE, DENSE = 0.25, 0.5
"""People per square metre, for up to 20 people and for more."""
APART = 0.7
"""Least distance between two people now [m]."""
ROOM = 1.2
"""Nobody is closer to the robot than this at first [m]."""
GOAL = 12.0
"""How far away the goal is [m]."""
FAN = (0.0, 1.5, -1.5, 3.0, -3.0)
"""How far to the side the plans lead [m]."""
SEEN = 0.4
"""Time between two detections of a person [s], as in the public recordings."""
HISTORY = 6
"""Detections of a person."""


@dataclass(frozen=True, eq=False)
class World:
    """What is true now.

    Args:
        now: [s].
        robot: Rows (x, y, vx, vy), shape (4,) [m, m/s].
        people: The same of each person, shape (n, 4).
        seen: Time stamps (m,) [s] and positions (m, n, 2) [m] of the detections so far.
        seed: Of everything random.
    """

    now: float
    robot: Array
    people: Array
    seen: tuple[Array, Array]
    seed: int

    @classmethod
    def random(cls, seed: int, n: int, density: float | None = None) -> World:
        """A robot at the origin, at 0.8 m/s, among n people in a square around its way.

        Args:
            seed: Of everything random.
            n: Number of people.
            density: People per square metre; by default it is moderate up to 20 people.
        """
        rng = _rng(seed, n, 0.0)
        side = np.sqrt(n / (density or (MODERATE if n <= 20 else DENSE)))
        robot = np.array([0.0, 0.0, 0.8, 0.0])
        centre = np.array([min(side / 2 + 0.5, 3.0), 0.0])
        people = np.hstack([_places(rng, n, side, centre), _velocities(rng, n)])
        past, times = [people], -SEEN * np.arange(HISTORY)
        for _ in times[1:]:
            past.append(_walk(past[-1], -SEEN, rng))
        positions = np.array(past)[::-1, :, :2]
        return cls(0.0, robot, people, (times[::-1], _detected(positions, rng)), seed)

    def moved(self, robot: Array, dt: float = DT) -> World:
        """The world dt later: the robot where its plan wanted it, the people one step on."""
        now = self.now + dt
        rng = _rng(self.seed, len(self.people), now)
        people = _walk(self.people, dt, rng)
        times, positions = self.seen
        detection = _detected(people[None, :, :2], rng)
        seen = np.append(times, now), np.concatenate([positions, detection])
        return replace(self, now=now, robot=robot, people=people, seen=seen)

    def scenario(
        self, T: int, K: int, crowd: Literal["joint", "predicted"] = "joint", **changes: Any
    ) -> Scenario:
        """What is known now: T steps, K given plans of equal weight, no map.

        Args:
            T: Number of steps of DT seconds.
            K: Number of plans, at most `len(FAN)`.
            crowd: Whether the people are planned or held at their prediction.
            changes: Other fields of the scenario.
        """
        times, positions = self.seen
        tracks = tuple(Track(f"p{i}", times, positions[:, i]) for i in range(len(self.people)))
        return Scenario(
            **{
                "robot": Robot(self.robot[:2], self.robot[2:]),
                "tracks": tracks,
                "now": self.now,
                "plans": tuple(self._plan(offset) for offset in FAN[:K]),
                "count": 0,
                "crowd": crowd,
                "density": Density(dt=DT, horizon=T * DT),
                **changes,
            }
        )

    def _plan(self, offset: float) -> GivenPlan:
        """From where the robot is now to the goal, `offset` to the side of the straight way."""
        here = self.robot[:2]
        on = [[3.0, offset], [GOAL - 3.0, offset], [GOAL, 0.0]]
        ahead = [point for point in on if point[0] > here[0] + 0.5]
        return GivenPlan(f"y = {offset:.1f} m", np.vstack([here, *ahead]), 1.0)


def smooth(rng: np.random.Generator, times: Array, size: float, dim: int = 2) -> Array:
    """A random smooth shift of a trajectory, none now: (T + 1, 2·dim), positions then velocities.

    Args:
        rng: Where it comes from.
        times: From 0 on, shape (T + 1,) [s].
        size: About how large it grows [m].
        dim: Number of coordinates.
    """
    waves = np.arange(1, 4)[:, None]
    phase = np.pi * waves * times / times[-1]
    amplitude = size * rng.standard_normal((dim, len(waves))) / waves.T
    shift = amplitude @ (0.5 - 0.5 * np.cos(phase))
    rate = amplitude @ (0.5 * np.pi * waves / times[-1] * np.sin(phase))
    return np.vstack([shift, rate]).T


def _rng(seed: int, n: int, now: float) -> np.random.Generator:
    """The future of a world depends on nothing that was done in it."""
    return np.random.default_rng([seed, n, round(now / DT)])


def _places(rng: np.random.Generator, n: int, side: float, centre: Array) -> Array:
    """Positions apart from each other and from the robot, shape (n, 2)."""
    places: list[Array] = []
    while len(places) < n:
        new = centre + side * rng.uniform(-0.5, 0.5, 2)
        clear = all(np.hypot(*(new - old)) > APART for old in places)
        if clear and np.hypot(*new) > ROOM:
            places.append(new)
    return np.array(places).reshape(n, 2)


def _velocities(rng: np.random.Generator, n: int) -> Array:
    """Walking any way, one in eight standing, shape (n, 2) [m/s]."""
    speed = np.clip(rng.normal(1.0, 0.25, n), 0.4, 1.5) * (rng.uniform(size=n) > 1 / 8)
    angle = rng.uniform(0, 2 * np.pi, n)
    return speed[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def _walk(people: Array, dt: float, rng: np.random.Generator) -> Array:
    """White noise on acceleration over dt, exactly; back in time where dt is negative."""
    variance = Density().Qc_people * np.abs([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    variance[0, 1] = variance[1, 0] = np.sign(dt) * variance[0, 1]
    noise = rng.standard_normal((2, people[:, :2].size)).T @ np.linalg.cholesky(variance).T
    position = people[:, :2] + dt * people[:, 2:] + noise[:, 0].reshape(-1, 2)
    return np.hstack([position, people[:, 2:] + noise[:, 1].reshape(-1, 2)])


def _detected(positions: Array, rng: np.random.Generator) -> Array:
    return np.asarray(positions + Density().sigma_track * rng.standard_normal(positions.shape))
