"""Scenario files: what they say, and every mistake at once with its path, value and mend."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fgplan import scenario_file
from fgplan.errors import Mistake, ScenarioError
from fgplan.holonomic import Holonomic
from fgplan.occupancy import OccupancyGrid
from fgplan.robots import RobotModel
from fgplan.scenario import Density, FieldOfView, GivenPlan, Level, Robot, Scenario, Track
from fgplan.scenario_table import (
    DensityTable,
    FieldOfViewTable,
    FileTable,
    GivenTable,
    LevelTable,
    PersonTable,
    RobotTable,
)
from fgplan.structure import structured
from fgplan.tables import Table
from fgplan.validation import validate
from fgplan.wheeled import CarLike, DifferentialDrive

MINIMAL = "[robot]\nposition = [0.0, 0.0]\n"
GOOD = """
[robot]
position = [1.0, 1.0]

[goal]
position = [8, 1]

[[people]]
id = "anna"
track = [[-0.4, 4.0, 1.0], [0.0, 3.6, 1.0]]

[[people]]
id = "ben"
radius = 0.4
track = [[0.0, 6.0, 2.0]]
"""


def load(folder: Path, text: str) -> Scenario:
    path = folder / "case.toml"
    path.write_text(text, encoding="utf-8")
    return Scenario.load(path)


def mistakes(folder: Path, text: str) -> tuple[Mistake, ...]:
    with pytest.raises(ScenarioError) as caught:
        load(folder, text)
    return caught.value.mistakes


def test_a_goal_may_be_passed_at_a_speed(tmp_path: Path) -> None:
    assert load(tmp_path, GOOD).goal_speed == 0.0
    assert load(tmp_path, GOOD.replace("[8, 1]", "[8, 1]\nspeed = 0.8")).goal_speed == 0.8
    (only,) = mistakes(tmp_path, GOOD.replace("[8, 1]", "[8, 1]\nspeed = 9"))
    assert only.path == "goal.speed"


def test_minimal_file_has_the_defaults_of_the_dataclasses(tmp_path: Path) -> None:
    s = load(tmp_path, MINIMAL)
    assert s.name == "case"
    assert s.robot.position.tolist() == [0, 0]
    assert (s.robot.radius, s.robot.heading, s.robot.covariance) == (Robot.radius, None, None)
    assert s.goal is None
    assert s.grid is None
    assert (s.tracks, s.plans, s.field_of_view) == ((), (), None)
    assert s.density == Density()
    assert tuple(s.levels) == (Level(),)
    assert s.count == 0  # no goal: nowhere to plan to


def test_everything_that_a_file_can_say_arrives(tmp_path: Path) -> None:
    text = """
    name = "all of it"
    [map]
    polygons = [[[4, 1], [5, 1], [5, 2]]]
    bounds = [0, 0, 10, 5]
    resolution = 0.5
    [robot]
    position = [1, 1]
    velocity = [2.5, 0.0]
    heading = 0.1
    covariance = [0.1, 0.2, 0.3, 0.4]
    radius = 0.3
    preferred_speed = 0.9
    max_speed = 1.1
    max_acceleration = 2.0
    [goal]
    position = [9, 4]
    [plans]
    count = 2
    [[plans.given]]
    label = "mine"
    path = [[1, 1], [9, 4]]
    weight = 0.5
    [density]
    t_ref = "dt"
    contact_sigma = inf
    [crowd]
    mode = "predicted"
    pairs = "robot"
    now = 3.5
    [[people]]
    id = "anna"
    radius = 0.25
    track = [[3.0, 5.0, 3.0], [3.5, 5.5, 3.0]]
    [field_of_view]
    range = 5.0
    angle = 2.0
    occlusion = false
    [[levels]]
    name = "mission"
    sigma = 0.5
    [[levels]]
    name = "tactics"
    sigma = inf
    length = 2.0
    h = 0.2
    """
    s = load(tmp_path, text)
    assert s.name == "all of it"
    assert s.grid is not None
    assert s.grid.bounds == pytest.approx((0, 0, 10, 5))
    assert s.grid.is_occupied([4.7, 1.3])
    assert s.robot.state.tolist() == [1, 1, 2.5, 0]  # faster than max_speed now: that is fine
    assert s.robot.covariance is not None
    np.testing.assert_allclose(s.robot.covariance, np.diag([0.01, 0.04, 0.09, 0.16]))
    robot = s.robot
    assert (robot.heading, robot.radius, robot.preferred_speed) == (0.1, 0.3, 0.9)
    assert (robot.max_speed, robot.max_acceleration) == (1.1, 2.0)
    assert s.count == 2
    assert (s.plans[0].label, s.plans[0].weight) == ("mine", 0.5)
    assert s.plans[0].path.tolist() == [[1, 1], [9, 4]]
    assert s.density == Density(t_ref=None, contact_sigma=np.inf)
    assert (s.crowd, s.pairs, s.now) == ("predicted", "robot", 3.5)
    assert (s.tracks[0].identity, s.tracks[0].radius) == ("anna", 0.25)
    assert s.tracks[0].times.tolist() == [3.0, 3.5]
    assert s.tracks[0].positions.tolist() == [[5, 3], [5.5, 3]]
    assert s.field_of_view == FieldOfView(5.0, 2.0, False)
    assert tuple(s.levels) == (
        Level("mission", sigma=0.5),
        Level("tactics", sigma=np.inf, length=2.0, h=0.2),
    )


@pytest.mark.parametrize(
    ("table", "owner", "renamed"),
    [
        (RobotTable, Robot, {key: set() for key in scenario_file._model_keys()}),
        (DensityTable, Density, {}),
        (FieldOfViewTable, FieldOfView, {}),
        (LevelTable, Level, {}),
        (GivenTable, GivenPlan, {}),
        (PersonTable, Track, {"id": {"identity"}, "track": {"times", "positions"}}),
    ],
)
def test_keys_of_a_table_are_the_fields_of_its_dataclass(
    table: type[Table], owner: type, renamed: dict[str, set[str]]
) -> None:
    keys = set().union(*(renamed.get(key, {key}) for key in table.model_fields))
    assert keys == {field.name for field in dataclasses.fields(owner)}


@pytest.mark.parametrize(
    ("text", "model"),
    [
        ("", Holonomic()),
        ('model = "holonomic"', Holonomic()),
        ('model = "differential"\nmax_yaw_rate = 2', DifferentialDrive(max_yaw_rate=2.0)),
        (
            'model = "car"\nmin_turning_radius = 3\nmax_reverse_speed = 0.5',
            CarLike(min_turning_radius=3.0, max_reverse_speed=0.5),
        ),
    ],
)
def test_robot_model_and_its_limits(tmp_path: Path, text: str, model: RobotModel) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(f"{MINIMAL}yaw_rate = 0.25\n{text}", encoding="utf-8")
    robot = Scenario.load(path).robot
    assert robot.model == model
    assert robot.yaw_rate == 0.25


@pytest.mark.parametrize(
    ("text", "paths"),
    [
        ('model = "hovercraft"\nradius = -1', ["robot.model", "robot.radius"]),
        ("model = 3\nmax_yaw_rate = 1", ["robot.model"]),
        ("max_yaw_rate = 1\nQc_yaw = 1", ["robot.Qc_yaw", "robot.max_yaw_rate"]),
        (
            'model = "car"\nmax_yaw_rate = 1\nmin_turning_radius = 0\nmax_yaw_acceleration = "x"',
            ["robot.max_yaw_acceleration", "robot.max_yaw_rate", "robot.min_turning_radius"],
        ),
        (
            'model = "differential"\nmax_reverse_speed = -1\nyaw_rate = 1e3\n'
            "covariance = [1, 1, 1, 1]",
            ["robot.covariance", "robot.max_reverse_speed", "robot.yaw_rate"],
        ),
    ],
)
def test_mistakes_of_a_robot_model_are_all_named(
    tmp_path: Path, text: str, paths: list[str]
) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(MINIMAL + text, encoding="utf-8")
    with pytest.raises(ScenarioError) as error:
        Scenario.load(path)
    assert sorted(mistake.path for mistake in error.value.mistakes) == paths


def test_map_file_is_relative_to_the_scenario(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    OccupancyGrid.from_polygons([], (0, 0, 10, 5), 0.5).save(tmp_path / "maps" / "hall.yaml")
    s = load(tmp_path, '[map]\nfile = "maps/hall.yaml"\n' + GOOD)
    assert s.grid is not None
    assert s.grid.data.shape == (10, 20)


def test_full_covariance_is_taken_as_it_is(tmp_path: Path) -> None:
    matrix = 0.1 * np.eye(4) + 0.01
    s = load(tmp_path, MINIMAL + f"covariance = {matrix.tolist()}\n")
    assert s.robot.covariance is not None
    assert s.robot.covariance.tolist() == matrix.tolist()


VALUES = st.recursive(
    st.one_of(
        st.integers(),
        st.floats(),
        st.booleans(),
        st.text(max_size=3),
        st.just(10**400),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=3), inner, max_size=2)
    ),
    max_leaves=6,
)


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_whatever_a_file_says_it_is_a_scenario_or_a_typed_error(data: st.DataObject) -> None:
    """One place in a good file is replaced by anything that TOML can hold."""
    text = (Path(__file__).parents[2] / "data/scenarios/three_corridors_crowd.toml").read_text(
        "utf-8"
    )
    raw = tomllib.loads(text)
    del raw["map"]
    raw["map"] = {
        "polygons": [[[4, 1], [5, 1], [5, 2]]],
        "bounds": [0, -4, 14, 4],
        "resolution": 0.5,
    }
    raw["plans"]["given"] = [{"label": "a", "path": [[1, 0.4], [13, 0.4]], "weight": 1.0}]
    raw["robot"]["covariance"] = [0.1, 0.1, 0.1, 0.1]
    place: object = raw
    while True:
        keys = sorted(place) if isinstance(place, dict) else range(len(place))  # type: ignore[arg-type]
        key = data.draw(st.sampled_from(list(keys)))
        inner = place[key]  # type: ignore[index]
        if not isinstance(inner, dict | list) or not inner or data.draw(st.booleans()):
            break
        place = inner
    place[key] = data.draw(VALUES)  # type: ignore[index]
    table, found = structured(raw, FileTable)
    try:
        scenario = scenario_file._understand(table, found, Path("case.toml"))
    except ScenarioError as error:
        paths = [m.path for m in error.mistakes]
    else:
        paths = ["none"]
        validate(scenario)
    assert len(set(paths)) == len(paths) > 0


DATA = """
[[levels]]
name = "way"

