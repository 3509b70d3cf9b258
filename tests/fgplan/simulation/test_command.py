"""`fgplan simulate` and `fgplan evaluate`, as they are typed."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from PIL import Image
from typer.testing import CliRunner

from fgplan.cli import app
from tests.fgplan.simulation.test_errand import DOOR as MISSION
from tests.pedestrians import FOLDER, needs_recordings

DATA = Path(__file__).parents[3] / "data" / "simulations"
DOOR = str(DATA / "s7_doorway_0.9.toml")


def typed(*arguments: str, code: int = 0) -> str:
    done = CliRunner().invoke(app, list(arguments))
    assert done.exit_code == code, done.output
    return done.output


def test_simulate_prints_a_row_a_planner_and_scenario(tmp_path: Path) -> None:
    table, film = tmp_path / "runs.csv", tmp_path / "run.gif"
    text = typed(
        "simulate", DOOR, "--planner", "fgplan", "--planner", "straight", "--seeds", "2",
        "--json", "-", "--csv", str(table), "--gif", str(film),
    )  # fmt: skip
    ours, straight = json.loads(text)
    assert (ours["planner"], ours["episodes"], ours["success"]) == ("fgplan", 2, 1.0)
    assert straight["planner"] == "straight"
    assert ours["success_ci"] == pytest.approx([0.342, 1.0], abs=1e-3)
    for name in ("collisions", "time", "path_ratio", "stopped_fraction", "switches"):
        low, high = ours[f"{name}_ci"]
        assert low <= ours[name] <= high
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert [(r["planner"], r["seed"]) for r in rows] == [
        ("fgplan", "0"), ("fgplan", "1"), ("straight", "0"), ("straight", "1"),
    ]  # fmt: skip
    with Image.open(film) as pictures:
        assert pictures.n_frames > 20


def test_simulate_prints_a_table() -> None:
    text = typed("simulate", DOOR, "--planner", "straight", "--seeds", "1")
    assert "s7_doorway_0.9" in text
    assert "success" in text


def test_a_planner_that_does_not_exist_is_refused_with_near_names() -> None:
    assert "layered-global" in typed("simulate", DOOR, "--planner", "layerd", code=2)


def test_files_of_one_name_and_a_planner_given_twice_are_refused(tmp_path: Path) -> None:
    other = tmp_path / Path(DOOR).name
    other.write_text(Path(DOOR).read_text())
    straight = ("--planner", "straight")
    for arguments in ((DOOR, str(other), *straight), (DOOR, *straight, *straight)):
        text = typed("simulate", *arguments, "--seeds", "2", code=2)
        assert "'s7_doorway_0.9 straight 0'" in text


def test_a_peer_is_refused_where_there_is_no_goal_before_anybody_drives(tmp_path: Path) -> None:
    file, store = tmp_path / "door.toml", tmp_path / "runs.jsonl"
    file.write_text(MISSION)
    text = typed("simulate", str(file), "--planner", "fgplan", "--planner", "orca",
                 "--store", str(store), code=2)  # fmt: skip
    assert "planner orca needs a goal" in text
    assert not store.exists()


def test_a_change_that_is_none_is_refused() -> None:
    assert "KEY=VALUE" in typed("simulate", DOOR, "--set", "count", code=2)


def test_somebody_holds_the_stick() -> None:
    log = str(DATA.parent / "operators" / "right_then_left.jsonl")
    for operator in ("left", log):
        text = typed(
            "simulate", str(DATA / "s6a_operator.toml"), "--planner", "straight", "--seeds", "1",
            "--operator", operator, "--set", "world.time_limit=1.5", "--json", "-",
        )  # fmt: skip
        (line,) = json.loads(text)
        assert operator in line["scenario"]
    for name in ("adversery", "nothing.jsonl"):
        text = typed("simulate", DOOR, "--operator", name, code=2)
        assert "operator" in text


def test_evaluate_crowdnav_prints_its_row() -> None:
    line = json.loads(
        typed("evaluate", "crowdnav", "--planner", "orca", "--cases", "3", "--json", "-")
    )
    assert {"success", "collision", "timeout", "time", "discomfort", "min_clearance",
            "step_ms_p50", "step_ms_p99"} <= line.keys()  # fmt: skip
    assert line["success"] + line["collision"] + line["timeout"] == pytest.approx(1)


@needs_recordings
def test_evaluate_recorded_writes_what_the_evaluation_reads(tmp_path: Path) -> None:
    out = tmp_path / "robot.csv"
    typed("evaluate", "recorded", "--data", str(FOLDER), "--tier", "core", "--planner", "straight",
          "--out", str(out))  # fmt: skip
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert len({row["case_id"] for row in rows}) == 111
    assert set(rows[0]) == {"case_id", "t", "x", "y"}
