"""A way out touches nobody, is driven within the limits, and is found where there is one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgplan import CarLike, DifferentialDrive, OccupancyGrid, Robot, Scenario
from fgplan.crowd import Belief
from fgplan.driving import Detection, Observation, Planner, Settings
from fgplan.driving.guard import Judge, Tier
from fgplan.driving.way_out import WayOut
from fgplan.safety import People, check
from fgplan.trajectory import Trajectory


def people(*rows):
    mean = np.array(rows, dtype=float).reshape(-1, 4)
    n = len(mean)
    covariance = np.tile(np.diag([1e-4, 1e-4, 1e-4, 1e-4]), (n, 1, 1))
    return Belief(tuple(f"p{i}" for i in range(n)), mean, covariance, np.full(n, 0.3), 0.03)


def moving(speed=1.0, **changes):
    return Scenario(Robot(np.zeros(2), np.array([speed, 0.0]), heading=0.0), **changes)


def onward(scenario):
    """On at the speed of now."""
    times = scenario.density.times
    return Trajectory(
        times,
        times[:, None] * scenario.robot.velocity,
        np.tile(scenario.robot.velocity, (len(times), 1)),
    )


def expected(belief, times):
    return People(times, belief.expected(times), belief.radii)


def corridor(width):
    """Along the x axis."""
    low, high = -width / 2, width / 2
    walls = [
        [(-3, low - 0.3), (9, low - 0.3), (9, low), (-3, low)],
        [(-3, high), (9, high), (9, high + 0.3), (-3, high + 0.3)],
    ]
    return OccupancyGrid.from_polygons(walls, bounds=(-3, -3, 9, 3), resolution=0.05)


def test_where_nobody_is_the_way_is_what_is_wanted():
    scenario = moving(0.9)
    found = WayOut().search(scenario, people(), onward(scenario))
    np.testing.assert_allclose(
        found.states, onward(scenario).resampled(found.times).states, atol=1e-9
    )


def test_who_is_met_is_passed_with_the_margin():
    scenario, crowd = moving(), people([4.0, 0.1, -1.3, 0.0])
    found = WayOut().search(scenario, crowd, onward(scenario))
    result = check(scenario, found, expected(crowd, scenario.density.times))
    assert result.feasible
    assert result.min_separation > 0.25 + 0.3 + 0.1
    # To make way costs less than to stay behind.
    assert found.positions[-1, 0] > 3.0


def test_a_way_through_people_who_leave_one_late_gap_is_found():
    """Two abreast in a corridor, and a gap at one wall behind them: only who waits gets through."""
    scenario = moving(0.5, grid=corridor(2.4))
    crowd = people([2.5, 0.8, -0.4, 0.0], [2.5, -0.2, -0.4, 0.0], [4.5, -0.8, -0.4, 0.0])
    found = WayOut().search(scenario, crowd, onward(scenario))
    assert found is not None
    assert check(scenario, found, expected(crowd, scenario.density.times)).feasible
    judge = Judge(scenario, crowd, 0.1)
    assert judge.clear(found).tier is Tier.AVOIDING


def test_where_every_way_ends_there_is_none():
    """Four abreast fill the corridor, faster than the robot can run from them."""
    scenario = moving(0.0, grid=corridor(2.4))
    crowd = people(*([1.2, y, -1.5, 0.0] for y in (-0.9, -0.3, 0.3, 0.9)))
    assert WayOut().search(scenario, crowd, onward(scenario)) is None


def test_the_first_margin_with_which_there_is_a_way_is_taken():
    scenario, crowd = moving(), people([4.0, 0.1, -1.3, 0.0])
    whole = WayOut(margins=(0.15,)).search(scenario, crowd, onward(scenario))
    for margins in ((5.0, 0.15), (0.15, 5.0)):
        found = WayOut(margins=margins).search(scenario, crowd, onward(scenario))
        np.testing.assert_array_equal(found.states, whole.states)


def test_who_is_too_near_already_is_left():
    scenario, crowd = moving(0.0), people([0.5, 0.0, 0.0, 0.0])
    found = WayOut().search(scenario, crowd, onward(scenario))
    gap = np.linalg.norm(found.positions - [0.5, 0.0], axis=1)
    assert np.all(np.diff(gap) > -1e-6)
    assert gap[-1] >= 0.55


@given(st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_what_is_found_is_within_the_limits_and_clear(seed):
    rng = np.random.default_rng(seed)
    scenario = moving(rng.uniform(0, 1), grid=corridor(rng.uniform(1.5, 4.0)))
    n = rng.integers(1, 8)
    rows = np.column_stack(
        [
            rng.uniform(1, 7, n),
            rng.uniform(-1, 1, n),
            rng.normal(-1, 0.4, n),
            0.2 * rng.normal(size=n),
        ]
    )
    crowd = people(*rows)
    found = WayOut().search(scenario, crowd, onward(scenario))
    if found is None:
        return
    assert scenario.robot.model.problems(scenario.robot, found) == []
    looks = np.linspace(0, found.times[-1], 4 * (len(found.times) - 1) + 1)
    gap = (
        np.linalg.norm(crowd.expected(looks)[..., :2] - found.at(looks)[:, None, :2], axis=-1)
        - 0.55
    )
    assert np.all(gap >= np.minimum(0.0, gap[0]) - 1e-3)


def test_more_ways_are_followed_where_a_few_all_end():
    scenario, crowd = moving(0.5, grid=corridor(2.4)), people([2.5, 0.8, -0.4, 0.0])
    crowd = people([2.5, 0.8, -0.4, 0.0], [2.5, -0.2, -0.4, 0.0], [4.5, -0.8, -0.4, 0.0])
    assert WayOut(most=(1,)).search(scenario, crowd, onward(scenario)) is None
    found = WayOut(most=(1, 300)).search(scenario, crowd, onward(scenario))
    wide = WayOut(most=(300,)).search(scenario, crowd, onward(scenario))
    np.testing.assert_array_equal(found.states, wide.states)


def test_it_ends_when_the_time_is_up():
    scenario, crowd = moving(), people([4.0, 0.1, -1.3, 0.0])
    assert WayOut().search(scenario, crowd, onward(scenario), until=0.0) is None
    assert WayOut().search(scenario, crowd, onward(scenario), until=np.inf) is not None


def test_where_all_end_the_longest_is_taken_if_it_is_as_long_as_a_plan():
    """A wall of people who are slower than the robot comes on, and behind it there is a wall."""
    scenario = moving(0.0, grid=corridor(2.4))
    for speed, times in ((-0.6, 5.0), (-1.5, None)):
        crowd = people(*([2.0, y, speed, 0.0] for y in (-0.9, -0.3, 0.3, 0.9)))
        found = WayOut(horizon=14.0).search(scenario, crowd, onward(scenario))
        if times is None:
            assert found is None
        else:
            assert times <= found.times[-1] < 14.0


class Nothing:
    """Looks for a way out, and finds none."""

    def search(self, *_):
        return None


def approached():
    """Four walk at the robot in a corridor: the scenario, where they are, and how they move."""
    scenario = moving(
        1.0, grid=corridor(2.4), goal=np.array([8.0, 0.0]), crowd="predicted", count=1
    )
    places = np.array([(3.6, 0.2), (3.2, -0.8), (2.1, 0.6), (2.9, 0.6)])
    return scenario, places, np.array([-1.3, 0.0])


def seen(places, velocity):
    return tuple(Detection(place, str(i), velocity=velocity) for i, place in enumerate(places))


def test_a_planner_takes_it_where_no_plan_is_clear():
    scenario, places, toward = approached()

    def first(way_out):
        planner = Planner(scenario, Settings(deadline=None, way_out=way_out))
        robot = np.zeros(2), np.array([1.0, 0.0])
        return planner.step(Observation(0.0, *robot, detections=seen(places, toward)))

    with_it, without = first(WayOut()), first(None)
    assert not with_it.mixture.components[0].feasible
    assert with_it.action.safe
    assert with_it.reason.endswith("its command is not clear: a way out")
    assert without.reason.endswith("its command is not clear: the nearest clear one")
    assert with_it.trajectory.times[-1] > 4.0 > without.trajectory.times[-1]
    crowd = people(*([*place, *toward] for place in places))
    others = expected(crowd, scenario.density.times)
    assert check(scenario, with_it.trajectory, others).first_contact == np.inf


@pytest.mark.parametrize("model", [DifferentialDrive(), CarLike()])
def test_a_robot_with_wheels_takes_it_as_its_wheels_allow(model):
    """Which a way of a robot that moves in any direction may be: it is checked as it is driven."""
    scenario, places, toward = approached()
    robot = replace(scenario.robot, heading=0.0, model=model)
    planner = Planner(scenario.replace(robot=robot), Settings(deadline=None))
    seen_now = seen(places, toward)
    decision = planner.step(Observation(0.0, np.zeros(2), robot.velocity, 0.0, detections=seen_now))
    assert not decision.mixture.components[0].feasible
    assert "Error" not in decision.reason
    assert model.problems(robot, decision.trajectory) == []


def test_it_goes_on_while_it_is_clear_where_none_is_found_anew():
    scenario, places, toward = approached()
    planner = Planner(scenario, Settings(deadline=None))
    robot = np.zeros(2), np.array([1.0, 0.0])
    way = planner.step(Observation(0.0, *robot, detections=seen(places, toward))).trajectory
    planner.settings = replace(planner.settings, way_out=Nothing())
    now, place = 0.1, way.at(0.1)
    later = seen(places + now * toward, toward)
    decision = planner.step(Observation(now, place[:2], place[2:], detections=later))
    assert not decision.mixture.components[0].feasible
    assert decision.action.safe
    assert decision.reason.endswith("its command is not clear: what is left of the last plan")
    np.testing.assert_allclose(decision.trajectory.at(1.0), way.at(now + 1.0), atol=0.1)
    planner.settings = replace(planner.settings, way_out=None)
    without = planner.step(Observation(0.2, *np.split(way.at(0.2), 2), detections=later))
    assert np.linalg.norm(without.trajectory.at(1.0) - way.at(1.2)) > 0.1
