"""Mistakes in scenario files are named, all at once, each with its place and its mend."""

from __future__ import annotations

from pathlib import Path

import pytest

from fgplan.errors import ScenarioError
from fgplan.occupancy import OccupancyGrid
from fgplan.scenario import Scenario
from tests.fgplan.test_scenario_file import GOOD, MINIMAL, load, mistakes


def test_all_mistakes_are_reported_at_once(tmp_path: Path) -> None:
    """Unknown keys, wrong types, a broken map and wrong meanings, in one go."""
    text = """
    speed = 3
    [map]
    file = "nowhere.yaml"
    [robot]
    position = [nan, 0.0]
    raduis = 0.3
    radius = -0.3
    covariance = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    [goal]
    position = [1.0]
    [density]
    dt = "fast"
    alpha = 1.5
    [crowd]
    mode = "both"
    [[people]]
    id = "anna"
    track = [[-0.4, 0, 0], [-0.8, 0, 0], [0.0, "x", 0], [0.4, 0, 0]]
    [[people]]
    id = "anna"
    track = []
    [[people]]
    track = [[0, inf, 0]]
    [field_of_view]
    angle = 7.0
    """
    found = {m.path: m for m in mistakes(tmp_path, text)}
    assert set(found) == {
        "speed",
        "map.file",
        "robot.position",
        "robot.raduis",
        "robot.radius",
        "robot.covariance",
        "goal.position",
        "density.dt",
        "density.alpha",
        "crowd.mode",
        "people[0].track[1]",
        "people[0].track[2][1]",
        "people[0].track[3]",
        "people[1].id",
        "people[1].track",
        "people[2].id",
        "people[2].track[0]",
        "field_of_view.angle",
    }
    assert found["robot.raduis"].mend == "is not a key; did you mean 'radius'?"
    assert found["robot.radius"].value == -0.3
    assert found["density.dt"].value == "fast"
    assert found["people[0].track[3]"].value == [0.4, 0.0, 0.0]
    assert "after crowd.now = 0" in found["people[0].track[3]"].mend


@pytest.mark.parametrize(
    ("text", "path", "mend"),
    [
        ("[goal]\nposition = [1, 1]", "robot", "is missing"),
        ("[robot]\nradius = 1", "robot.position", "is missing"),
        ("robot = 3", "robot", "give a table"),
        (MINIMAL + "[goal]", "goal.position", "is missing"),
        (MINIMAL + "[goal]\nposition = 3", "goal.position", "give a list in [brackets]"),
        (MINIMAL + "[goal]\nposition = [1, 2, 3]", "goal.position", "has too many entries"),
        (MINIMAL + "[goal]\nposition = [1]", "goal.position", "has too few entries"),
        (MINIMAL + "[goal]\nposition = [1, true]", "goal.position[1]", "give a number"),
        (MINIMAL + 'radius = "0.3"', "robot.radius", "give a number"),
        (MINIMAL + "radius = 2024-01-01", "robot.radius", "give a number"),
        (MINIMAL + "people = 3", "robot.people", "is not a key; the keys here are Qc_yaw, "),
        ("people = 3\n" + MINIMAL, "people", "give a list in [brackets]"),
        ("people = [3]\n" + MINIMAL, "people[0]", "give a table"),
        ("levels = []\n" + MINIMAL, "levels", "give at least one level"),
        ("name = 3\n" + MINIMAL, "name", 'give a text in "quotes"'),
        ("nmae = 'x'\n" + MINIMAL, "nmae", "did you mean 'name'?"),
        (MINIMAL + "covariance = [1, 1]", "robot.covariance", "give shape (4, 4)"),
        (MINIMAL + "covariance = [1, 1, 1, 0]", "robot.covariance", "four standard deviations"),
        (MINIMAL + "covariance = [[1, 0], [0]]", "robot.covariance", "give numbers, shape (4, 4)"),
        (MINIMAL + "covariance = [['a']]", "robot.covariance[0][0]", "give a number"),
        (MINIMAL + "[plans]\ncount = 1.5", "plans.count", "give a whole number"),
        (MINIMAL + "[plans]\ncount = 3", "plans.count", "without a goal"),
        (GOOD + "[plans]\ncount = 0", "plans.count", "contradicts the goal"),
        (GOOD + "[[plans.given]]\nlabel = 'a'", "plans.given[0].path", "is missing"),
        (
            GOOD + "[[plans.given]]\nlabel = 'a'\npath = [[1, 1], [2]]",
            "plans.given[0].path[1]",
            "has too few entries",
        ),
        (
            GOOD + "[[plans.given]]\npath = [[1, 1], [2, 1]]",
            "plans.given[0].label",
            "is missing",
        ),
        (GOOD + "[density]\nt_ref = 'now'", "density.t_ref", "give a number"),
        (GOOD + "[field_of_view]\nocclusion = 1", "field_of_view.occlusion", "true or false"),
        (GOOD + "[field_of_view]\nangle_deg = 90", "field_of_view.angle_deg", "mean 'angle'?"),
        (GOOD + "[[levels]]\nsigmma = 1", "levels[0].sigmma", "did you mean 'sigma'?"),
        (GOOD + "[map]", "map.polygons", "is missing; give file, or polygons with"),
        (GOOD + "[map]\nfile = 3", "map.file", 'give a text in "quotes"'),
        (GOOD + "[map]\nfilee = 'x'", "map.filee", "did you mean 'file'?"),
        (
            GOOD + "[map]\nfile = 'x.yaml'\npolygons = []",
            "map.file",
            "contradicts map.polygons; keep the file or the polygons",
        ),
        (
            GOOD + "[map]\npolygons = [[[0, 0], [1, 1]]]\nbounds = [0, 0, 9, 9]\nresolution = 1",
            "map.polygons[0]",
            "3 or more points",
        ),
        (
            GOOD + "[map]\npolygons = [[[0, 0], [1]]]\nbounds = [0, 0, 9, 9]\nresolution = 1",
            "map.polygons[0][1]",
            "has too few entries",
        ),
        (
            GOOD + "[map]\npolygons = []\nbounds = [0, 0, -9, 9]\nresolution = 1",
            "map.bounds",
            "with min < max",
        ),
        (
            GOOD + "[map]\npolygons = []\nbounds = [0, 0, 9, 9]\nresolution = nan",
            "map.resolution",
            "give a finite number",
        ),
        (
            GOOD + "[map]\npolygons = []\nbounds = [0, 0, 9e5, 9e5]\nresolution = 0.05",
            "map.resolution",
            "give a coarser one",
        ),
        (
            GOOD + "[map]\npolygons = []\nbounds = [2, 0, 9, 9]\nresolution = 0.1",
            "robot.position",
            "lies outside the map, x 2 to 9, y 0 to 9",
        ),
        (
            GOOD + "[map]\nbounds = [0, 0, 9, 9]\nresolution = 0.1\n"
            "polygons = [[[7, 0], [9, 0], [9, 2], [7, 2]]]",
            "goal.position",
            "lies inside an obstacle",
        ),
    ],
)
def test_single_mistake_is_named_once(tmp_path: Path, text: str, path: str, mend: str) -> None:
    found = mistakes(tmp_path, text)
    assert found[0].path == path
    assert mend in found[0].mend
    assert len(found) == (3 if "[map]" in text and path == "map.polygons" else 1)


