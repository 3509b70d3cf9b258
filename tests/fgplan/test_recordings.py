"""Recordings as scenarios: what was observable, and nothing after."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgplan.crowd import believe
from fgplan.errors import ScenarioError
from fgplan.occupancy import OccupancyGrid
from fgplan.recordings import Recording, load_cases, scenario
from fgplan.scenario import Density, Scenario
from fgplan.validation import validate
from tests.pedestrians import FOLDER, needs_recordings

CASE = {
    "case_id": "square_1",
    "dataset": "square",
    "tier": "core",
    "agent_id": 1,
    "start_time": 10.0,
    "human_time": 4.0,
    "start_x": 0.5,
    "start_y": 1.0,
    "v0x": 1.25,
    "v0y": 0.0,
    "goal_x": 5.5,
    "goal_y": 1.0,
    "human_speed": 1.25,
}


def write(path: Path, rows: list[dict[str, object]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def rows_of(agent: int, times: list[float], x: float, speed: float) -> list[dict[str, object]]:
    return [
        {"frame": 0, "time_s": t, "agent_id": agent, "x": x + speed * t, "y": agent, "vx": "?"}
        for t in times
    ]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A recording of our own: agent 1 is replaced, the others are there at different times."""
    (tmp_path / "tracks").mkdir()
    (tmp_path / "maps").mkdir()
    steps = [round(8 + 0.4 * k, 4) for k in range(20)]
    rows = [
        *rows_of(1, steps, -12.0, 1.25),
        *rows_of(2, steps, -10.0, 1.0),
        *rows_of(3, [t for t in steps if t < 9], 0.0, 0.5),  # leaves before the case
        *rows_of(4, [t for t in steps if t > 11], 0.0, 0.5),  # comes later
        *rows_of(5, [t for t in steps if t < 8.5 or t > 9.5], 1.0, 0.1),  # out of sight between
    ]
    rng = np.random.default_rng(0)
    write(tmp_path / "tracks" / "square.csv", [rows[i] for i in rng.permutation(len(rows))])
    write(tmp_path / "cases.csv", [CASE])
    grid = OccupancyGrid.from_polygons([], (-5, -5, 10, 10), 0.5)
    grid.save(tmp_path / "maps" / "square.yaml")
    return tmp_path


def same(one: Scenario, other: Scenario) -> bool:
    """Whether two scenarios agree to the bit."""

    def content(s: Scenario) -> tuple[object, ...]:
        assert s.grid is not None
        assert s.goal is not None
        tracks = [(t.identity, t.times.tobytes(), t.positions.tobytes()) for t in s.tracks]
        limits = (s.robot.radius, s.robot.preferred_speed, s.robot.max_speed)
        grid = s.grid.data.tobytes()
        return tracks, s.robot.state.tobytes(), limits, s.goal.tobytes(), s.now, grid, s.density

    return content(one) == content(other)


def test_start_of_a_case(folder: Path) -> None:
    s = scenario(folder, "square_1")
    validate(s)
    assert s.robot.state.tolist() == [0.5, 1.0, 1.25, 0.0]
    assert s.goal is not None
    assert s.goal.tolist() == [5.5, 1.0]
    assert (s.now, s.robot.radius, s.robot.preferred_speed) == (10.0, 0.2, 1.25)
    assert s.robot.max_speed == pytest.approx(1.3 * 1.25)
    assert [(t.identity, t.radius) for t in s.tracks] == [("p2", 0.2), ("p5", 0.2)]
    assert s.tracks[0].times.tolist() == [8.0, 8.4, 8.8, 9.2, 9.6, 10.0]
    assert s.tracks[1].times.tolist() == [9.6, 10.0]  # the run after the gap only


def test_later_the_robot_is_where_its_own_past_says(folder: Path) -> None:
    s = scenario(folder, "square_1", 2.1)
    assert s.now == 12.1
    assert [t.identity for t in s.tracks] == ["p2", "p4", "p5"]
    assert max(t.times[-1] for t in s.tracks) == 12.0
    np.testing.assert_allclose(s.robot.state, [-12 + 1.25 * 12.1, 1, 1.25, 0], atol=0.02)
    d = Density()
    past = replace(s.tracks[0], positions=s.tracks[0].positions * 0 + 1)
    past = replace(past, positions=np.column_stack([-12 + 1.25 * past.times, past.positions[:, 1]]))
    own = believe([past], 12.1, d.Qc_people, d.sigma_track, d.sigma_speed)
    np.testing.assert_allclose(s.robot.state, own.mean[0], atol=1e-12)


def test_whoever_left_the_picture_is_gone_half_a_second_later(folder: Path) -> None:
    cases = load_cases(folder)
    recording = Recording.load(folder, "square")
    early = replace(cases[0], start_time=9.0)  # agent 3 was last seen at 8.8
    assert "p3" in [t.identity for t in recording.scenario(early, 0.3).tracks]
    assert "p3" not in [t.identity for t in recording.scenario(early, 0.31).tracks]


def scrambled(source: Path, target: Path, now: float) -> None:
    """A copy of tracks in which every row after `now` says something else."""
    rng = np.random.default_rng(1)
    with source.open(newline="", encoding="utf-8") as file:
        rows: list[dict[str, object]] = list(csv.DictReader(file))
    for row in rows:
        if float(str(row["time_s"])) > now:
            row["x"], row["y"] = rng.normal(0, 9, 2)
            row["agent_id"] = int(rng.integers(1, 400))
    write(target, rows)


@pytest.mark.parametrize("at", [0.0, 0.7, 2.0, 4.0])
def test_no_look_ahead(folder: Path, at: float) -> None:
    before = scenario(folder, "square_1", at)
    path = folder / "tracks" / "square.csv"
    scrambled(path, path, before.now)
    assert same(before, scenario(folder, "square_1", at))


