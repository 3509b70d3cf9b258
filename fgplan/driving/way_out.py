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

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import Belief
from fgplan.scenario import Scenario
from fgplan.trajectory import Trajectory, length

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SHARE = 0.95
"""Share of the limits of speed and acceleration that a way may use."""
STARTING, LEAVING = 0.5, 0.3
"""Who is nearer than the margin is left after a moment, so fast [s, m/s]."""


@dataclass(frozen=True)
class WayOut:
    """How a way out is looked for.

    Args:
        margins: Clearance from people; the first with which there is a way is taken [m].
        period: Between two changes of the acceleration [s].
        looks: At people and walls, in a period.
        courses: Directions of the acceleration, which is the largest, or none.
        cell, speed: Ways that come this near to each other in every coordinate are one [m, m/s].
        most: Ways that are followed at once.
    """

    margins: tuple[float, ...] = (0.15, 0.05)
    period: float = 0.4
    looks: int = 4
    courses: int = 8
    cell: float = 0.15
    speed: float = 0.3
    most: int = 1500

    def search(self, scenario: Scenario, belief: Belief, wanted: Trajectory) -> Trajectory | None:
        """The cheapest way from where the robot is: changes of speed cost what they cost in
        p(f^R | z^R), and being elsewhere than is wanted what it costs to be off a plan.

        Args:
            scenario: Map, robot and density.
            belief: The people, who go on as predicted.
            wanted: Where the robot would be if nobody were there.

        Returns:
            A trajectory over the horizon; None where every way ends.
        """
        for margin in self.margins:
            found = self._search(scenario, belief, wanted, margin)
            if found is not None:
                return found
        return None

    def _search(
        self, scenario: Scenario, belief: Belief, wanted: Trajectory, margin: float
    ) -> Trajectory | None:
        robot, d = scenario.robot, scenario.density
        count = max(1, round(d.horizon / self.period))
        times = self.period * np.arange(count + 1, dtype=float)
        goal = wanted.at(wanted.times[0] + times)[:, :2]
        accelerations = self._accelerations(SHARE * robot.max_acceleration)
        effort = np.sum(accelerations**2, axis=1) * self.period / (2 * d.Qc_robot)
        off = self.period / (d.t_ref or self.period) / (2 * scenario.levels[0].h)
        crowd = _Crowd.around(scenario, belief, d.horizon, margin)
        states, cost = np.append(robot.position, robot.velocity)[None], np.zeros(1)
        came: list[tuple[Array, Index]] = []
        for k in range(count):
            origin, which = self._possible(scenario, states, accelerations)
            for look in range(1, self.looks + 1):
                since = self.period * look / self.looks
                moved = _driven(states[origin], accelerations[which], since)
                clear = crowd.clear(moved[:, :2], times[k] + since)
                if scenario.grid is not None and look % 2 == 0:
                    clear &= scenario.grid.clearance(moved[:, :2], robot.radius) > 0
                origin, which, moved = origin[clear], which[clear], moved[clear]
            if not len(origin):
                return None
            apart = np.sum((moved[:, :2] - goal[k + 1]) ** 2, axis=1)
            total = cost[origin] + effort[which] + off * apart
            kept = self._distinct(moved, total)
            came.append((states, origin[kept]))
            states, cost = moved[kept], total[kept]
        return Trajectory.from_states(times, _traced(came, states, int(np.argmin(cost))))

    def _accelerations(self, most: float) -> Array:
        angle = 2 * np.pi / self.courses * np.arange(self.courses)
        return np.vstack([np.zeros(2), most * np.stack([np.cos(angle), np.sin(angle)], axis=1)])

    def _possible(
        self, scenario: Scenario, states: Array, accelerations: Array
    ) -> tuple[Index, Index]:
        """Which states may go on with which accelerations: who is too fast must not get faster."""
        after = length(states[:, None, 2:] + self.period * accelerations)
        limit = np.maximum(SHARE * scenario.robot.max_speed, length(states[:, 2:]))
        origin, which = np.nonzero(after <= limit[:, None] + 1e-9)
        return origin, which

    def _distinct(self, states: Array, cost: Array) -> Index:
        """The cheapest of those that are nearly alike, and of these the cheapest ones."""
        size = np.array([self.cell, self.cell, self.speed, self.speed])
        cells = np.round(states / size).astype(np.int64)
        cells -= cells.min(axis=0)
        key = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
        order = np.lexsort((cost, key))
        first = order[np.unique(key[order], return_index=True)[1]]
        return np.asarray(first[np.argsort(cost[first], kind="stable")[: self.most]])


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

    def clear(self, places: Array, time: float) -> NDArray[np.bool_]:
        """Which of M places (M, 2) nobody is at, at a time from now [s]."""
        allowed = np.minimum(self.reach, self.least + LEAVING * max(time - STARTING, 0.0))
        x, y = np.ascontiguousarray(places.T)
        clear = np.ones(len(places), dtype=bool)
        if not len(places):
            return clear
        people, r = self.now + time * self.velocity, allowed[:, None]
        low, high = (x.min(), y.min()), (x.max(), y.max())
        near = np.all((people > low - r) & (people < high + r), axis=1)
        for (there_x, there_y), reach in zip(people[near].tolist(), allowed[near], strict=True):
            dx, dy = x - there_x, y - there_y
            clear &= dx * dx + dy * dy >= reach * reach
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
