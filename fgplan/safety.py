"""The hard check: what no energy can buy, over the whole horizon and between the states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import heading
from fgplan.scenario import Scenario
from fgplan.trajectory import Trajectory, hermite

Array = NDArray[np.float64]

CHECK_SPACING = 0.05
"""Time between two checks [s]: 6 cm at 1.2 m/s."""
TOLERANCE = 1e-6
UNCLEAR = 2
"""Grade of a trajectory that passes the hard check, but whose next command does not."""
BRAKING_SHARES = (1.0, 0.8, 0.6, 0.4, 0.25)
"""Decelerations tried for a stop, as shares of the robot's limit."""


class People(NamedTuple):
    """Where people are expected: states (S, n, 4) at times (S,), and radii (n,)."""

    times: Array
    states: Array
    radii: Array


@dataclass(frozen=True)
class Check:
    """What the hard check found.

    Args:
        min_separation: Smallest distance between the centres of robot and a person [m]; inf
            without people.
        clearance: Smallest gap between the robot's edge and an obstacle [m]; inf without a map.
        first_contact: When the first contact with a person or obstacle happens [s]; inf if never.
        problems: Why the trajectory must not be driven; empty when it may.
        grade: Of two optima of a hypothesis that may be driven the lower grade is followed, then
            the lower energy: 0 leaves nothing to be wished, 1 something, and from `UNCLEAR` on its
            next command needs another look.
    """

    min_separation: float
    clearance: float
    first_contact: float
    problems: tuple[str, ...]
    grade: int = 0

    @property
    def feasible(self) -> bool:
        """Whether the trajectory may be driven."""
        return not self.problems

    @property
    def clear(self) -> bool:
        """Whether it may be driven as it is."""
        return self.feasible and self.grade < UNCLEAR

    @property
    def fine(self) -> bool:
        """Whether nothing better need be looked for."""
        return self.feasible and self.grade == 0


Checker = Callable[[Scenario, Trajectory, "People"], Check]
"""Checks one trajectory among people: `check`, or what asks for more."""


def check(scenario: Scenario, robot: Trajectory, people: People) -> Check:
    """Check one trajectory against people, map and the robot's own limits.

    Who or what is already closer than allowed now must not come closer still: a plan that leads
    out of a contact is not refused for having begun in it.

    Args:
        scenario: Map, robot and limits.
        robot: What will be driven.
        people: Who is expected where.
    """
    duration = robot.times[-1] - robot.times[0]
    t = robot.times[0] + np.linspace(0, duration, 1 + max(1, round(duration / CHECK_SPACING)))
    position = robot.at(t)[:, :2]
    problems: list[str] = []

    gap = np.full((len(t), 0), np.inf)
    separation = np.inf
    if people.states.shape[1]:
        where, _ = hermite(people.times, people.states[..., :2], people.states[..., 2:], t)
        distance = np.linalg.norm(where - position[:, None], axis=-1)
        separation = float(distance.min())
        gap = distance - (scenario.robot.radius + people.radii)
    person_contact = _first_contact(t, gap)
    if np.isfinite(person_contact):
        problems.append(f"contact with a person at {person_contact:.2f} s")

    clearance, wall_contact = np.inf, np.inf
    if scenario.grid is not None:
        to_wall = scenario.grid.clearance(position, scenario.robot.radius)
        clearance = float(to_wall.min())
        wall_contact = _first_contact(t, to_wall[:, None])
        if np.isfinite(wall_contact):
            problems.append(f"contact with an obstacle at {wall_contact:.2f} s")

    problems += scenario.robot.model.problems(scenario.robot, robot)
    return Check(separation, clearance, min(person_contact, wall_contact), tuple(problems))


def brake(scenario: Scenario, people: People) -> tuple[Trajectory, Check]:
    """The fastest stop that passes the check; when none does, the one that is clear longest."""
    robot, times = scenario.robot, scenario.density.times
    now = robot.model.state(robot, heading(scenario))
    options = [robot.model.braking(robot, now, times, share) for share in BRAKING_SHARES]
    checked = [(stop, check(scenario, stop, people)) for stop in options]
    for stop, result in checked:
        if result.feasible:
            return stop, result
    return max(checked, key=lambda option: option[1].first_contact)


def allowed(gap: Array) -> Array:
    """The smallest gap that is no contact: 0, and where there is one at first what the gap was
    then, until it was left. Of gaps (..., S, n) along S times, a shape that broadcasts to that."""
    start = gap[..., :1, :]
    if np.all(start >= 0):
        return np.zeros_like(start)
    left = np.logical_or.accumulate(gap >= 0, axis=-2)
    return np.where(left, 0.0, np.minimum(start, 0.0))


def contacts(gap: Array) -> NDArray[np.bool_]:
    """Which gaps are contacts, of (..., S, n) along S times."""
    return np.asarray(gap < allowed(gap) - TOLERANCE)


def _first_contact(t: Array, gap: Array) -> float:
    """When the first contact happens, gap (Q, m); inf if never."""
    touching = contacts(gap).any(axis=1)
    return float(t[np.argmax(touching)]) if touching.any() else np.inf
