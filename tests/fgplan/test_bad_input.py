"""Bad input of `plan`: a typed error or a valid plan, and nothing else; files are in
`test_bad_files.py`."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgplan import (
    Density,
    FgplanError,
    FieldOfView,
    GivenPlan,
    Level,
    Mixture,
    NoPlan,
    NoRoute,
    OccupancyGrid,
    Robot,
    Scenario,
    ScenarioError,
    Track,
    plan,
)
from tests.scenes import blocks, fork, forked, track

NAN, INF = np.nan, np.inf


def assert_valid(mixture: Mixture) -> None:
    """All numbers finite, the JSON strict, a stop or a feasible plan."""
    assert np.isfinite(mixture.action.position).all()
    assert np.isfinite(mixture.action.velocity).all()
    assert np.isfinite(mixture.trajectory.states).all()
    assert np.isfinite(mixture.probability_height).all()
    assert np.isfinite(mixture.probability_mass).all()
    json.dumps(mixture.to_dict(), allow_nan=False)
    assert mixture.action.kind in ("follow", "stop")
    if mixture.action.kind == "follow":
        assert mixture.best is not None
        assert mixture.best.feasible


def to_goal(goal: Any = (8.0, 0.0), **changes: Any) -> Scenario:
    robot = Robot(np.zeros(2), np.array([0.8, 0.0]))
    return Scenario(
        **{"robot": robot, "goal": np.array(goal), "grid": blocks(), "count": 2, **changes}
    )


def robot(**changes: Any) -> dict[str, Any]:
    return {"robot": Robot(**{"position": np.zeros(2), **changes})}


# Where start and goal are


@pytest.mark.parametrize(
    ("goal", "code"),
    [
        ((4.0, 0.0), "GOAL_OCCUPIED"),
        ((50.0, 0.0), "GOAL_OUTSIDE_MAP"),
        ((-2.05, 0.0), "GOAL_OUTSIDE_MAP"),
    ],
)
def test_a_goal_in_an_obstacle_or_outside_the_map_has_no_route(goal, code):
    with pytest.raises(NoRoute, match=code) as caught:
        plan(to_goal(goal))
    assert caught.value.code == code
    assert f"({goal[0]:g}, {goal[1]:g})" in str(caught.value)


@pytest.mark.parametrize(
    ("start", "code"), [((4.0, 0.0), "START_OCCUPIED"), ((0.0, 30.0), "START_OUTSIDE_MAP")]
)
def test_a_start_in_an_obstacle_or_outside_the_map_has_no_route(start, code):
    with pytest.raises(NoRoute, match=code) as caught:
        plan(to_goal(**robot(position=np.array(start))))
    assert caught.value.code == code


def ring() -> OccupancyGrid:
    """A closed wall around (8, 0)."""
    walls = [
        [[6.8, -1.2], [9.2, -1.2], [9.2, -1.0], [6.8, -1.0]],
        [[6.8, 1.0], [9.2, 1.0], [9.2, 1.2], [6.8, 1.2]],
        [[6.8, -1.2], [7.0, -1.2], [7.0, 1.2], [6.8, 1.2]],
        [[9.0, -1.2], [9.2, -1.2], [9.2, 1.2], [9.0, 1.2]],
    ]
    return OccupancyGrid.from_polygons([np.array(w) for w in walls], (-2, -4, 12, 4), 0.1)


def test_an_unreachable_goal_has_no_route():
    with pytest.raises(NoRoute, match="NO_VALID_PATH"):
        plan(to_goal(grid=ring()))
    with pytest.raises(NoRoute, match="NO_VALID_PATH"):
        plan(to_goal(**robot(position=np.zeros(2), radius=3.5)))  # nowhere is room


def test_a_goal_where_the_robot_already_is_makes_a_plan():
    assert_valid(plan(to_goal((0.0, 0.0))))
    assert_valid(plan(to_goal((0.0, 0.0), **robot())))


def test_a_start_too_near_a_wall_makes_a_valid_plan_or_a_stop():
    near = np.array([3.25, 0.0])  # 5 cm from the block's edge, with a radius of 25 cm
    assert_valid(plan(to_goal(**robot(position=near))))


def test_a_map_without_free_cells_has_no_route():
    grid = OccupancyGrid.from_array(np.ones((20, 20), dtype=bool), 1.0, (-10.0, -10.0))
    with pytest.raises(NoRoute):
        plan(to_goal(grid=grid))


def test_a_map_without_obstacles_is_open_space():
    grid = OccupancyGrid.from_array(np.zeros((20, 20), dtype=bool), 1.0, (-10.0, -10.0))
    assert_valid(plan(to_goal(grid=grid)))


def test_a_given_plan_out_of_the_map_is_a_valid_plan_or_a_stop():
    away = (GivenPlan("away", np.array([[0.0, 0.0], [0.0, -50.0]])),)
    assert_valid(plan(forked(plans=away, grid=blocks())))


# Numbers that are none

BAD = [NAN, INF, -INF]

PLACES: dict[str, Callable[[float], Scenario]] = {
    "robot.position": lambda v: to_goal(**robot(position=np.array([0.0, v]))),
    "robot.velocity": lambda v: to_goal(**robot(velocity=np.array([v, 0.0]))),
    "robot.heading": lambda v: to_goal(**robot(heading=v)),
    "robot.radius": lambda v: to_goal(**robot(radius=v)),
    "robot.preferred_speed": lambda v: to_goal(**robot(preferred_speed=v)),
    "robot.max_speed": lambda v: to_goal(**robot(max_speed=v)),
    "robot.max_acceleration": lambda v: to_goal(**robot(max_acceleration=v)),
    "robot.covariance": lambda v: to_goal(**robot(covariance=np.diag([1.0, 1.0, v, 1.0]))),
    "goal.position": lambda v: to_goal((v, 0.0)),
    "plans.given[0].path": lambda v: forked(plans=(GivenPlan("a", [[0.0, 0.0], [v, 1.0]]),)),
    "plans.given[0].weight": lambda v: forked(plans=(GivenPlan("a", [[0, 0], [8, 0.0]], v),)),
    "people[0].track": lambda v: forked(Track("a", np.zeros(1), np.array([[2.0, v]]))),
    "people[0].track times": lambda v: forked(Track("a", np.array([v]), np.ones((1, 2)))),
    "people[0].radius": lambda v: forked(track("a", 3.0, 1.0, radius=v)),
    "crowd.now": lambda v: forked(track("a", 3.0, 1.0), now=v),
    "levels[0].length": lambda v: forked(levels=(Level(sigma=0.5, length=v),)),
    "levels[0].h": lambda v: forked(levels=(Level(h=v),)),
}


@pytest.mark.parametrize("value", BAD)
@pytest.mark.parametrize("place", PLACES)
def test_a_number_that_is_not_finite_is_named(place, value):
    with pytest.raises(ScenarioError) as caught:
        plan(PLACES[place](value))
    path = place.split(" ")[0]
    assert any(mistake.path.startswith(path) for mistake in caught.value.mistakes)
    assert path in str(caught.value)


MAY_BE_INFINITE = {"contact_sigma", "obstacle_sigma", "limit_sigma", "reach"}


@pytest.mark.parametrize("field", [f.name for f in dataclasses.fields(Density)])
@pytest.mark.parametrize("value", [*BAD, -1.0, "1", None, True])
def test_a_density_with_a_number_that_is_none_is_named(field, value):
    scenario = forked(track("a", 3.0, 0.5), density=Density(**{field: value}))
    if (field in MAY_BE_INFINITE and value == INF) or (field == "t_ref" and value is None):
        assert_valid(plan(scenario))
        return
    with pytest.raises(ScenarioError, match=f"density.{field}"):
        plan(scenario)


def test_all_mistakes_are_named_at_once():
    scenario = forked(
        Track("a", np.array([0.0, -1.0]), np.zeros((2, 2))),
        Track("a", np.zeros(0), np.zeros((0, 2))),
        plans=fork(0.0, 0.0), density=Density(dt=0.0, alpha=1.5), levels=(),
        crowd="psychic", pairs="none",
    ).replace(robot=Robot(np.zeros(3), max_speed=-1.0))  # fmt: skip
    with pytest.raises(ScenarioError) as caught:
        plan(scenario)
    paths = {mistake.path for mistake in caught.value.mistakes}
    assert {
        "robot.position", "robot.max_speed", "plans.given", "density.dt", "density.alpha",
        "crowd.mode", "crowd.pairs", "people[0].track[1]", "people[1].track", "people[1].id",
        "levels",
    } <= paths  # fmt: skip


@pytest.mark.parametrize(
    "covariance",
    [
        np.zeros((4, 4)),
        -np.eye(4),
        np.ones((4, 4)),
        np.diag([1.0, 1.0, 1.0, -1e-9]),
        np.eye(3),
        np.eye(4) + np.eye(4, k=1),
        [[1.0]],
    ],
)
def test_a_covariance_that_is_not_positive_definite_is_named(covariance):
    with pytest.raises(ScenarioError, match=r"robot\.covariance"):
        plan(forked(**{}).replace(robot=Robot(np.zeros(2), covariance=covariance)))


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e3])
def test_a_positive_definite_covariance_makes_a_plan(scale):
    uncertain = Robot(np.zeros(2), np.array([0.8, 0.0]), covariance=scale * np.eye(4))
    assert_valid(plan(forked(track("a", 3.0, 0.4)).replace(robot=uncertain)))


# People


@pytest.mark.parametrize("crowd", ["joint", "predicted"])
@pytest.mark.parametrize("alpha", [0.99, 1.0])
@pytest.mark.parametrize("velocity", [(0.0, 0.0), (0.8, 0.0), (-0.5, 0.2)])
def test_a_person_exactly_on_the_robot_is_a_valid_plan_or_a_stop(velocity, alpha, crowd):
    scenario = forked(track("a", 0.0, 0.0, *velocity), crowd=crowd, density=Density(alpha=alpha))
    if alpha == 1.0 and velocity == (0.0, 0.0):  # contact is impossible, and it is there
        with pytest.raises(NoPlan, match=r"left.*right"):
            plan(scenario)
        return
    assert_valid(plan(scenario))


@pytest.mark.parametrize("crowd", ["joint", "predicted"])
def test_people_exactly_on_each_other_are_a_valid_plan(crowd):
    people = [track(name, 3.0, 0.5) for name in "abc"]
    mixture = plan(forked(*people, crowd=crowd))
    assert_valid(mixture)


@pytest.mark.parametrize("crowd", ["joint", "predicted"])
@pytest.mark.parametrize("pairs", ["all", "robot"])
def test_nobody_is_a_valid_plan(crowd, pairs):
    mixture = plan(forked(crowd=crowd, pairs=pairs))
    assert_valid(mixture)
    assert mixture.best is not None
    assert mixture.best.crowd == {}
    assert mixture.best.displacement == {}


def test_somebody_seen_once_or_long_ago_is_a_valid_plan():
    once = Track("once", np.zeros(1), np.array([[3.0, 0.3]]))
    long_ago = Track("long ago", np.array([-600.0, -599.6]), np.array([[3.0, 0.3], [3.1, 0.3]]))
    assert_valid(plan(forked(once, long_ago)))


@pytest.mark.parametrize(
    ("broken", "where"),
    [
        (Track("a", np.array([0.0, 0.0]), np.zeros((2, 2))), r"people\[0\]\.track\[1\]"),
        (Track("a", np.array([1.0]), np.zeros((1, 2))), r"people\[0\]\.track\[0\]"),
        (Track("a", np.zeros(0), np.zeros((0, 2))), r"people\[0\]\.track"),
        (Track("a", np.zeros(2), np.zeros((3, 2))), r"people\[0\]\.track"),
        (Track("a", np.zeros(1), np.zeros((1, 3))), r"people\[0\]\.track"),
        (Track("", np.zeros(1), np.zeros((1, 2))), r"people\[0\]\.id"),
        (Track("a", ["soon"], np.zeros((1, 2))), r"people\[0\]\.track"),
    ],
)
def test_a_track_that_makes_no_sense_is_named(broken, where):
    with pytest.raises(ScenarioError, match=where):
        plan(forked(broken))


@pytest.mark.parametrize(
    ("view", "where"),
    [
        (FieldOfView(range=-1.0), "range"),
        (FieldOfView(range=NAN), "range"),
        (FieldOfView(angle=0.0), "angle"),
        (FieldOfView(angle=7.0), "angle"),
        (FieldOfView(occlusion=2), "occlusion"),
    ],
)
def test_a_field_of_view_that_makes_no_sense_is_named(view, where):
    with pytest.raises(ScenarioError, match=f"field_of_view.{where}"):
        plan(forked(track("a", 3.0, 0.0), field_of_view=view))


@pytest.mark.parametrize(
    ("plans", "where"),
    [
        ((GivenPlan("a", np.zeros((1, 2))),), r"plans\.given\[0\]\.path"),
        ((GivenPlan("a", np.zeros((3, 3))),), r"plans\.given\[0\]\.path"),
        ((GivenPlan("a", [[0, 0], [1]]),), r"plans\.given\[0\]\.path"),
        ((GivenPlan("a", np.eye(2)), GivenPlan("a", np.eye(2))), r"plans\.given\[1\]\.label"),
        ((GivenPlan("a", np.eye(2), -1.0),), r"plans\.given\[0\]\.weight"),
        ((GivenPlan("a", np.eye(2), 0.0),), r"plans\.given"),
    ],
)
def test_a_given_plan_that_makes_no_sense_is_named(plans, where):
    with pytest.raises(ScenarioError, match=where):
        plan(forked(plans=plans))


def test_a_plan_that_goes_nowhere_is_a_valid_plan():
    assert_valid(plan(forked(plans=(GivenPlan("stay", np.zeros((2, 2))),))))
    back = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.0], [1.0, 0.0], [1.0, 0.0]])
    assert_valid(plan(forked(plans=(GivenPlan("to and fro", back),))))


def test_a_horizon_that_never_ends_is_refused_at_once():
    """Years of checks every 0.05 s would neither fit into memory nor ever be done."""
    for dt, horizon in ((1e5, 1e8), (1e14, 1e15), (1e4, 1e6)):
        with pytest.raises(ScenarioError, match=r"density\.(horizon|dt)"):
            plan(to_goal(density=Density(dt=dt, horizon=horizon)))


# Anything at all

ODD = st.one_of(
    st.sampled_from(
        [NAN, INF, -INF, 0.0, -0.0, -1.0, 1e-300, 1e-16, 1e-9, 1e-3, 1e3, 1e7, 1e9, 1e15, 1e300]
    ),
    st.floats(width=64),
    st.floats(0.0, 10.0),
)


def density_with(name: str) -> Callable[[float], dict[str, Any]]:
    return lambda value: {"density": Density(**{name: value})}


FIELDS: dict[str, Callable[[float], dict[str, Any]]] = {
    **{f"density.{f.name}": density_with(f.name) for f in dataclasses.fields(Density)},
    "x": lambda v: robot(position=np.array([v, 0.0])),
    "v": lambda v: robot(velocity=np.array([v, 0.3])),
    "radius": lambda v: robot(radius=v),
    "preferred": lambda v: robot(preferred_speed=v),
    "speeds": lambda v: robot(preferred_speed=v, max_speed=v),
    "max_speed": lambda v: robot(max_speed=v),
    "acceleration": lambda v: robot(max_acceleration=v),
    "covariance": lambda v: robot(covariance=np.diag([1.0, v, 1.0, abs(v)])),
    "goal": lambda v: {"goal": np.array([v, 1.0]), "count": 1},
    "path": lambda v: {"plans": (GivenPlan("a", np.array([[0.0, 0.0], [v, 1.0]])),)},
    "weight": lambda v: {"plans": fork(v, 1.0)},
    "now": lambda v: {"now": v},
    "person": lambda v: {"tracks": (Track("a", np.zeros(1), np.array([[v, 0.0]])),)},
    "stamps": lambda v: {"tracks": (Track("a", np.array([v, 0.0]), np.ones((2, 2))),)},
    "person's radius": lambda v: {"tracks": (track("a", 3.0, 0.3, radius=v),)},
    "sigma": lambda v: {"levels": (Level(sigma=v),)},
    "length": lambda v: {"levels": (Level(sigma=0.5, length=v),)},
    "h": lambda v: {"levels": (Level(h=v),)},
    "range": lambda v: {"field_of_view": FieldOfView(range=v)},
    "angle": lambda v: {"field_of_view": FieldOfView(angle=v)},
}


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("density.sigma_track", 1e-15),
        ("density.Qc_people", 1e15),
        ("density.Qc_robot", 1e-15),
        ("density.h_c", 1e-15),
        ("sigma", 1e-300),
        ("length", 1e6),
        ("length", 1e-6),
        ("weight", 1e15),
    ],
)
def test_an_extreme_number_is_a_typed_error_or_a_valid_plan(field, value):
    """Found by the test below, on a longer run."""
    scenario = forked(track("a", 3.0, 0.3)).replace(**FIELDS[field](value))
    if field == "sigma":
        with pytest.raises(ScenarioError, match=r"levels\[0\]\.sigma"):
            plan(scenario)
        return
    assert_valid(plan(scenario))


@settings(max_examples=5, deadline=None, derandomize=True)
@given(data=st.data())
@pytest.mark.parametrize("grid", [False, True], ids=["open", "map"])
@pytest.mark.parametrize("field", FIELDS)
def test_any_number_in_any_field_is_a_typed_error_or_a_valid_plan(field, grid, data):
    value = data.draw(ODD)
    scenario = forked(track("a", 3.0, 0.3), grid=blocks() if grid else None)
    try:
        mixture = plan(scenario.replace(**FIELDS[field](value)))
    except FgplanError:
        return
    assert_valid(mixture)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    names=st.lists(st.sampled_from(sorted(FIELDS)), min_size=2, max_size=4, unique=True),
    values=st.lists(ODD, min_size=4, max_size=4),
)
def test_any_numbers_in_several_fields_are_a_typed_error_or_a_valid_plan(names, values):
    scenario = forked(track("a", 3.0, 0.3))
    for name, value in zip(names, values, strict=False):
        scenario = scenario.replace(**FIELDS[name](value))
    try:
        mixture = plan(scenario)
    except FgplanError:
        return
    assert_valid(mixture)
