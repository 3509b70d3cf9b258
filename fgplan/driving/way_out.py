"""A way out where no plan is clear: search over what the robot can do, in space and time.

An optimum lies where the density is high, which among people who do not make way may be where
somebody is touched; and the nearest clear command may lead to where there is no other one. What is
looked for here is the cheapest way over the whole horizon that touches nobody, of all that change
their acceleration every 0.4 s: step by step, those that come to nearly the same state merged.

Reference:
    Fraichard, Trajectory planning in a dynamic workspace: a "state-time space" approach, Advanced
    Robotics 13(1), 1998.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import Belief
from fgplan.scenario import Scenario
from fgplan.trajectory import Trajectory, length

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]

SHARE = 0.95
"""Share of the limits of speed and acceleration that a way may use."""
STARTING, LEAVING = 0.5, 0.3
"""Who is nearer than the margin is left after a moment, so fast [s, m/s]."""


@dataclass(frozen=True)
class WayOut:
    """How a way out is looked for.

    Args:
        horizon: How far a way leads [s]: farther than a plan, as who runs from somebody faster is
            caught late.
        margins: Clearance from people; the first with which there is a way is taken [m].
        period: Between two changes of the acceleration [s].
        looks: At people and walls, in a period.
        courses: Directions of the acceleration, which is the largest, or none.
        cell, speed: Ways that come this near to each other in every coordinate are one [m, m/s].
        most: Ways that are followed at once; more where so many all end.
    """

    horizon: float = 12.0
    margins: tuple[float, ...] = (0.15, 0.05)
    period: float = 0.4
    looks: int = 4
    courses: int = 8
    cell: float = 0.15
    speed: float = 0.3
    most: tuple[int, ...] = (300, 1500)

    def search(
        self, scenario: Scenario, belief: Belief, wanted: Trajectory, until: float = np.inf
    ) -> Trajectory | None:
        """The cheapest way from where the robot is: changes of speed cost what they cost in
        p(f^R | z^R), and being elsewhere than is wanted what it costs to be off a plan.

        Args:
            scenario: Map, robot and density.
            belief: The people, who go on as predicted.
            wanted: Where the robot would be if nobody were there; its last speed goes on.
            until: When to give up, as `perf_counter` counts [s].

        Returns:
            A trajectory over the horizon; where every way ends or the time is up, the one that
            leads farthest, if it is as long as a plan, and else None.
        """
        best = None
        for margin, most in product(self.margins, self.most):
            found = self._search(scenario, belief, wanted, margin, most, until)
            if best is None or found.times[-1] > best.times[-1] + 1e-9:
                best = found
            if self.whole(best):
                break
        return None if best is None or best.times[-1] < scenario.density.horizon else best

    def whole(self, way: Trajectory | None) -> bool:
        """Whether a way leads over the whole horizon."""
        return way is not None and bool(way.times[-1] > self.horizon - self.period)

    def _search(
        self,
        scenario: Scenario,
        belief: Belief,
        wanted: Trajectory,
        margin: float,
        most: int,
        until: float,
    ) -> Trajectory:
        robot, d = scenario.robot, scenario.density
        count = max(1, round(self.horizon / self.period))
        times = self.period * np.arange(count + 1, dtype=float)
        goal = wanted.at(wanted.times[0] + times)[:, :2]
        accelerations = self._accelerations(SHARE * robot.max_acceleration)
        effort = np.sum(accelerations**2, axis=1) * self.period / (2 * d.Qc_robot)
        off = self.period / (d.t_ref or self.period) / (2 * scenario.levels[0].h)
        crowd = _Crowd.around(scenario, belief, self.horizon, margin)
        since = self.period / self.looks * np.arange(1, self.looks + 1, dtype=float)
        states, cost = np.append(robot.position, robot.velocity)[None], np.zeros(1)
        came: list[tuple[Array, Index]] = []
        for k in range(count):
            if perf_counter() > until:
                break
            possible = self._possible(scenario, states, accelerations)
            possible &= crowd.clear(states, accelerations, times[k], since)
            if scenario.grid is not None:
                for time in since[1::2]:
                    origin, which = np.nonzero(possible)
                    place = _driven(states[origin], accelerations[which], time)[:, :2]
                    possible[origin, which] = scenario.grid.clearance(place, robot.radius) > 0
            origin, which = np.nonzero(possible)
            if not len(origin):
                break
            moved = _driven(states[origin], accelerations[which], self.period)
            apart = np.sum((moved[:, :2] - goal[k + 1]) ** 2, axis=1)
            total = cost[origin] + effort[which] + off * apart
            kept = self._distinct(moved, total)[:most]
            came.append((states, origin[kept]))
            states, cost = moved[kept], total[kept]
        way = _traced(came, states, int(np.argmin(cost)))
        return Trajectory.from_states(times[: len(way)], way)

    def _accelerations(self, most: float) -> Array:
        angle = 2 * np.pi / self.courses * np.arange(self.courses)
        return np.vstack([np.zeros(2), most * np.stack([np.cos(angle), np.sin(angle)], axis=1)])

    def _possible(self, scenario: Scenario, states: Array, accelerations: Array) -> Mask:
        """Which of M states may go on with which of A accelerations, shape (M, A): who is too fast
        must not get faster."""
        after = length(states[:, None, 2:] + self.period * accelerations)
        limit = np.maximum(SHARE * scenario.robot.max_speed, length(states[:, 2:]))
        return np.asarray(after <= limit[:, None] + 1e-9)

    def _distinct(self, states: Array, cost: Array) -> Index:
        """The cheapest of those that are nearly alike, and of these the cheapest ones."""
        size = np.array([self.cell, self.cell, self.speed, self.speed])
        cells = np.round(states / size).astype(np.int64)
        cells -= cells.min(axis=0)
        shape = cells.max(axis=0) + 1
        key = np.ravel_multi_index(tuple(cells.T), tuple(shape))
        order = np.argsort(cost, kind="stable")
        cheapest = np.empty(np.prod(shape), dtype=np.intp)
        cheapest[key[order[::-1]]] = order[::-1]  # the last one written stays
        return np.asarray(order[cheapest[key[order]] == order])


@dataclass(frozen=True, eq=False)
class _Crowd:
    """Those who can be met: now (n, 2) [m], velocities (n, 2) [m/s], and how near the robot may
    come to each (n,) [m]."""

    now: Array
    velocity: Array
    reach: Array
    least: Array

    @classmethod
    def around(cls, scenario: Scenario, belief: Belief, horizon: float, margin: float) -> _Crowd:
        """Who is nearer than allowed already must not come nearer."""
        robot, now, velocity = scenario.robot, belief.mean[:, :2], belief.mean[:, 2:]
        reach = robot.radius + belief.radii + margin
        least = np.minimum(reach, length(now - robot.position) - 1e-3)
        most = robot.max_speed + length(velocity)
        met = length(now - robot.position) < reach + horizon * most
        return cls(now[met], velocity[met], reach[met], least[met])

    def clear(self, states: Array, accelerations: Array, time: float, since: Array) -> Mask:
        """Which of M states (M, 4) touch nobody with which of A accelerations (A, 2), shape (M, A).

        Args:
            states: From which the robot goes on.
            accelerations: With which.
            time: When, from now [s].
            since: Looks after that, shape (L,) [s].
        """
        clear = np.ones((len(states), len(accelerations)), dtype=bool)
        last, most = since[-1], float(length(accelerations).max())
        late = time + since
        allowed = self.least[:, None] + LEAVING * np.maximum(late - STARTING, 0.0)
        allowed = np.minimum(self.reach[:, None], allowed)
        # Who cannot be met until the last look is not looked at.
        x = states[:, None] - np.hstack([self.now + time * self.velocity, self.velocity])
        half = x[..., :2] + 0.5 * last * x[..., 2:]
        far = self.reach + 0.5 * last * length(x[..., 2:]) + 0.5 * last**2 * most
        who, whom = np.nonzero(np.einsum("...i,...i->...", half, half) < far**2)
        if not len(who):
            return clear
        pushed = 0.5 * since**2 * accelerations[..., None]  # (A, 2, L)
        drift = x[who, whom, :2, None] + since * x[who, whom, 2:, None]  # (P, 2, L)
        dx = drift[:, None, 0] + pushed[:, 0]
        dy = drift[:, None, 1] + pushed[:, 1]
        apart = dx * dx + dy * dy >= allowed[whom, None] ** 2
        first = np.flatnonzero(np.diff(who, prepend=-1))
        clear[who[first]] = np.logical_and.reduceat(apart.all(axis=-1), first, axis=0)
        return clear


def _driven(states: Array, accelerations: Array, time: float) -> Array:
    """States (M, 4) after a time at constant accelerations (M, 2)."""
    position = states[:, :2] + time * states[:, 2:] + 0.5 * time**2 * accelerations
    return np.hstack([position, states[:, 2:] + time * accelerations])


def _traced(came: list[tuple[Array, Index]], states: Array, end: int) -> Array:
    """The states that led to one of the last ones, from the first on."""
    way = [states[end]]
    for before, origin in reversed(came):
        end = int(origin[end])
        way.append(before[end])
    return np.array(way[::-1])