def test_change_of_the_past_is_seen(folder: Path) -> None:
    """The test above can fail: what it compares does depend on the rows."""
    before = scenario(folder, "square_1")
    path = folder / "tracks" / "square.csv"
    scrambled(path, path, before.now - 0.5)
    assert not same(before, scenario(folder, "square_1"))


@needs_recordings
@pytest.mark.parametrize("dataset", ["seq_eth", "seq_hotel", "zara01"])
def test_no_look_ahead_in_real_recordings(dataset: str, tmp_path: Path) -> None:
    case = next(c for c in load_cases(FOLDER) if c.recording == dataset and c.tier == "core")
    (tmp_path / "maps").symlink_to(FOLDER / "maps")
    (tmp_path / "cases.csv").symlink_to(FOLDER / "cases.csv")
    (tmp_path / "tracks").mkdir()
    tracks = f"tracks/{dataset}.csv"
    at = 0.5 * case.duration
    before = scenario(FOLDER, case.identity, at)
    scrambled(FOLDER / tracks, tmp_path / tracks, before.now)
    assert same(before, scenario(tmp_path, case.identity, at))


@needs_recordings
def test_every_case_makes_a_valid_scenario_at_three_moments() -> None:
    cases = load_cases(FOLDER)
    recordings = {name: Recording.load(FOLDER, name) for name in {c.recording for c in cases}}
    crowd = []
    for case in cases:
        for share in (0.0, 0.4, 0.8):
            s = recordings[case.recording].scenario(case, share * case.duration)
            validate(s)
            assert all(t.times[-1] <= s.now <= t.times[-1] + 0.5 for t in s.tracks)
            assert f"p{case.agent}" not in {t.identity for t in s.tracks}
            crowd.append(len(s.tracks))
    assert max(crowd) > 20


@needs_recordings
def test_robot_follows_the_replaced_person() -> None:
    """The posterior from past annotations stays near the person: half a step and the noise."""
    case = next(c for c in load_cases(FOLDER) if c.tier == "core")
    recording = Recording.load(FOLDER, case.recording)
    track = recording.tracks[case.agent]
    for at in np.linspace(0, case.duration, 9):
        s = recording.scenario(case, float(at))
        where = [np.interp(s.now, track[:, 0], track[:, axis]) for axis in (1, 2)]
        assert math.dist(s.robot.position, where) < 0.25


Edit = Callable[[Path], object]


@pytest.mark.parametrize(
    ("case_id", "at", "path", "mend"),
    [
        ("sqare_1", 0.0, "case", "nearest are square_1"),
        ("square_1", -0.1, "at", "from 0 to the case's 4 s"),
        ("square_1", 4.1, "at", "from 0 to the case's 4 s"),
        ("square_1", math.nan, "at", "from 0 to the case's 4 s"),
        ("square_1", math.inf, "at", "from 0 to the case's 4 s"),
    ],
)
def test_moment_that_is_not_recorded(
    folder: Path, case_id: str, at: float, path: str, mend: str
) -> None:
    with pytest.raises(ScenarioError, match=mend) as caught:
        scenario(folder, case_id, at)
    assert [m.path for m in caught.value.mistakes] == [path]


def replaced(name: str, old: str, new: str) -> Edit:
    def edit(folder: Path) -> None:
        text = (folder / name).read_text(encoding="utf-8")
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1), encoding="utf-8")

    return edit


@pytest.mark.parametrize(
    ("edit", "path", "mend"),
    [
        (lambda f: (f / "cases.csv").unlink(), "cases.csv", "name a folder of recordings"),
        (lambda f: (f / "cases.csv").write_bytes(b"\xff"), "cases.csv", "cannot be read"),
        (lambda f: (f / "cases.csv").write_text(""), "cases.csv", "has no column case_id"),
        (replaced("cases.csv", "goal_x", "goal"), "cases.csv", "has no column goal_x"),
        (replaced("cases.csv", "10.0", "ten"), "cases.csv, line 2, start_time", "give a number"),
        (replaced("cases.csv", "10.0", "nan"), "cases.csv, line 2, start_time", "give a number"),
        (replaced("cases.csv", ",10.0", ""), "cases.csv, line 2", "12 values; the header names 13"),
        (lambda f: (f / "tracks/square.csv").unlink(), "tracks/square.csv", "cannot be read"),
        (lambda f: (f / "maps/square.yaml").unlink(), "maps/square.yaml", "No such file"),
        (lambda f: (f / "maps/square.pgm").unlink(), "maps/square.yaml", "no such file"),
    ],
)
def test_folder_that_cannot_be_read(folder: Path, edit: Edit, path: str, mend: str) -> None:
    edit(folder)
    with pytest.raises(ScenarioError, match=mend) as caught:
        scenario(folder, "square_1")
    assert [m.path for m in caught.value.mistakes] == [path]


def test_no_such_folder(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="name a folder of recordings"):
        load_cases(tmp_path / "nowhere")


def test_replaced_person_who_is_not_there(folder: Path) -> None:
    case = replace(load_cases(folder)[0], agent=99)
    recording = Recording.load(folder, "square")
    assert recording.scenario(case, 0.0).robot.position.tolist() == [0.5, 1.0]
    with pytest.raises(ScenarioError, match="nobody followed in square"):
        recording.scenario(case, 0.4)


def test_detection_written_twice_counts_once(folder: Path) -> None:
    path = folder / "tracks" / "square.csv"
    before = scenario(folder, "square_1", 1.0)
    lines = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join([*lines, *lines[1:]]) + "\n", encoding="utf-8")
    assert same(before, scenario(folder, "square_1", 1.0))
