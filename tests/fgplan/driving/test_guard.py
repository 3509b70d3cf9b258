"""What is executed is what is checked, and a clear command is taken where there is one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fgplan import CarLike, DifferentialDrive, Holonomic, OccupancyGrid, Robot, Scenario
from fgplan.crowd import Belief, heading
from fgplan.driving.following import at_start_of
from fgplan.driving.guard import Guard, Judge, Tier
from fgplan.safety import People, check, contacts
from fgplan.timing import timed

PERIOD = 0.1
MODELS = [Holonomic(), DifferentialDrive(), CarLike()]


def belief(*people, spread=0.01):
    """People known to the centimetre, rows (x, y, vx, vy), and their velocities to a spread."""
    mean = np.array(people, dtype=float).reshape(-1, 4)
    n = len(mean)
    names = tuple(f"p{i}" for i in range(n))
    covariance = np.diag([1e-4, 1e-4, spread**2, spread**2])
    return Belief(names, mean, np.tile(covariance, (n, 1, 1)), np.full(n, 0.3), 0.03)


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


def test_who_has_left_a_contact_is_in_contact_again_for_the_guard_as_for_the_hard_check():
    """The robot begins 0.1 m within one wall, leaves it, and ends within another one."""
    walls = [
        [(-1.0, -1.0), (-0.15, -1.0), (-0.15, 1.0), (-1.0, 1.0)],
        [(0.7, -1.0), (1.0, -1.0), (1.0, 1.0), (0.7, 1.0)],
    ]
    grid = OccupancyGrid.from_polygons(walls, (-1, -1, 1, 1), 0.05)
    scenario = moving(1.2, grid=grid)
    robot = scenario.robot
    stop = robot.model.braking(robot, robot.state, 0.1 * np.arange(49), 1.0)
    gap = grid.clearance(stop.positions, robot.radius)
    assert gap[0] < gap[-1] < 0 < gap.max()
    times = scenario.density.times
    nobody = People(times, np.zeros((len(times), 0, 4)), np.zeros(0))
    judge = Judge(scenario, belief(), PERIOD)
    assert not check(scenario, stop, nobody).feasible
    assert judge.clear(stop) is None
    assert judge.command(stop, nobody).tier is not Tier.CLEAR


@given(st.lists(st.floats(-0.5, 0.5), min_size=1, max_size=8))
def test_a_contact_is_what_is_nearer_than_at_first_or_comes_again(gaps):
    left, expected = False, []
    for gap in gaps:
        left |= gap >= 0
        expected.append(gap < (0.0 if left else min(gaps[0], 0.0)) - 1e-6)
    assert contacts(np.array(gaps)[:, None])[:, 0].tolist() == expected


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("away", "tier"), [(6.25, Tier.PASSING), (8.0, Tier.CLEAR)])
def test_a_stop_that_takes_longer_than_the_look_ahead_is_looked_at_to_its_end(away, tier, model):
    """From 1.2 m/s at 0.1 m/s² the robot needs 7.3 m and 12 s."""
    wall = [(away + 0.25, -8.0), (9.0, -8.0), (9.0, 8.0), (away + 0.25, 8.0)]
    grid = OccupancyGrid.from_polygons([wall], (-2, -8, 9, 8), 0.05)
    robot = Robot(np.zeros(2), np.array([1.2, 0.0]), 0.0, max_acceleration=0.1, model=model)
    assert guarded(Scenario(robot, grid=grid), belief()).tier is tier


def test_a_car_stops_when_its_wheels_are_straight():
    """Which takes 8 s, where its brakes take less than one."""
    model = CarLike(max_yaw_acceleration=0.1)
    robot = Robot(np.zeros(2), np.array([1.0, 0.0]), 0.0, yaw_rate=0.8, model=model)
    scenario = Scenario(robot)
    times, stop = Judge(scenario, belief(), PERIOD)._stops(model.state(robot, 0.0)[None])
    assert times[-1] >= 8.0
    assert np.abs(stop[0, -1, 3:]).max() < 1e-3


def test_where_no_straight_way_is_clear_a_turn_is():
    """A corridor with a bend, and somebody who comes up fast from behind."""
    walls = [
        [(-3.0, 0.4), (0.3, 0.4), (0.3, 3.0), (-3.0, 3.0)],
        [(-3.0, -0.6), (3.0, -0.6), (3.0, -0.4), (-3.0, -0.4)],
        [(1.1, -0.4), (3.0, -0.4), (3.0, 3.0), (1.1, 3.0)],
    ]
    grid = OccupancyGrid.from_polygons(walls, (-3, -1, 3, 4), 0.05)
    scenario, person = moving(grid=grid), belief([-0.9, 0.0, 0.8, 0.0])
    assert guarded(scenario, person, settings=Guard(turn=np.inf)).tier is Tier.YIELDING
    found = guarded(scenario, person)
    assert found.tier is Tier.AVOIDING
    assert grid.clearance(found.trajectory.positions, 0.25).min() >= -1e-6


def test_a_clearance_below_the_margin_does_not_refuse_a_plan_that_leads_out_of_it():
    scenario = moving(0.5)
    found = guarded(scenario, belief([-0.58, 0.0, 0.0, 0.0]))
    assert found.tier is Tier.CLEAR


def ring(distance, speed):
    """Eight people who close in on the robot from all around."""
    angle = np.pi / 4 * np.arange(8)
    out = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return belief(*np.hstack([distance * out, -speed * out]))


def test_boxed_in_at_rest_it_stays_at_rest_and_is_not_at_fault():
    found = guarded(moving(0.0), ring(0.7, 1.0))
    assert found.tier is Tier.YIELDING
    assert np.isfinite(found.contact)
    speed = np.linalg.norm(found.trajectory.velocities, axis=1)
    assert speed[found.trajectory.times >= found.contact].max() == 0


def test_boxed_in_too_fast_to_stop_it_says_that_nothing_is_clear():
    found = guarded(moving(1.0), ring(0.8, 0.5))
    assert found.tier is Tier.LATEST_CONTACT
    assert np.isfinite(found.contact)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("behind", "speed"), [(0.9, 1.6), (0.9, 1.2), (0.65, 1.2), (1.2, 1.6)])
def test_chased_into_a_dead_end_it_does_not_run_into_the_wall(behind, speed, model):
    """Somebody comes up from behind: of all contacts the one with the wall would be the latest."""
    walls = [
        [(-6.0, 0.4), (3.0, 0.4), (3.0, 0.6), (-6.0, 0.6)],
        [(-6.0, -0.6), (3.0, -0.6), (3.0, -0.4), (-6.0, -0.4)],
        [(1.3, -0.5), (1.5, -0.5), (1.5, 0.5), (1.3, 0.5)],
    ]
    grid = OccupancyGrid.from_polygons(walls, (-6, -1, 3, 1), 0.05)
    robot = Robot(np.zeros(2), np.array([1.0, 0.0]), heading=0.0, model=model)
    scenario, tiers = Scenario(robot, grid=grid), set()
    for k in range(16):
        found = guarded(scenario, belief([speed * k * PERIOD - behind, 0.0, speed, 0.0]))
        tiers.add(found.tier)
        after = found.trajectory.resampled(found.trajectory.times[found.step :])
        robot = at_start_of(after, robot)
        scenario = scenario.replace(robot=robot)
        assert grid.clearance(robot.position[None], robot.radius)[0] >= -1e-6
    assert Tier.LATEST_CONTACT in tiers


def test_who_is_close_behind_is_run_away_from():
    scenario = moving(1.0)
    found = guarded(scenario, belief([-0.6, 0.0, 1.0, 0.0]))
    assert found.tier is Tier.PASSING
    assert found.contact == np.inf
    assert room(scenario, belief([-0.6, 0.0, 1.0, 0.0]), found.trajectory) < 0


def test_who_comes_too_fast_to_stop_for_is_passed_by_going_on():
    """A robot that could be at rest in time would be run into where it stands."""
    robot = Robot(np.zeros(2), np.array([0.0, 1.0]), 0.0, max_speed=2.0, max_acceleration=2.0)
    person = belief([1.6, 0.2, -2.2, 0.0], spread=0.1)
    found = guarded(Scenario(robot), person)
    assert found.tier is Tier.PASSING
    where = person.predict(found.trajectory.times)[0][:, 0, :2]
    gap = np.linalg.norm(found.trajectory.positions - where, axis=1) - 0.55
    assert gap.min() >= 0.1
    assert room(Scenario(robot), person, found.trajectory) < 0


def test_who_stands_near_does_not_hold_the_robot_for_ever():
    """At a corner robot and person stood 6 cm apart, and no motion had two deviations of room."""
    person, robot = belief([0.3, 0.53, 0.0, 0.0], spread=0.1), Robot(np.zeros(2), heading=0.0)
    for _ in range(40):
        scenario = Scenario(robot)
        ahead = robot.position + np.array([[0.0, 0.0], [4.0, 0.0]])
        plan = timed(ahead, scenario.density.times, 1.0, 1.0, robot.velocity)
        found = guarded(scenario, person, plan)
        assert found.tier is not Tier.LATEST_CONTACT
        x, y, *velocity = found.trajectory.at(PERIOD)
        robot = replace(robot, position=np.array([x, y]), velocity=np.array(velocity))
        assert np.hypot(x - 0.3, y - 0.53) > 0.55
    assert robot.position[0] > 1.0


def room(scenario, people, trajectory):
    """Standard deviations that are left when the robot brakes after a period, step by step."""
    robot = scenario.robot
    x, t = np.concatenate([trajectory.at(PERIOD)[:2], trajectory.at(PERIOD)[2:]]), PERIOD
    least, variance = np.inf, people.covariance[0, 0, 0]
    while True:
        mean, covariance = people.predict(np.array([t]))
        gap = np.linalg.norm(mean[0, :, :2] - x[:2], axis=1).min() - 0.55
        spread = np.sqrt(covariance[0, 0, 0, 0] - variance)
        least = min(least, np.inf if gap > Guard().most else gap / spread)
        speed = np.linalg.norm(x[2:])
        if speed < 1e-9:
            return least
        slower = x[2:] * max(0.0, 1 - 0.05 * robot.max_acceleration / speed)
        x, t = np.concatenate([x[:2] + 0.025 * (x[2:] + slower), slower]), t + 0.05


def test_where_no_stop_leaves_enough_room_the_clear_command_with_the_most_is_taken():
    """Somebody walks beside the robot, nearer than two standard deviations of a stop."""
    scenario, beside = moving(1.0), belief([-0.1, 0.6, 1.0, 0.0], spread=0.1)
    found = guarded(scenario, beside)
    assert found.tier is Tier.AVOIDING
    own, taken = (room(scenario, beside, t) for t in (straight(scenario), found.trajectory))
    assert 0 < own < taken < Guard().sigmas


def test_who_is_walked_at_steps_away():
    found = guarded(moving(0.0), belief([0.65, 0.0, -0.4, 0.0]))
    assert found.tier is Tier.AVOIDING
    times = found.trajectory.times
    where = np.stack([0.65 - 0.4 * times, 0.0 * times], axis=1)
    assert np.linalg.norm(found.trajectory.positions - where, axis=1).min() > 0.55


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
    if found.tier not in (Tier.YIELDING, Tier.LATEST_CONTACT):
        assert gap[times <= Guard().escape].min() >= -1e-6
        assert gap[times < found.contact].min() >= -1e-6
        assert found.contact > Guard().escape
    if found.tier in (Tier.CLEAR, Tier.AVOIDING, Tier.PASSING):
        assert found.contact == np.inf
    if found.tier is Tier.CLEAR:
        assert gap.min() >= min(Guard().margin, gap[0]) - 1e-6
    if found.tier is Tier.YIELDING:
        moving_on = np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1) > 1e-4
        assert gap[1:][moving_on].min(initial=np.inf) >= -1e-6
    if found.tier is Tier.LATEST_CONTACT:
        assert found.contact <= times[-1]


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


@given(
    st.lists(st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)), min_size=1, max_size=4),
    st.lists(st.integers(1, 4), min_size=4, max_size=4),
    st.sampled_from([0.0, 0.3, 0.5]),
    st.sampled_from([1.0, 20.0]),
)
def test_what_is_driven_at_once_is_what_is_driven_step_by_step(turns, lasting, lag, acceleration):
    wishes = np.repeat(turns, lasting[: len(turns)], axis=0)[None]
    times = 0.1 * np.arange(wishes.shape[1] + 1)
    robot = Robot(np.zeros(2), np.array([0.4, 0.0]), max_acceleration=acceleration)
    drive = Holonomic().driven
    state, one_by_one = robot.state, [robot.state]
    for k in range(wishes.shape[1]):
        state = drive(robot, state, wishes[:, k : k + 1], times[k : k + 2], lag)[0, 1]
        one_by_one.append(state)
    at_once = drive(robot, robot.state, wishes, times, lag)[0]
    np.testing.assert_allclose(at_once, one_by_one, rtol=0, atol=1e-12)