[[data]]
position = [4, 2.5]
time = 3.0
sigma = 0.5

[[data]]
on = "robot"
velocity = [0.5, -0.5]
time = 1
covariance = [[0.04, 0.01], [0.01, 0.09]]

[[data]]
on = "way"
position = [4, 2.5]
sigma = 0.3
"""


def test_data_arrives(tmp_path: Path) -> None:
    s = load(tmp_path, GOOD + DATA)
    assert [measurement.on for measurement in s.data] == [None, "robot", "way"]
    readings = [reading for measurement in s.data for reading in measurement.readings]
    assert [(r.time, r.quantity) for r in readings] == [
        (3.0, "position"),
        (1.0, "velocity"),
        (None, "position"),
    ]
    np.testing.assert_array_equal(readings[0].value, [4, 2.5])
    np.testing.assert_array_equal(readings[0].covariance, 0.25 * np.eye(2))
    np.testing.assert_array_equal(readings[1].covariance, [[0.04, 0.01], [0.01, 0.09]])


@pytest.mark.parametrize(
    ("old", "new", "path", "mend"),
    [
        ("sigma = 0.5", "sigma = -0.5", "data[0].covariance", "positive definite"),
        ("sigma = 0.5", "", "data[0]", "either sigma or covariance"),
        ("sigma = 0.5", "sigma = 1\nvelocity = [1, 1]", "data[0]", "either position or velocity"),
        ("time = 3.0", "time = nan", "data[0].time", "time in seconds"),
        ("time = 1\n", "", "data[1].time", "no time"),
        ("[4, 2.5]\ntime", "[4, inf]\ntime", "data[0]", "finite numbers"),
        ('on = "way"', 'on = "why"', "data[2].on", "'way'"),
        ("time = 3.0", "tine = 3.0", "data[0].tine", "did you mean 'time'?"),
        ("[0.01, 0.09]]", "[0.01]]", "data[1].covariance", "shape"),
    ],
)
def test_mistakes_in_data_are_named(
    tmp_path: Path, old: str, new: str, path: str, mend: str
) -> None:
    assert old in DATA
    wrong = {m.path: m.mend for m in mistakes(tmp_path, GOOD + DATA.replace(old, new, 1))}
    assert mend in wrong[path]
