"""What is known now: the scenario after an observation, what is in sight, what is reached."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import heading, visible
from fgplan.driving.observation import Observation
from fgplan.scenario import Robot, Scenario

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def updated(scenario: Scenario, observation: Observation, period: float) -> Scenario:
    """What is known, with what an observation changes of it."""
    covariance, most = observation.covariance, scenario.robot.max_speed
    if covariance is None and scenario.robot.max_acceleration * period >= 2 * most:
        # Every velocity is reached within a period: a plan begins with the one it likes.
        covariance = scenario.robot.model.of_any_speed(scenario.robot)
    robot: Robot = replace(
        scenario.robot,
        position=np.asarray(observation.position, dtype=float),
        velocity=np.asarray(observation.velocity, dtype=float),
        heading=observation.heading,
        yaw_rate=float(observation.yaw_rate),
        covariance=covariance,
    )
    changes = {"robot": robot, "now": float(observation.time)}
    if observation.grid is not None:
        changes["grid"] = observation.grid
    if observation.goal is not None:
        changes["goal"] = np.asarray(observation.goal, dtype=float)
    return scenario.replace(**changes)


def sight(scenario: Scenario) -> Callable[[Array], Mask]:
    """Which points the robot would see somebody at."""

    def sees(points: Array) -> Mask:
        if scenario.field_of_view is None:
            return np.ones(len(points), dtype=bool)
        return visible(
            scenario.field_of_view,
            scenario.robot.position,
            heading(scenario),
            points,
            scenario.grid,
        )

    return sees


def reached(scenario: Scenario, tolerance: float) -> bool:
    if scenario.mission is not None and not scenario.mission.done:
        return False
    if scenario.goal is None:
        return scenario.mission is not None
    return float(np.hypot(*(scenario.goal - scenario.robot.position))) <= tolerance
