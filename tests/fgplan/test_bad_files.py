"""Bad files, through `Scenario.load`: a typed error or a valid plan, and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from fgplan import (
    FgplanError,
    MapError,
    Mixture,
    OccupancyGrid,
    Scenario,
    ScenarioError,
    plan,
)
from tests.fgplan.test_bad_input import assert_valid
from tests.scenes import blocks

GOOD = """
[map]
file = "{map}"
[robot]
position = [0.0, 0.0]
velocity = [0.8, 0.0]
[goal]
position = [8.0, 0.0]
[plans]
count = 2
[[people]]
id = "a"
track = [[-0.4, 3.4, 1.0], [0.0, 3.0, 1.0]]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A good scenario with its map."""
    blocks().save(tmp_path / "map.yaml")
    (tmp_path / "scenario.toml").write_text(GOOD.format(map="map.yaml"), encoding="utf-8")
    return tmp_path


def rewrite(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def load_and_plan(path: Path) -> Mixture:
    return plan(Scenario.load(path))


def test_the_good_file_plans(folder):
    assert_valid(load_and_plan(folder / "scenario.toml"))


def test_a_map_with_a_missing_image_is_named(folder):
    (folder / "map.pgm").unlink()
    with pytest.raises(FgplanError, match=r"map\.pgm"):
        load_and_plan(folder / "scenario.toml")
    with pytest.raises(MapError, match=r"map\.pgm"):
        OccupancyGrid.load(folder / "map.yaml")


def test_a_map_that_is_missing_is_named(folder):
    (folder / "map.yaml").unlink()
    with pytest.raises(FgplanError, match=r"map\.yaml"):
        load_and_plan(folder / "scenario.toml")


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("occupied_thresh: 0.65", "occupied_thresh: 0.1", "occupied_thresh"),
        ("occupied_thresh: 0.65", "occupied_thresh: 65", "occupied_thresh"),
        ("occupied_thresh: 0.65", "occupied_thresh: .nan", "occupied_thresh"),
        ("free_thresh: 0.196", "free_thresh: -0.2", "free_thresh"),
        ("free_thresh: 0.196", "free_thresh: high", "free_thresh"),
        ("free_thresh: 0.196\n", "", "free_thresh"),
        ("resolution: 0.1", "resolution: 0", "resolution"),
        ("resolution: 0.1", "resolution: .inf", "resolution"),
        ("negate: 0", "negate: 7", "negate"),
        ("mode: trinary", "mode: quaternary", "mode"),
        ("image: map.pgm", "image: map.yaml", "image"),
        ("image: map.pgm", "image: 3", "image"),
    ],
)
def test_a_map_file_that_makes_no_sense_is_named(folder, old, new, named):
    rewrite(folder / "map.yaml", old, new)
    with pytest.raises(FgplanError, match=named):
        load_and_plan(folder / "scenario.toml")


@pytest.mark.parametrize("text", ["", "[", "- 1\n- 2", "image: [", "\x00"])
def test_a_map_file_that_is_no_map_file_is_an_error(folder, text):
    (folder / "map.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(FgplanError):
        load_and_plan(folder / "scenario.toml")


def test_an_image_that_is_cut_off_is_an_error(folder):
    image = (folder / "map.pgm").read_bytes()
    (folder / "map.pgm").write_bytes(image[: len(image) // 2])
    with pytest.raises(FgplanError, match=r"map\.pgm"):
        load_and_plan(folder / "scenario.toml")


@pytest.mark.parametrize("text", ["", "\n", "# nothing\n", "[robot]\n", "[", "= 3", "\x00"])
def test_an_empty_or_broken_file_is_an_error(tmp_path, text):
    path = tmp_path / "scenario.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"scenario\.toml"):
        Scenario.load(path)


def test_a_file_that_is_missing_a_folder_or_no_text_is_an_error(tmp_path):
    with pytest.raises(ScenarioError, match="nowhere"):
        Scenario.load(tmp_path / "nowhere.toml")
    with pytest.raises(ScenarioError):
        Scenario.load(tmp_path)
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError):
        Scenario.load(tmp_path / "bytes.toml")


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        # contradictions
        ("count = 2", "count = 0", r"plans\.count"),
        ("[goal]\nposition = [8.0, 0.0]\n", "", r"plans\.count"),
        ('file = "map.yaml"', 'file = "map.yaml"\nresolution = 0.1', r"map\.file"),
        ('file = "map.yaml"', "polygons = []", r"map\."),
        ("count = 2", "count = 2\n[density]\nhorizon = 0.1", r"density\.horizon"),
        ("[plans]", "preferred_speed = 2.0\n[plans]", "preferred_speed"),
        # start and goal
        ("position = [8.0, 0.0]", "position = [4.0, 0.0]", r"goal\.position"),
        ("position = [8.0, 0.0]", "position = [80.0, 0.0]", r"goal\.position"),
        ("position = [0.0, 0.0]", "position = [4.0, 0.0]", r"robot\.position"),
        ("position = [0.0, 0.0]", "position = [0.0, 40.0]", r"robot\.position"),
        # numbers
        ("position = [8.0, 0.0]", "position = [nan, 0.0]", r"goal\.position"),
        ("velocity = [0.8, 0.0]", "velocity = [inf, 0.0]", r"robot\.velocity"),
        ("velocity = [0.8, 0.0]", "velocity = [0.8]", r"robot\.velocity"),
        ("velocity = [0.8, 0.0]", 'velocity = "fast"', r"robot\.velocity"),
        ("velocity = [0.8, 0.0]", "covariance = [0.1, 0.1, 0.1, 0.0]", r"robot\.covariance"),
        ("velocity = [0.8, 0.0]", "covariance = [[1.0]]", r"robot\.covariance"),
        # people
        ("[0.0, 3.0, 1.0]", "[-0.4, 3.0, 1.0]", r"people\[0\]\.track\[1\]"),
        ("[0.0, 3.0, 1.0]", "[0.5, 3.0, 1.0]", r"people\[0\]\.track\[1\]"),
        ("[0.0, 3.0, 1.0]", "[0.0, 3.0]", r"people\[0\]\.track"),
        ("track = [[-0.4, 3.4, 1.0], [0.0, 3.0, 1.0]]", "track = []", r"people\[0\]\.track"),
        ('id = "a"\n', "", r"people\[0\]\.id"),
        # keys
        ("velocity", "velocty", "velocity"),
        ("[plans]", "[planz]", "planz"),
    ],
)
def test_a_contradictory_or_wrong_file_is_named(folder, old, new, named):
    rewrite(folder / "scenario.toml", old, new)
    with pytest.raises(ScenarioError, match=named):
        Scenario.load(folder / "scenario.toml")
