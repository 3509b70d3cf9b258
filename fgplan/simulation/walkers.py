"""People who walk along waypoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fgplan.simulation.people import Disc, Motion

Array = NDArray[np.float64]

ARRIVED = 0.3
"""A waypoint is reached from here [m]."""
ROOM = 1.0
"""Who begins anew needs this much room around the first waypoint [m], and ..."""
AWAY = 2.0
"""... the robot this far away [m]."""
GONE = 0.25
"""Who is gone comes in no sooner than this [s]: nobody is at both ends of the world in a period."""
OUTSIDE = 1e5
"""Where people are who are not in the world [m]; each a little further, apart from all others."""


@dataclass(frozen=True, eq=False)
class Walker:
    """One person and where they go.

    Args:
        position: At the start, shape (2,) [m].
        waypoints: One after the other, shape (m, 2) [m].
        velocity: At the start, shape (2,) [m/s].
        radius: [m].
        speed: Which they prefer [m/s].
        max_speed: [m/s]; None is 1.3 times the preferred one.
        ends: At the last waypoint they "stay", walk all waypoints "back" and forth, or are gone
            and come in "anew" at `entry`, as somebody else.
        entry: Where they come in anew, shape (2,) [m]; None is where they were at the start.
        begins: They stand until then, whoever comes near [s].
    """

    position: Array
    waypoints: Array
    velocity: Array | None = None
    radius: float = 0.3
    speed: float = 1.2
    max_speed: float | None = None
    ends: Literal["stay", "back", "anew"] = "stay"
    entry: Array | None = None
    begins: float = 0.0


class Walkers:
    """A crowd of walkers that all move in one way.

    Args:
        walkers: The people.
        motion: How they choose their velocities, from what each would do alone.
    """

    def __init__(self, walkers: Sequence[Walker], motion: Motion) -> None:
        self._walkers, self._motion = tuple(walkers), motion
        count = len(walkers)
        self.names = [f"p{i}" for i in range(count)]
        self.radii = np.array([w.radius for w in walkers])
        self.positions = np.array([w.position for w in walkers], dtype=float).reshape(count, 2)
        still = np.zeros(2)
        self.velocities = np.array(
            [still if w.velocity is None else w.velocity for w in walkers], dtype=float
        ).reshape(count, 2)
        self.present = np.ones(count, dtype=bool)
        self.delays = np.zeros(count)
        """Time each person lost against walking on alone, shape (n,) [s]."""
        self._speeds = np.array([w.speed for w in walkers])
        self._last = np.array([len(w.waypoints) - 1 for w in walkers], dtype=int)
        length = int(self._last.max(initial=0)) + 1
        self._waypoints = np.zeros((count, length, 2))
        for i, walker in enumerate(walkers):
            self._waypoints[i, : len(walker.waypoints)] = walker.waypoints
        self._at = np.zeros(count, dtype=int)
        self._step = np.ones(count, dtype=int)
        self._stay = np.array([w.ends == "stay" for w in walkers], dtype=bool)
        self._anew = np.array([w.ends == "anew" for w in walkers], dtype=bool)
        self._rows = np.arange(count)
        self._begins = np.array([w.begins for w in walkers], dtype=float)
        self._time = 0.0
        self._left = np.full(count, -np.inf)

    @property
    def targets(self) -> Array:
        """Where each person goes now, shape (n, 2) [m]."""
        return np.asarray(self._waypoints[self._rows, self._at])

    def advance(self, dt: float, robot: Disc | None) -> None:
        offset = self.targets - self.positions
        away = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-9)
        direction = offset / away[:, None]
        # Who will stay at the last waypoint slows down within a second of it.
        settling = self._stay & (self._at == self._last)
        settled = settling & (away < self._speeds)
        share = np.where(settling, np.minimum(self._speeds, away), self._speeds)
        # 1e-9: a sum of steps must meet the time that was stated.
        going = self.present & (self._time >= self._begins - 1e-9)
        wishes = np.where(going, share, 0.0)[:, None] * direction
        seen = robot if robot is not None and robot.seen else None
        self.velocities = self._motion(self.positions, self.velocities, wishes, dt, seen)
        self.velocities[~going] = 0.0
        self.positions = self.positions + dt * self.velocities
        self._time += dt
        gained = np.einsum("ij,ij->i", self.velocities, direction) / np.maximum(self._speeds, 1e-9)
        counted = going & ~settled & (self._speeds > 0)
        self.delays += dt * np.where(counted, 1.0 - gained, 0.0)
        self._arrive(robot)

    def _arrive(self, robot: Disc | None) -> None:
        offset = self.targets - self.positions
        there = self.present & (offset[:, 0] ** 2 + offset[:, 1] ** 2 < ARRIVED**2)
        if there.any():
            end = np.where(self._step > 0, self._last, 0)
            more = there & (self._at != end)
            self._at[more] += self._step[more]
            over = there & ~more & ~self._stay
            back = over & ~self._anew
            self._step[back] *= -1
            self._at[back] = np.clip(self._at[back] + self._step[back], 0, self._last[back])
            gone = over & self._anew
            self.present[gone], self._left[gone] = False, self._time
            self.positions[gone] = OUTSIDE * (1 + self._rows[gone])[:, None]
        if not self.present.all():
            self._enter(robot)

    def _enter(self, robot: Disc | None) -> None:
        """Who is gone comes in as somebody else, one after the other, when there is room."""
        # 1e-9: as above.
        ready = ~self.present & (self._time - self._left >= GONE - 1e-9)
        for i in np.flatnonzero(ready).tolist():
            walker = self._walkers[i]
            entry = walker.position if walker.entry is None else walker.entry
            others = self.positions[self.present] - entry
            if np.any(np.hypot(others[:, 0], others[:, 1]) < ROOM):
                continue
            if robot is not None and np.hypot(*(robot.position - entry)) < AWAY:
                continue
            self.positions[i] = entry
            towards = walker.waypoints[0] - entry
            self.velocities[i] = walker.speed * towards / max(float(np.hypot(*towards)), 1e-9)
            self.present[i], self._at[i] = True, 0
            name, _, number = self.names[i].partition(".")
            self.names[i] = f"{name}.{int(number or 0) + 1}"
