"""The rules of a scenario built in Python: each mistake found, named, and found with the others."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgplan.errors import ScenarioError
from fgplan.measuring import Reading, Readings
from fgplan.occupancy import OccupancyGrid
from fgplan.regions import Region
from fgplan.scenario import Density, FieldOfView, GivenPlan, Level, Robot, Scenario, Track
from fgplan.validation import find_mistakes, placement, validate

LINE = np.array([[0.0, 0.0], [5.0, 0.0]])
ANNA = Track("anna", np.array([-0.4, 0.0]), np.array([[2.0, 1.0], [1.6, 1.0]]))
GOOD = Scenario(
    Robot(np.zeros(2), covariance=np.eye(4)),
    goal=np.array([5.0, 0.0]),
    tracks=(ANNA, replace(ANNA, identity="ben")),
    plans=(GivenPlan("a", LINE, 0.3), GivenPlan("b", LINE)),
    field_of_view=FieldOfView(),
    levels=(Level(), Level("tactics", sigma=np.inf)),
)
NUMBERS = [np.nan, np.inf, -np.inf, -1.0, "1", None, True]
POSITIVE = [*NUMBERS, 0.0, 1e-300, 1e300]
MAY_BE_INFINITE = ("contact_sigma", "obstacle_sigma", "limit_sigma", "range")


def found(scenario: Scenario) -> dict[str, str]:
    return {m.path: m.mend for m in find_mistakes(scenario)}


def robot(**changes: Any) -> Scenario:
    return GOOD.replace(robot=replace(GOOD.robot, **changes))


def density(**changes: Any) -> Scenario:
    return GOOD.replace(density=replace(Density(), **changes))


def track(**changes: Any) -> Scenario:
    return GOOD.replace(tracks=(replace(ANNA, **changes), GOOD.tracks[1]))


def level(**changes: Any) -> Scenario:
    return GOOD.replace(levels=(replace(Level(), **changes), GOOD.levels[1]))


def view(**changes: Any) -> Scenario:
    return GOOD.replace(field_of_view=replace(FieldOfView(), **changes))


def plan(**changes: Any) -> Scenario:
    return GOOD.replace(plans=(replace(GOOD.plans[0], **changes), GOOD.plans[1]))


def own(**changes: Any) -> Scenario:
    plans = (replace(GOOD.plans[0], **changes), GOOD.plans[1])
    return GOOD.replace(levels=(Level(), Level("tactics", sigma=0.3, plans=plans)))


def region(name: str) -> Scenario:
    return GOOD.replace(regions=(Region.disc(name, (1.0, 0.0), 0.5),))


def test_good_scenarios_pass() -> None:
    assert not found(GOOD)
    assert not found(Scenario(Robot(np.zeros(2))))
    assert not found(Scenario(Robot(np.zeros(2)), goal=np.zeros(2)))
    person = Track("on the robot", np.zeros(1), np.zeros((1, 2)))
    assert not found(GOOD.replace(tracks=(person,)))
    assert not found(robot(velocity=np.array([9.0, 0.0])))  # faster than max_speed now
    assert not found(density(t_ref=None, alpha=0, contact_sigma=np.inf, obstacle_sigma=np.inf))
    assert not found(density(alpha=1.0, contact_margin=0.0, limit_sigma=np.inf, beta=0.0))
    assert not found(view(range=np.inf, angle=2 * np.pi))


@pytest.mark.parametrize("value", POSITIVE)
@pytest.mark.parametrize(
    ("make", "path", "name"),
    [
        *((robot, "robot", name) for name in ("radius", "preferred_speed", "max_speed")),
        (robot, "robot", "max_acceleration"),
        *((density, "density", name) for name in ("dt", "horizon", "Qc_robot", "Qc_people", "h_c")),
        *((density, "density", name) for name in ("sigma_track", "sigma_speed", "t_ref")),
        *((density, "density", f"{name}_sigma") for name in ("contact", "obstacle", "limit")),
        (track, "people[0]", "radius"),
        *((level, "levels[0]", name) for name in ("length", "h")),
        *((view, "field_of_view", name) for name in ("range", "angle")),
    ],
)
def test_what_must_be_positive_is(make: Any, path: str, name: str, value: Any) -> None:
    scenario = make(**{name: value})
    if (value is None and name == "t_ref") or (value == np.inf and name in MAY_BE_INFINITE):
        assert not found(scenario)
    else:
        assert "give " in found(scenario)[f"{path}.{name}"]


@pytest.mark.parametrize("value", [v for v in NUMBERS if v is not None])
@pytest.mark.parametrize(
    ("make", "path", "name"),
    [
        *((density, "density", name) for name in ("contact_margin", "obstacle_margin", "beta")),
        (density, "density", "alpha"),
        (level, "levels[0]", "sigma"),
        (plan, "plans.given[0]", "weight"),
    ],
)
def test_what_must_not_be_negative_is_not(make: Any, path: str, name: str, value: Any) -> None:
    assert f"{path}.{name}" in found(make(**{name: value}))


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300])
@pytest.mark.parametrize(
    ("make", "path"),
    [
        (lambda p: robot(position=p), "robot.position"),
        (lambda p: robot(velocity=p), "robot.velocity"),
        (lambda p: GOOD.replace(goal=p), "goal.position"),
        (lambda p: plan(path=np.array([[0.0, 0.0], p])), "plans.given[0].path[1]"),
        (lambda p: track(positions=np.array([[0.0, 0.0], p])), "people[0].track[1]"),
        (lambda p: track(times=np.array([p[1], 0.0])), "people[0].track[0]"),
        (lambda p: robot(heading=p[1]), "robot.heading"),
        (lambda p: GOOD.replace(now=p[1]), "crowd.now"),
    ],
)
def test_numbers_are_finite_and_in_reach(make: Any, path: str, bad: float) -> None:
    assert path in found(make(np.array([0.0, bad])))


@pytest.mark.parametrize(
    ("scenario", "path", "mend"),
    [
        (robot(position=np.zeros(3)), "robot.position", "has shape (3,); give shape (2,)"),
        (robot(velocity="fast"), "robot.velocity", "give numbers, shape (2,)"),
        (GOOD.replace(goal=np.zeros((1, 2))), "goal.position", "give shape (2,)"),
        (robot(preferred_speed=1.3), "robot.preferred_speed", "at most robot.max_speed"),
        (robot(covariance=np.eye(2)), "robot.covariance", "give shape (4, 4)"),
        (robot(covariance=-np.eye(4)), "robot.covariance", "that is positive definite"),
        (robot(covariance=np.zeros((4, 4))), "robot.covariance", "that is positive definite"),
        (robot(covariance=np.triu(np.ones((4, 4)))), "robot.covariance", "that is symmetric"),
        (robot(covariance=np.full((4, 4), np.nan)), "robot.covariance", "give finite numbers"),
        (robot(covariance=1e-40 * np.eye(4)), "robot.covariance", "not nearly singular"),
        (density(horizon=0.1), "density.horizon", "give at least density.dt"),
        (density(dt=1e-6), "density.dt", "give at least horizon/2000"),
        (density(alpha=1.01), "density.alpha", "give a number from 0 to 1"),
        (GOOD.replace(goal_speed=-0.1), "goal.speed", "give a finite number, 0 or above"),
        (GOOD.replace(goal_speed=np.nan), "goal.speed", "give a finite number, 0 or above"),
        (GOOD.replace(goal_speed=1.01), "goal.speed", "is above preferred_speed, 1 m/s"),
        (GOOD.replace(count=-1), "plans.count", "from 0 to 100"),
        (GOOD.replace(count=10**6), "plans.count", "from 0 to 100"),
        (GOOD.replace(count=1.5), "plans.count", "give a whole number"),
        (GOOD.replace(count=True), "plans.count", "give a whole number"),
        (GOOD.replace(count=0, plans=()), "plans.count", "contradicts the goal"),
        (plan(path=LINE[:1]), "plans.given[0].path", "two vertices or more"),
        (plan(path=LINE.T[:, :1]), "plans.given[0].path", "give shape (N, 2)"),
        (plan(label="b"), "plans.given[1].label", "is also at plans.given[0].label"),
        (plan(label="left+right"), "plans.given[0].label", "has '+', which ends a name"),
        (plan(label="door/left"), "plans.given[0].label", "has '/', which ends a name"),
        (plan(label="a, waiting"), "plans.given[0].label", "has ', waiting'"),
        (own(label="door/left"), "levels[1].plans[0].label", "has '/', which ends a name"),
        (region("A+B"), "regions[0].name", "has '+', which ends a name; leave it out"),
        (region("A&B"), "regions[0].name", "has '&'"),
        (region("A>B"), "regions[0].name", "has '>'"),
        (region("A #1"), "regions[0].name", "has ' #'"),
        (plan(label=""), "plans.given[0].label", "give a name"),
        (
            GOOD.replace(plans=(GivenPlan("a", LINE, 0.0), GivenPlan("b", LINE, 0.0))),
            "plans.given",
            "a weight above 0",
        ),
        (GOOD.replace(crowd="both"), "crowd.mode", "give 'joint' or 'predicted'"),
        (GOOD.replace(pairs="none"), "crowd.pairs", "give 'all' or 'robot'"),
        (track(identity="ben"), "people[1].id", "is also at people[0].id"),
        (track(identity=7), "people[0].id", "give a name"),
        (track(times=np.zeros(0), positions=np.zeros((0, 2))), "people[0].track", "at least one"),
        (track(times=np.zeros(3)), "people[0].track", "give times of shape (m,)"),
        (track(positions="here"), "people[0].track", "give times of shape (m,)"),
        (track(times=np.array([0.0, 0.0])), "people[0].track[1]", "times must increase"),
        (track(times=np.array([0.0, 0.1])), "people[0].track[1]", "after crowd.now"),
        (view(angle=7.0), "field_of_view.angle", "at most 2π"),
        (view(occlusion=1), "field_of_view.occlusion", "give true or false"),
        (GOOD.replace(levels=()), "levels", "give at least one level"),
        (level(sigma=np.inf), "levels[0].sigma", "nothing else says where"),
        (level(name="tactics"), "levels[1].name", "is also at levels[0].name"),
    ],
)
def test_single_mistake_is_named_with_its_mend(scenario: Scenario, path: str, mend: str) -> None:
    wrong = found(scenario)
    assert list(wrong) == [path]
    assert mend in wrong[path]


def test_all_mistakes_are_in_one_error() -> None:
    scenario = robot(radius=-1.0).replace(goal=np.array([np.nan, 0.0]), now=np.nan, name="broken")
    with pytest.raises(ScenarioError, match="broken: 3 mistake") as caught:
        validate(scenario)
    paths = [m.path for m in caught.value.mistakes]
    assert paths == ["robot.radius", "goal.position", "crowd.now"]
    assert caught.value.mistakes[0].value == -1.0


@given(st.lists(st.floats(), min_size=1, max_size=6), st.floats())
def test_exactly_increasing_finite_times_up_to_now_pass(times: list[float], now: float) -> None:
    moved = track(times=np.array(times), positions=np.zeros((len(times), 2)))
    scenario = moved.replace(now=now, tracks=moved.tracks[:1])
    fine = (
        all(math.isfinite(t) and abs(t) <= 1e11 for t in [*times, now])
        and all(a < b for a, b in pairwise(times))
        and times[-1] <= now
    )
    assert (not found(scenario)) == fine


def test_placement_names_start_and_goal_that_the_map_refuses() -> None:
    grid = OccupancyGrid.from_polygons([[(1, -1), (2, -1), (2, 1), (1, 1)]], (-1, -3, 4, 3), 0.1)
    inside = GOOD.replace(grid=grid, robot=Robot(np.array([1.5, 0.0])))
    named = {m.path: m.mend for m in placement(inside)}
    assert "inside an obstacle" in named["robot.position"]
    assert "outside the map, x -1 to 4, y -3 to 3" in named["goal.position"]
    assert not list(placement(GOOD))
    assert not list(placement(GOOD.replace(grid=grid, goal=np.array([3.0, 0.0]))))
    assert not list(placement(GOOD.replace(grid=grid, goal=None)))


def test_plan_may_mend_a_start_that_placement_refuses() -> None:
    """`validate` leaves the map to the global planner: a robot may be pushed against a wall."""
    grid = OccupancyGrid.from_polygons([], (-1, -3, 4, 3), 0.1, border=True)
    assert not found(GOOD.replace(grid=grid, robot=Robot(np.array([-0.95, 0.0]))))


def data(on: str | None = None, **changes: Any) -> Scenario:
    good = Reading(1.0, np.array([2.0, 1.0]), 0.1 * np.eye(2))
    return GOOD.replace(data=(Readings((good,)), Readings((good, replace(good, **changes)), on)))


def test_good_data_passes() -> None:
    assert not found(data())
    assert not found(data(time=None))
    assert not found(data("robot", time=-3.0))
    assert not found(data("tactics", quantity="velocity"))


@pytest.mark.parametrize(
    ("name", "value", "mend"),
    [
        ("time", np.nan, "time in seconds"),
        ("time", "now", "time in seconds"),
        ("value", np.array([np.nan, 0.0]), "finite numbers"),
        ("value", np.zeros(3), "shape"),
        ("covariance", np.diag([1.0, 0.0]), "positive definite"),
        ("covariance", np.diag([1.0, -1.0]), "positive definite"),
        ("covariance", np.array([[1.0, 0.5], [0.0, 1.0]]), "symmetric"),
        ("covariance", np.eye(3), "shape"),
        ("quantity", "speed", "'position' or 'velocity'"),
    ],
)
def test_bad_reading_is_named(name: str, value: object, mend: str) -> None:
    wrong = found(data(**{name: value}))
    assert list(wrong) == [f"data[1].readings[1].{name}"]
    assert mend in wrong[f"data[1].readings[1].{name}"]


def test_data_on_what_does_not_exist_or_has_no_time_is_named() -> None:
    assert "'mission', 'tactics'" in found(data("strategy"))["data[1].on"]
    for wrong in (data("robot", time=None), data(quantity="velocity", time=None)):
        assert "no time" in found(wrong)["data[1].readings[1].time"]
    assert "measurement" in found(GOOD.replace(data=(3,)))["data[0]"]
    assert "robot itself" in found(level(name="robot"))["levels[0].name"]
