"""From a trajectory to the command that is given, and to where it leaves the robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import heading
from fgplan.driving.guard import Guarded, Tier
from fgplan.driving.memory import Memory
from fgplan.driving.observation import Decision, Outcome
from fgplan.driving.settings import Settings
from fgplan.mixture import Action
from fgplan.scenario import Robot, Scenario
from fgplan.trajectory import Trajectory

Array = NDArray[np.float64]


def standing(scenario: Scenario) -> Trajectory:
    """The fastest stop, then rest."""
    robot = scenario.robot
    now = robot.model.state(robot, heading(scenario))
    return robot.model.braking(robot, now, scenario.density.times, 1.0)


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


def halt(memory: Memory, settings: Settings, outcome: Outcome, reason: str) -> Decision:
    """The fastest stop, whatever is around: the last resort."""
    scenario = memory.scenario
    stop = standing(scenario)
    times = np.array([0.0, settings.period])
    soon = stop.resampled(times)
    twist = scenario.robot.model.twist(soon, 1, heading(scenario))
    action = Action(
        "stop", settings.period, soon.positions[1], soon.velocities[1], twist, False, reason
    )
    return Decision(scenario.now, action, outcome, reason, stop, label=memory.followed)
