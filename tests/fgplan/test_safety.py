"""The hard check and the stop, against fine sampling and physics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from fgplan import OccupancyGrid, Robot, Scenario, Trajectory
from fgplan.safety import BRAKING_SHARES, CHECK_SPACING, People, brake, check
from tests.scenes import blocks, forked

REACH = 0.55
"""Robot 0.25 m and person 0.3 m."""


def line(start: tuple[float, float], velocity: tuple[float, float], times: np.ndarray):
    """Constant velocity, as states (S, 4)."""
    position = np.array(start) + times[:, None] * np.array(velocity)
    return np.hstack([position, np.tile(velocity, (len(times), 1))])


def driven(start, velocity, times) -> Trajectory:
    return Trajectory.from_states(times, line(start, velocity, times))


def people(times: np.ndarray, *states: np.ndarray) -> People:
    stacked = np.stack(states, axis=1) if states else np.zeros((len(times), 0, 4))
    return People(times, stacked, np.full(len(states), 0.3))


def scenario(velocity=(0.8, 0.0), grid: OccupancyGrid | None = None, **robot: float) -> Scenario:
    return Scenario(Robot(np.zeros(2), np.array(velocity), **robot), grid=grid)


def test_a_person_stepped_through_between_two_states_is_a_contact():
    times = np.array([0.0, 2.0])
    robot = driven((0, 0), (1.2, 0), times)
    standing = people(times, line((1.2, 0.0), (0, 0), times))
    assert np.linalg.norm(robot.positions - [1.2, 0.0], axis=1).min() > 2 * REACH
    result = check(scenario((1.2, 0)), robot, standing)
    assert not result.feasible
    assert result.min_separation < 1.2 * CHECK_SPACING / 2
    touch = (1.2 - REACH) / 1.2
    assert touch <= result.first_contact <= touch + CHECK_SPACING
    assert "person" in result.problems[0]
    assert f"{result.first_contact:.2f}" in result.problems[0]


def test_people_who_swap_places_with_the_robot_are_met_half_way():
    times = np.array([0.0, 2.0])
    robot = driven((0, 0), (1.0, 0), times)
    towards = people(times, line((2.0, 0.0), (-1.0, 0), times))
    result = check(scenario((1.0, 0)), robot, towards)
    touch = (2.0 - REACH) / 2.0
    assert touch <= result.first_contact <= touch + CHECK_SPACING


def test_a_wall_stepped_through_between_two_states_is_a_contact():
    thin = np.array([[1.15, -1.0], [1.25, -1.0], [1.25, 1.0], [1.15, 1.0]])
    grid = OccupancyGrid.from_polygons([thin], (-2, -3, 5, 3), 0.05)
    times = np.array([0.0, 2.0])
    result = check(scenario(grid=grid), driven((0, 0), (1.2, 0), times), people(times))
    assert not result.feasible
    assert result.clearance < -0.2
    assert result.first_contact == pytest.approx((1.15 - 0.25) / 1.2, abs=2 * CHECK_SPACING)
    assert "obstacle" in result.problems[0]


@pytest.mark.parametrize("seed", range(20))
def test_check_agrees_with_sampling_every_millisecond(seed):
    rng = np.random.default_rng(seed)
    times = 0.4 * np.arange(9)
    position = np.cumsum(rng.normal(0.3, 0.2, (9, 2)), axis=0) - 0.3
    robot = Trajectory(times, position, rng.normal(0.7, 0.3, (9, 2)))
    states = [
        np.hstack([position[::-1] + rng.normal(0, 1.5, 2), rng.normal(0, 0.5, (9, 2))])
        for _ in range(3)
    ]
    result = check(scenario(), robot, people(times, *states))
    fine = np.linspace(0, times[-1], 3201)
    path = CubicHermiteSpline(times, robot.positions, robot.velocities)
    curves = [CubicHermiteSpline(times, s[:, :2], s[:, 2:]) for s in states]
    distance = np.stack([np.linalg.norm(c(fine) - path(fine), axis=1) for c in curves], axis=1)
    quickest = np.linalg.norm(
        np.stack([c(fine, 1) - path(fine, 1) for c in curves], axis=1), axis=-1
    ).max()
    slack = quickest * CHECK_SPACING / 2
    assert distance.min() - 1e-9 <= result.min_separation <= distance.min() + slack
    entered = np.any((distance < REACH) & (distance < distance[0]), axis=1)
    if np.any(distance.min(axis=0) < np.minimum(distance[0], REACH) - slack):
        first = fine[np.argmax(entered)]
        assert first - 1e-9 <= result.first_contact
        assert not result.feasible
    elif not entered.any():
        assert result.first_contact == np.inf


def test_nobody_about_and_no_map_is_infinitely_far():
    times = 0.4 * np.arange(4)
    result = check(scenario(), driven((0, 0), (0.8, 0), times), people(times))
    assert result.feasible
    assert result.min_separation == result.clearance == result.first_contact == np.inf


def test_clearance_is_the_gap_between_edge_and_wall():
    times = 0.4 * np.arange(6)
    # The block begins at x = 3.4, 1.4 m ahead in the end, and occupies the cell it touches.
    result = check(scenario(grid=blocks()), driven((0, 0), (1.0, 0), times), people(times))
    assert result.clearance == pytest.approx(3.3 - 2.0 - 0.25, abs=1e-9)


LEAVING = [
    ((-0.8, 0.0), True),  # away
    ((0.0, 0.0), True),  # standing still
    ((0.0, 0.8), True),  # sideways, which leads away
    ((0.8, 0.0), False),  # deeper
]


@pytest.mark.parametrize(("velocity", "fine"), LEAVING)
def test_a_contact_with_a_person_may_be_left_but_not_deepened(velocity, fine):
    times = 0.4 * np.arange(4)
    touching = people(times, line((0.4, 0.0), (0, 0), times))
    result = check(scenario(velocity), driven((0, 0), velocity, times), touching)
    assert result.feasible is fine
    assert (result.first_contact == np.inf) is fine


@pytest.mark.parametrize(("velocity", "fine"), LEAVING)
def test_a_contact_with_a_wall_may_be_left_but_not_deepened(velocity, fine):
    wall = np.array([[0.2, -5.0], [0.5, -5.0], [0.5, 5.0], [0.2, 5.0]])
    grid = OccupancyGrid.from_polygons([wall], (-5, -5, 5, 5), 0.1)
    times = 0.4 * np.arange(4)
    result = check(scenario(velocity, grid), driven((0, 0), velocity, times), people(times))
    assert result.feasible is fine


def test_who_leaves_one_contact_must_not_run_into_the_next():
    times = 0.4 * np.arange(4)
    two = people(times, line((0.4, 0.0), (0, 0), times), line((-1.3, 0.0), (0, 0), times))
    result = check(scenario((-1.0, 0)), driven((0, 0), (-1.0, 0), times), two)
    assert not result.feasible
    assert result.first_contact == pytest.approx(1.3 - REACH, abs=1.01 * CHECK_SPACING)


def test_a_contact_once_left_must_not_be_taken_up_again():
    times = np.array([0.0, 1.0, 2.0])
    touching = people(times, line((0.4, 0.0), (0, 0), times))
    there = Trajectory(times, [[0, 0], [-1.0, 0], [0.0, 0]], [[-1.0, 0], [0, 0], [1.0, 0]])
    result = check(scenario((-1.0, 0)), there, touching)
    assert not result.feasible
    assert 1.0 < result.first_contact < 2.0


def test_speed_and_acceleration_limits_are_checked():
    times = 0.4 * np.arange(4)
    speed = np.array([0.8, 1.1, 1.3, 1.1])[:, None] * [1.0, 0.0]
    position = np.vstack([np.zeros(2), np.cumsum(0.2 * (speed[1:] + speed[:-1]), axis=0)])
    problems = check(scenario(), Trajectory(times, position, speed), people(times)).problems
    assert len(problems) == 1
    assert problems[0].startswith("speed 1.30 m/s above 1.20")
    sharp = check(
        scenario(max_acceleration=0.7, max_speed=1.4),
        Trajectory(times, position, speed),
        people(times),
    ).problems
    assert len(sharp) == 1
    assert sharp[0].startswith("acceleration 0.75 m/s² above 0.70")


def test_a_turn_on_the_spot_is_an_acceleration():
    times = 0.4 * np.arange(2)
    turned = Trajectory(times, [[0, 0], [0.2, 0.2]], [[0.8, 0], [0, 0.8]])
    assert any("acceleration 2.83" in p for p in check(scenario(), turned, people(times)).problems)


def test_a_robot_too_fast_may_slow_down_and_must_not_get_faster():
    times = 0.4 * np.arange(4)

    def with_speeds(*speeds: float):
        v = np.array(speeds)[:, None] * [1.0, 0.0]
        position = np.vstack([np.zeros(2), np.cumsum(0.2 * (v[1:] + v[:-1]), axis=0)])
        return check(scenario((speeds[0], 0)), Trajectory(times, position, v), people(times))

    assert with_speeds(2.0, 1.5, 1.1, 1.0).feasible
    assert not with_speeds(2.0, 2.1, 1.6, 1.2).feasible
    assert not with_speeds(1.6, 1.2, 1.4, 1.2).feasible  # slowed down, then too fast again


@pytest.mark.parametrize("speed", [0.0, 0.3, 0.8, 1.2, 2.5])
@pytest.mark.parametrize("direction", [0.0, 2.0, -1.3])
def test_a_stop_ends_within_the_braking_distance(speed, direction):
    heading = np.array([np.cos(direction), np.sin(direction)])
    stop, result = brake(scenario(speed * heading), people(np.zeros(1)))
    length = speed**2 / (2 * 1.5)
    assert result.feasible
    np.testing.assert_allclose(stop.positions[-1], length * heading, atol=1e-9)
    np.testing.assert_allclose(stop.velocities[-1], 0, atol=1e-12)
    np.testing.assert_array_equal(stop.states[0], [0, 0, *(speed * heading)])
    # The cubic between two states may overshoot where the robot comes to rest in between, by
    # 4/27 of what the last velocity would still cover in a step.
    along = stop.at(np.linspace(0, stop.times[-1], 500))[:, :2] @ heading
    assert along.max() <= length + 0.4 * 0.6 * 4 / 27


def test_a_robot_at_rest_stays_where_it_is():
    stop, result = brake(scenario((0.0, 0.0)), people(np.zeros(1)))
    assert result.feasible
    np.testing.assert_array_equal(stop.states, 0.0)


def test_gentler_braking_is_taken_where_the_hardest_is_not_safe():
    """Somebody crosses just where the hardest braking ends, after a robot that goes on a little
    has passed."""
    state = scenario((1.2, 0.0))
    times = state.density.times
    crossing = people(times, line((0.3, -2.0), (0.0, 1.0), times))
    hard = 1.2**2 / (2 * 1.5)
    assert abs(hard - 0.3) < REACH  # would stand in the way
    stop, result = brake(state, crossing)
    assert result.feasible
    length = stop.positions[-1, 0]
    shares = {share: 1.2**2 / (2 * share * 1.5) for share in BRAKING_SHARES}
    clear = [reach for reach in shares.values() if reach - 0.3 > REACH]
    assert length == pytest.approx(min(clear), abs=1e-6)


def test_where_no_stop_is_clear_the_one_that_stays_clear_longest_is_returned():
    state = scenario((1.2, 0.0))
    times = state.density.times
    ahead = people(times, line((0.8, 0.0), (0.0, 0.0), times))
    stop, result = brake(state, ahead)
    assert not result.feasible
    assert "contact with a person" in result.problems[0]
    assert result.first_contact < np.inf
    assert stop.positions[-1, 0] == pytest.approx(0.48)  # the hardest one


def test_people_run_into_a_robot_that_stands():
    state = scenario((0.0, 0.0))
    times = state.density.times
    _, result = brake(state, people(times, line((3.0, 0.0), (-1.0, 0.0), times)))
    assert not result.feasible
    assert result.first_contact == pytest.approx(3.0 - REACH, abs=1.01 * CHECK_SPACING)


def test_a_stop_at_the_mercy_of_a_wall_is_not_safe():
    thin = np.array([[0.5, -1.0], [0.7, -1.0], [0.7, 1.0], [0.5, 1.0]])
    grid = OccupancyGrid.from_polygons([thin], (-2, -3, 5, 3), 0.05)
    stop, result = brake(scenario((1.2, 0.0), grid), people(np.zeros(1)))
    assert not result.feasible
    assert "obstacle" in result.problems[0]
    assert np.isfinite(stop.states).all()


def test_a_check_does_not_depend_on_the_scenarios_own_people():
    times = 0.4 * np.arange(4)
    robot = driven((0, 0), (0.8, 0), times)
    one = check(forked(), robot, people(times))
    other = check(scenario(), robot, people(times))
    assert one == other
