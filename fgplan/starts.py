"""Where the optimiser starts from: a hypothesis has many local optima, and one start finds one.

What drives well, in order: the plan itself, waiting, passing either side of the people in the
way, and wide arcs among many people.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import Belief, heading
from fgplan.hypothesis import Start
from fgplan.scenario import Scenario
from fgplan.timing import timed
from fgplan.trajectory import Trajectory, hermite

Array = NDArray[np.float64]

Starts = Callable[[Scenario, Belief, Trajectory, Array], tuple[Start, ...]]
"""Starts for one global plan; the arguments are those of `starts`."""

WAIT_SHARE = 0.25
"""Share of the preferred speed at which a robot that waits creeps on."""
CONFLICT = 0.5
"""Who comes closer to the plan than contact plus this is in the way [m]."""
MOST_CONFLICTS = 2
"""How many people get a start on either side."""
CROWDED = 4
"""From how many people near the plan on wide arcs are tried."""
ARCS = (-3.0, -1.5, 1.5, 3.0)
"""Lateral offsets of those arcs [m]."""


def starts(scenario: Scenario, belief: Belief, plan: Trajectory, path: Array) -> tuple[Start, ...]:
    """Starts for one global plan; the first is the plan itself.

    Args:
        scenario: What is known now.
        belief: The people.
        plan: The timed path over the horizon.
        path: The untimed path, shape (N, 2) [m].
    """
    candidates = [Start("wait", _creep(scenario, path))]
    candidates += _sides(scenario, belief, plan)
    candidates += _arcs(scenario, belief, plan)
    clear = _through_free_space(scenario, [start.robot for start in candidates])
    return (Start("plan", plan), *compress(candidates, clear))


def only_plan(
    scenario: Scenario, belief: Belief, plan: Trajectory, path: Array
) -> tuple[Start, ...]:
    """The plan alone; the arguments are those of `starts`."""
    return (Start("plan", plan),)


def coast(scenario: Scenario) -> Trajectory:
    """The mean of the robot's prior: on with what it does now."""
    robot = scenario.robot
    return robot.model.coast(robot.model.state(robot, heading(scenario)), scenario.density.times)


def _creep(scenario: Scenario, path: Array) -> Trajectory:
    robot = scenario.robot
    return timed(
        path,
        speed=WAIT_SHARE * robot.preferred_speed,
        acceleration=robot.max_acceleration,
        velocity=robot.velocity,
        times=scenario.density.times,
    )


def _sides(scenario: Scenario, belief: Belief, plan: Trajectory) -> Iterable[Start]:
    """Left and right of the first people whom the plan would run into."""
    people = belief.expected(plan.times)[..., :2]
    distance = np.linalg.norm(people - plan.positions[:, None], axis=-1)
    reach = scenario.robot.radius + belief.radii + scenario.density.contact_margin
    when = distance.argmin(axis=0)
    near = np.flatnonzero(distance.min(axis=0) < reach + CONFLICT)
    for i in near[np.argsort(when[near], kind="stable")][:MOST_CONFLICTS]:
        k = int(max(when[i], 1))
        left = _left(plan.velocities[k])
        for side, sign in (("left", 1.0), ("right", -1.0)):
            aim = people[k, i] + sign * (reach[i] + 0.1) * left
            shift = aim - plan.positions[k]
            yield Start(f"{side} of {belief.names[i]}", _bent(plan, plan.times[k], shift))


def _arcs(scenario: Scenario, belief: Belief, plan: Trajectory) -> Iterable[Start]:
    """Wide lateral arcs, when many people are about."""
    people = belief.expected(plan.times)[..., :2]
    distance = np.linalg.norm(people - plan.positions[:, None], axis=-1)
    if np.count_nonzero(distance.min(axis=0) < max(ARCS)) < CROWDED:
        return
    middle = len(plan.times) // 2
    left = _left(plan.velocities[middle])
    for offset in ARCS:
        yield Start(f"arc {offset:+.1f} m", _bent(plan, plan.times[middle], offset * left))


def _bent(plan: Trajectory, when: float, shift: Array) -> Trajectory:
    """The plan pushed sideways by `shift` at time `when`, smoothly, and not at all now."""
    u = plan.times / when
    shape = (u * np.exp(1 - u)) ** 3
    slope = 3 * (u * np.exp(1 - u)) ** 2 * np.exp(1 - u) * (1 - u) / when
    return Trajectory(
        plan.times,
        plan.positions + shape[:, None] * shift,
        plan.velocities + slope[:, None] * shift,
    )


def _left(velocity: Array) -> Array:
    """Unit vector to the left of a motion; of the x axis when standing."""
    speed = float(np.linalg.norm(velocity))
    x, y = velocity / speed if speed > 1e-9 else (1.0, 0.0)
    return np.array([-y, x])


def _through_free_space(scenario: Scenario, robots: Sequence[Trajectory]) -> Iterable[bool]:
    """Of which of M robots at the same times the centre stays out of walls: a start through one
    would end in another plan's corridor."""
    if scenario.grid is None:
        return [True] * len(robots)
    times = robots[0].times
    t = np.linspace(times[0], times[-1], 4 * len(times))
    positions, velocities = (
        np.stack(each, axis=1)
        for each in zip(*((r.positions, r.velocities) for r in robots), strict=True)
    )
    centres, _ = hermite(times, positions, velocities, t)
    clear: list[bool] = np.all(scenario.grid.clearance(centres, 0.0) > 0, axis=0).tolist()
    return clear