def test_goal_in_obstacle_is_reported_beside_other_mistakes(tmp_path: Path) -> None:
    text = GOOD + (
        "[map]\nbounds = [0, 0, 9, 9]\nresolution = 0.1\n"
        "polygons = [[[7, 0], [9, 0], [9, 2], [7, 2]]]\n[density]\nbeta = nan"
    )
    assert [m.path for m in mistakes(tmp_path, text)] == ["density.beta", "goal.position"]


@pytest.mark.parametrize("bounds", ["[0, 0, 1e8, 1e-3]", "[0, 0, 1e300, 1e-300]"])
def test_a_map_that_is_long_and_thin_has_too_many_cells_as_well(
    tmp_path: Path, bounds: str
) -> None:
    text = GOOD + f"[map]\nbounds = {bounds}\nresolution = 0.05\npolygons = []"
    assert [m.path for m in mistakes(tmp_path, text)] == ["map.resolution"]


@pytest.mark.parametrize(
    ("change", "mend"),
    [
        (("image: hall.pgm", "image: gone.pgm"), "no such file"),
        (("occupied_thresh: 0.65", "occupied_thresh: 0.1"), "give more than free_thresh"),
        (("resolution: 0.5", "resolution: .nan"), "give a finite number"),
    ],
)
def test_broken_map_is_a_mistake_of_the_file(
    tmp_path: Path, change: tuple[str, str], mend: str
) -> None:
    path = tmp_path / "hall.yaml"
    OccupancyGrid.from_polygons([], (0, 0, 10, 5), 0.5).save(path)
    text = path.read_text(encoding="utf-8")
    assert change[0] in text
    path.write_text(text.replace(*change), encoding="utf-8")
    found = mistakes(tmp_path, GOOD + "[map]\nfile = 'hall.yaml'\n[density]\nalpha = -1")
    assert [m.path for m in found] == ["map.file", "density.alpha"]
    assert mend in found[0].mend


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="No such file"):
        Scenario.load(tmp_path / "nowhere.toml")
    with pytest.raises(ScenarioError, match="cannot be read"):
        Scenario.load(tmp_path)


@pytest.mark.parametrize("text", ["", "# only a comment\n"])
def test_empty_file(tmp_path: Path, text: str) -> None:
    assert "give at least [robot]" in mistakes(tmp_path, text)[0].mend


@pytest.mark.parametrize(
    ("text", "line"),
    [("a = 1\nb = = 2\n", 2), ("[robot\n", 1), ("a = 1\na = 2\n", 2), ("a = [1,", 1)],
)
def test_file_that_is_not_toml_names_the_line(tmp_path: Path, text: str, line: int) -> None:
    (mistake,) = mistakes(tmp_path, text)
    assert mistake.path == f"line {line}"
    assert mistake.value == text.splitlines()[line - 1]
    assert "is not TOML" in mistake.mend


def test_file_that_is_not_text(tmp_path: Path) -> None:
    (tmp_path / "case.toml").write_bytes(b"name = '\xff'")
    with pytest.raises(ScenarioError, match="write UTF-8"):
        Scenario.load(tmp_path / "case.toml")


def test_error_tells_path_value_and_mend(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError) as caught:
        load(tmp_path, MINIMAL + "radius = -1.0\nmax_sped = 2\n")
    text = str(caught.value)
    assert "case.toml: 2 mistake(s)" in text
    assert "robot.radius: got -1.0; give a finite number above 0" in text
    assert "robot.max_sped: got 2; is not a key; did you mean 'max_speed'?" in text
