"""What is executed is what is checked, and a clear command is taken where there is one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fgplan import CarLike, DifferentialDrive, Holonomic, OccupancyGrid, Robot, Scenario
from fgplan.crowd import Belief, heading
from fgplan.driving.guard import Guard, Judge, Tier
from fgplan.safety import People

PERIOD = 0.1
MODELS = [Holonomic(), DifferentialDrive(), CarLike()]


def belief(*people):
    """People known to the centimetre: rows (x, y, vx, vy)."""
    mean = np.array(people, dtype=float).reshape(-1, 4)
    n = len(mean)
    names = tuple(f"p{i}" for i in range(n))
    return Belief(names, mean, np.tile(1e-4 * np.eye(4), (n, 1, 1)), np.full(n, 0.3), 0.03)


def straight(scenario):
    robot = scenario.robot
    now = robot.model.state(robot, heading(scenario))
    return robot.model.coast(now, scenario.density.times)


def guarded(scenario, people, plan=None, settings=Guard()):  # noqa: B008 - frozen
    times = scenario.density.times
    others = People(times, people.predict(times)[0], people.radii)
    plan = straight(scenario) if plan is None else plan
    return Judge(scenario, people, PERIOD, settings).command(plan, others)


def moving(speed=1.0, **changes):
    return Scenario(Robot(np.zeros(2), np.array([speed, 0.0]), heading=0.0), **changes)


def test_alone_the_plan_is_followed():
    found = guarded(moving(), belief())
    assert found.tier is Tier.CLEAR
    np.testing.assert_allclose(found.trajectory.at(PERIOD), [0.1, 0.0, 1.0, 0.0], atol=1e-9)


def test_a_person_in_the_way_is_not_run_into():
    found = guarded(moving(), belief([1.2, 0.05, 0.0, 0.0]))
    assert found.tier is Tier.AVOIDING
    gap = np.linalg.norm(found.trajectory.positions - [1.2, 0.05], axis=1) - 0.55
    assert gap.min() >= 0


def test_a_wall_in_the_way_is_not_run_into():
    wall = [(1.0, -3.0), (1.2, -3.0), (1.2, 3.0), (1.0, 3.0)]
    grid = OccupancyGrid.from_polygons([wall], (-2, -3, 3, 3), 0.05)
    found = guarded(moving(grid=grid), belief())
    assert found.tier is Tier.AVOIDING
    assert grid.clearance(found.trajectory.positions, 0.25).min() >= -1e-6


def test_where_no_straight_way_is_clear_a_turn_is():
    """A corridor with a bend, and somebody who comes up fast from behind."""
    walls = [
        [(-3.0, 0.4), (0.3, 0.4), (0.3, 3.0), (-3.0, 3.0)],
        [(-3.0, -0.6), (3.0, -0.6), (3.0, -0.4), (-3.0, -0.4)],
        [(1.1, -0.4), (3.0, -0.4), (3.0, 3.0), (1.1, 3.0)],
    ]
    grid = OccupancyGrid.from_polygons(walls, (-3, -1, 3, 4), 0.05)
    scenario, person = moving(grid=grid), belief([-0.9, 0.0, 0.8, 0.0])
    assert guarded(scenario, person, settings=Guard(turn=np.inf)).tier is Tier.LATEST_CONTACT
    found = guarded(scenario, person)
    assert found.tier is Tier.AVOIDING
    assert grid.clearance(found.trajectory.positions, 0.25).min() >= -1e-6


def test_a_clearance_below_the_margin_does_not_refuse_a_plan_that_leads_out_of_it():
    scenario = moving(0.5)
    found = guarded(scenario, belief([-0.58, 0.0, 0.0, 0.0]))
    assert found.tier is Tier.CLEAR


def test_boxed_in_it_says_that_nothing_is_clear():
    ring = [[0.7 * np.cos(a), 0.7 * np.sin(a), -np.cos(a), -np.sin(a)] for a in np.arange(8)]
    found = guarded(moving(0.0), belief(*ring))
    assert found.tier is Tier.LATEST_CONTACT
    assert np.isfinite(found.contact)


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 100_000), st.sampled_from(MODELS))
def test_what_is_executed_keeps_the_limits_and_a_clear_command_is_taken(seed, model):
    rng = np.random.default_rng(seed)
    speed = rng.uniform(0, 1)
    robot = Robot(np.zeros(2), np.array([speed, 0.0]), heading=0.0, model=model)
    people = belief(*np.hstack([rng.uniform(-3, 3, (3, 2)), rng.normal(0, 0.6, (3, 2))]))
    assume(np.linalg.norm(people.mean[:, :2], axis=1).min() > 0.6)
    scenario = Scenario(robot)
    found = guarded(scenario, people)
    trajectory = found.trajectory
    assert model.problems(robot, trajectory) == []
    times = trajectory.times
    where = people.predict(times)[0][..., :2]
    gap = np.linalg.norm(where - trajectory.positions[:, None], axis=-1).min(axis=1) - 0.55
    if found.tier is not Tier.LATEST_CONTACT:
        assert gap[times <= Guard().escape].min() >= -1e-6
        assert gap[times < found.contact].min() >= -1e-6
        assert found.contact > Guard().escape
    if found.tier in (Tier.CLEAR, Tier.AVOIDING):
        assert found.contact == np.inf
    if found.tier is Tier.CLEAR:
        assert gap.min() >= min(Guard().margin, gap[0]) - 1e-6
    if found.tier is Tier.LATEST_CONTACT:
        assert found.contact <= times[-1] or np.isinf(found.contact)


@pytest.mark.parametrize("model", MODELS)
def test_commands_are_driven_within_the_limits(model):
    robot = Robot(np.zeros(2), np.array([0.4, 0.0]), heading=0.0, model=model)
    now = model.state(robot, 0.0)
    fan = model.commands(robot, now)
    times = 0.1 * np.arange(16)
    states = model.driven(robot, now, np.repeat(fan[:, None], 15, axis=1), times)
    assert states.shape == (len(fan), 16, model.dim)
    for each in states:
        assert model.problems(robot, model.trajectory(times, each)) == []


def test_without_lag_the_speed_is_there_at_once():
    robot = Robot(np.zeros(2), max_acceleration=1e6)
    states = Holonomic().driven(
        robot, robot.state, np.full((1, 1, 2), 0.5), np.array([0.0, 0.2]), lag=0.0
    )
    np.testing.assert_allclose(states[0, 1], [0.1, 0.1, 0.5, 0.5])
