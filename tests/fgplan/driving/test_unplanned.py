"""Without a plan: where the robot is taken to be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgplan import Robot, Scenario
from fgplan.driving import Planner
from fgplan.driving.unplanned import _driven
from fgplan.trajectory import Trajectory


def test_nobody_gets_farther_than_they_can_while_the_last_plan_goes_on():
    """Between two states the curve of a plan may be faster than the robot: here 0.11 m in 0.1 s."""
    robot = Robot(np.zeros(2), np.array([1.0, 0.0]), max_speed=1.0)
    memory = Planner(Scenario(robot, goal=np.array([5.0, 0.0]))).memory
    states = np.array([[0.0, 0.0, 1.0, 0.0], [0.6, 0.0, 1.0, 0.0], [1.1, 0.0, 1.0, 0.0]])
    plan = Trajectory.from_states(np.array([0.0, 0.5, 1.0]), states)
    assert plan.at(np.array([0.1]))[0, 0] > 0.11
    scenario, ahead = _driven(replace(memory, trajectory=plan, started=0.0), 0.1)
    np.testing.assert_allclose(scenario.robot.position, [0.1, 0.0], rtol=0, atol=1e-12)
    assert scenario.now == 0.1
    assert ahead is not None
