"""Driving among recorded people."""

from __future__ import annotations

import importlib.util
from types import ModuleType

import numpy as np
import pytest

from fgplan.errors import ScenarioError
from fgplan.occupancy import OccupancyGrid
from fgplan.recordings import Case, Recording
from fgplan.simulation import recorded
from fgplan.simulation.body import Body, Limits
from fgplan.simulation.episode import run
from fgplan.simulation.peers import Straight
from fgplan.simulation.recorded import Annotations, Recorded, Replay
from tests.pedestrians import FOLDER, needs_recordings


def recording() -> tuple[Recording, Case]:
    """Two people: one walks along x at 1 m/s, from 1 s on; the other is to be replaced."""
    t = np.arange(1.0, 5.01, 0.4)
    tracks = {
        1: np.column_stack([t, t, np.zeros(len(t))]),
        2: np.column_stack([t, np.zeros(len(t)), t]),
    }
    grid = OccupancyGrid.from_array(np.zeros((200, 200), dtype=bool), 0.1, (-10.0, -10.0))
    case = Case("c", "r", 2, 0.6, 4.0, np.zeros(4), np.array([0.0, 4.0]), 1.0)
    return Recording("r", tracks, grid), case


def test_people_walk_as_they_were_annotated() -> None:
    people = Replay(*recording(), until=10.0)
    assert people.names == ["p1"]
    assert not people.present[0]  # it is 0.6 s, nobody is there yet
    for _ in range(10):
        people.advance(0.1, None)
    assert people.present[0]
    assert np.allclose(people.positions[0], [1.6, 0.0])  # between two annotations
    assert np.allclose(people.velocities[0], [1.0, 0.0])
    for _ in range(35):
        people.advance(0.1, None)
    assert not people.present[0]


def test_the_robot_sees_annotations_and_never_what_lies_between() -> None:
    recorded_, case = recording()
    people = Replay(recorded_, case, until=10.0)
    sensor = Annotations(people)
    body = Body(recorded_.scenario(case), Limits(1.0))
    seen = []
    for step in range(30):
        time = round(0.6 + 0.1 * step, 9)
        found = sensor(time, body, people).detections
        if found is not None:
            seen += [(time, *d.position) for d in found]
        people.advance(0.1, None)
    rows = recorded_.tracks[1]
    assert np.allclose(seen, rows[rows[:, 0] < 3.55])


@needs_recordings
def test_the_straight_row_is_that_of_the_recordings_own_table() -> None:
    """README of the recordings, core tier: success 1.00, path 0.98, time 0.98, contact below
    0.4 m in 0.33 and below 0.6 m in 0.47 of the cases; measured by their own script."""
    script = evaluation()
    setup = Recorded(FOLDER, "core")
    cases = {case["case_id"]: case for case in script.load_cases(FOLDER / "cases.csv")}
    tracks = {
        name: script.load_tracks(script.tracks_path(name, str(FOLDER)))
        for name in {case.recording for case in setup.cases}
    }
    rows = []
    for seed in range(len(setup.cases)):
        world = setup(seed)
        way = np.array(recorded.measure(run(world, Straight(world)))["way"])
        case = cases[world.name]
        rows.append(script.nav_metrics(case, tracks[case["dataset"]], way[:, 0], way[:, 1:]))
    mean = {name: np.mean([r[name] for r in rows]) for name in ("success", "path_ratio",
            "time_ratio", "any_coll_04", "any_coll_06")}  # fmt: skip
    assert mean["success"] == 1.0
    assert mean["path_ratio"] == pytest.approx(0.98, abs=0.005)
    assert mean["time_ratio"] == pytest.approx(0.98, abs=0.005)
    assert mean["any_coll_04"] == pytest.approx(0.33, abs=0.005)
    assert mean["any_coll_06"] == pytest.approx(0.47, abs=0.005)


@needs_recordings
def test_an_unknown_tier_names_those_there_are() -> None:
    with pytest.raises(ScenarioError, match="core"):
        _ = Recorded(FOLDER, "hard").cases


def evaluation() -> ModuleType:
    """The recordings' own script."""
    spec = importlib.util.spec_from_file_location("evaluate", FOLDER / "evaluate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
