"""From a trajectory to the command that is given, and to where it leaves the robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import heading
from fgplan.driving.guard import Guarded, Tier
from fgplan.mixture import Action
from fgplan.scenario import Robot, Scenario
from fgplan.trajectory import Trajectory

Array = NDArray[np.float64]


def standing(scenario: Scenario, period: float) -> Trajectory:
    """The fastest stop, then rest: exact at the end of each period [s], where commands are read."""
    robot, count = scenario.robot, 1 + int(np.ceil(scenario.density.horizon / period))
    now = robot.model.state(robot, heading(scenario))
    return robot.model.braking(robot, now, period * np.arange(count + 1, dtype=float), 1.0)


def shifted(trajectory: Trajectory, since: float, times: Array) -> Trajectory:
    """What is left of a trajectory, on the clock of now."""
    ahead = trajectory.resampled(trajectory.times[0] + times + since)
    return replace(ahead, times=times)


def at_start_of(trajectory: Trajectory, robot: Robot) -> Robot:
    """The robot where a trajectory begins, as fast as it may be: between two states an
    interpolated plan may be faster."""
    headings, rates = trajectory.headings, trajectory.yaw_rates
    velocity = trajectory.velocities[0]
    speed = float(np.linalg.norm(velocity))
    if speed > robot.max_speed:
        velocity = velocity * (robot.max_speed / speed)
    return replace(
        robot,
        position=trajectory.positions[0],
        velocity=velocity,
        heading=robot.heading if headings is None else float(headings[0]),
        yaw_rate=robot.yaw_rate if rates is None else float(rates[0]),
    )


def action_of(scenario: Scenario, safe: Guarded, reason: str) -> Action:
    """The command at the end of the period, for the robot program."""
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
