"""What is in `data/`: every file loads, makes sense, and is what its script makes."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from fgplan.occupancy import OccupancyGrid
from fgplan.scenario import Scenario
from fgplan.scenario_table import FileTable
from fgplan.shared_control import Stick, read_joy, write_joy
from fgplan.structure import table_of

DATA = Path(__file__).parents[2] / "data"
SCENARIOS = sorted((DATA / "scenarios").glob("*.toml"))
STICKS = sorted((DATA / "operators").glob("*.jsonl"))
MAPS = sorted((DATA / "maps").glob("*.yaml"))


@pytest.fixture(scope="module")
def make() -> ModuleType:
    """The script data/make.py, which is no part of a package."""
    spec = importlib.util.spec_from_file_location("make_data", DATA / "make.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_papers_cases_are_there() -> None:
    names = {path.stem for path in SCENARIOS}
    assert names >= {"one_goal", "three_corridors", "three_corridors_crowd", "hall"}


def test_the_cases_of_levels_and_missions_are_there() -> None:
    names = {path.stem for path in SCENARIOS}
    assert names >= {"delivery", "three_levels", "hospital"}


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_every_scenario_loads_and_nobody_overlaps(path: Path) -> None:
    scenario = Scenario.load(path)
    assert scenario.grid is not None
    ends = [scenario.robot.position]
    if scenario.mission is None or scenario.goal is not None:
        ends.append(scenario.goal)  # type: ignore[arg-type]
    assert scenario.grid.clearance(np.array(ends), scenario.robot.radius).min() > 0
    for i, track in enumerate(scenario.tracks):
        assert scenario.grid.clearance(track.positions, track.radius).min() > 0
        for other in scenario.tracks[:i]:
            assert np.linalg.norm(track.positions - other.positions, axis=1).min() > 0.6


@pytest.mark.parametrize("path", MAPS, ids=lambda path: path.stem)
def test_every_map_is_what_the_script_makes(path: Path, make: ModuleType, tmp_path: Path) -> None:
    stored, made = OccupancyGrid.load(path), make.maps()[path.stem]
    assert np.array_equal(stored.data, made.data)
    made.save(tmp_path / path.name)
    for name in (path.name, path.with_suffix(".pgm").name):
        assert (tmp_path / name).read_bytes() == (path.parent / name).read_bytes()


@pytest.mark.parametrize("name", ["three_corridors_crowd", "hall", "delivery", "hospital"])
def test_people_are_what_the_script_makes(name: str, make: ModuleType) -> None:
    text = (DATA / "scenarios" / f"{name}.toml").read_text(encoding="utf-8")
    assert text.endswith(make.people(name))


@pytest.mark.parametrize("path", STICKS, ids=lambda path: path.stem)
def test_every_stick_is_what_the_script_makes(path: Path, make: ModuleType, tmp_path: Path) -> None:
    write_joy(tmp_path / path.name, make.sticks()[path.stem])
    assert (tmp_path / path.name).read_bytes() == path.read_bytes()
    found, refused = Stick().measurements(read_joy(path))
    assert refused == ()
    times = np.array([wish.time for wish in found])
    assert len(times) > 20
    assert np.sum(np.diff(times) > 1.0) == 1  # two bursts, and nothing in between


def test_crowd_case_is_the_empty_case_with_five_people() -> None:
    empty = Scenario.load(DATA / "scenarios" / "three_corridors.toml")
    crowd = Scenario.load(DATA / "scenarios" / "three_corridors_crowd.toml")
    assert (len(empty.tracks), len(crowd.tracks)) == (0, 5)
    assert np.array_equal(empty.robot.state, crowd.robot.state)
    assert np.array_equal(empty.goal, crowd.goal)  # type: ignore[arg-type]
    assert np.array_equal(empty.grid.data, crowd.grid.data)  # type: ignore[union-attr]
    assert empty.density == crowd.density
    assert tuple(empty.levels) == tuple(crowd.levels)


def test_example_shows_every_key() -> None:
    text = (DATA / "scenarios" / "three_corridors_crowd.toml").read_text(encoding="utf-8")
    tables = [FileTable]
    while tables:
        for name, field in tables.pop().model_fields.items():
            assert name in text, f"{name} is not explained"
            try:
                tables.append(table_of(field.annotation))
            except IndexError:  # a value, not a table
                continue
