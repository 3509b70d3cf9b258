"""The command line: what it prints, what it writes, and how it refuses."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from fgplan import cli
from fgplan.drawing import models
from fgplan.errors import NoPlan
from fgplan.scenario import Scenario

ROOT = Path(__file__).parents[2]
CROWD = ROOT / "data" / "scenarios" / "three_corridors_crowd.toml"
SMALL = """
[map]
polygons = [[[3.0, -1.0], [4.0, -1.0], [4.0, 1.0], [3.0, 1.0]]]
bounds = [-1.0, -4.0, 8.0, 4.0]
resolution = 0.1
[robot]
position = [0.0, 0.2]
velocity = [0.5, 0.0]
[goal]
position = [7.0, 0.2]
[plans]
count = 2
[[people]]
id = "anna"
track = [[-0.4, 2.2, 1.6], [0.0, 2.0, 1.5]]
"""
BAD = SMALL.replace("position = [7.0, 0.2]", "position = [70.0, 0.2]").replace(
    "velocity = [0.5, 0.0]", "velocity = [nan, 0.0]\nradius = -0.2"
)


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scenario file in the working folder, which is empty otherwise."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "small.toml"
    path.write_text(SMALL, encoding="utf-8")
    return path


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli.app, [str(argument) for argument in arguments])


def strict(text: str) -> dict[str, Any]:
    """JSON as the standard has it: no NaN, no infinity."""

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    parsed: dict[str, Any] = json.loads(text, parse_constant=refuse)
    return parsed


def test_plan_prints_a_table_and_writes_two_files(small: Path) -> None:
    result = run("plan", small)
    assert result.exit_code == 0, result.output
    data = strict(Path("out/plan.json").read_text(encoding="utf-8"))
    for hypothesis in data["hypotheses"]:
        lines = (line.replace("*", " ").split() for line in result.stdout.splitlines())
        numbers = next(line for line in lines if line[:1] == [hypothesis["label"]])[1:]
        assert float(numbers[0]) == pytest.approx(np.exp(hypothesis["log_prior"]), abs=6e-4)
        keys = ("energy", "log_evidence", "probability_height", "probability_mass")
        for cell, key in zip(numbers[1:5], keys, strict=True):
            assert float(cell) == pytest.approx(hypothesis[key], abs=6e-4)
        keys = ("min_separation", "clearance", "iterations")
        for cell, key in zip(numbers[5:8], keys, strict=True):
            assert float(cell) == pytest.approx(hypothesis[key], abs=6e-3)
        assert numbers[9:] == [str(hypothesis["optima"]), "yes"]
    assert f"selected  {data['selected']} " in result.stdout
    vx, vy = data["action"]["velocity"]
    assert f"action    follow: velocity ({vx:.2f}, {vy:.2f}) m/s" in result.stdout
    assert Path("out/plan.png").read_bytes().startswith(b"\x89PNG")


def test_names_of_a_mission_are_broken_between_their_stops(small: Path) -> None:
    printed = run("plan", ROOT / "data" / "scenarios" / "hospital.toml").stdout
    table = printed.partition("\nselected")[0].replace("*", " ")
    words = [line.split() for line in table.splitlines()]
    first = next(i for i, line in enumerate(words) if "pharmacy>laboratory>" in line)
    assert words[first][-1] == "yes"
    assert words[first + 1] == ["ward_b", "#1"]


def test_json_alone_on_standard_output(small: Path) -> None:
    result = run("plan", small, "--json", "-")
    assert result.exit_code == 0
    data = strict(result.stdout)
    assert {"selected", "action", "timing", "hypotheses"} <= data.keys()
    needed = "label log_prior energy log_evidence probability_height probability_mass converged "
    needed += "iterations min_separation clearance feasible robot crowd levels"
    steps = Scenario.load(small).density.steps
    for hypothesis in data["hypotheses"]:
        assert set(needed.split()) <= hypothesis.keys()
        assert np.shape(hypothesis["robot"]) == (steps + 1, 5)
        assert {name: np.shape(rows) for name, rows in hypothesis["crowd"].items()} == {
            "anna": (steps + 1, 5)
        }
        assert np.shape(hypothesis["levels"]["mission"]) == (steps + 1, 5)
    assert list(small.parent.iterdir()) == [small]  # no files unless --out names a folder


def test_probabilities_are_the_softmax_of_the_scores(small: Path) -> None:
    hypotheses = strict(run("plan", small, "--json", "-").stdout)["hypotheses"]
    assert len(hypotheses) == 2
    for probability, sign, score in (
        ("probability_height", -1, "energy"),
        ("probability_mass", 1, "log_evidence"),
    ):
        scores = np.array([h["log_prior"] + sign * h[score] for h in hypotheses])
        expected = np.exp(scores - np.logaddexp.reduce(scores))
        assert [h[probability] for h in hypotheses] == pytest.approx(expected.tolist(), abs=1e-12)


def test_without_evidence_there_is_no_probability_by_mass(small: Path) -> None:
    result = run("plan", small, "--inference", "map")
    assert result.exit_code == 0
    data = strict(Path("out/plan.json").read_text(encoding="utf-8"))
    assert [h["probability_mass"] for h in data["hypotheses"]] == [None, None]
    for hypothesis in data["hypotheses"]:
        lines = (line.replace("*", " ").split() for line in result.stdout.splitlines())
        numbers = next(line for line in lines if line[:1] == [hypothesis["label"]])[1:]
        assert (numbers[2], numbers[4]) == ("–", "–")


def test_json_to_a_file(small: Path) -> None:
    result = run("plan", small, "--json", "here/plan.json", "--out", "there")
    assert result.exit_code == 0
    here, there = Path("here/plan.json"), Path("there/plan.json")
    assert here.read_text(encoding="utf-8") == there.read_text(encoding="utf-8")
    assert "P by" in result.stdout


def test_solver_selection_and_crowd_are_options(small: Path) -> None:
    plain = strict(run("plan", small, "--json", "-").stdout)
    gtsam = strict(run("plan", small, "--json", "-", "--solver", "gtsam").stdout)
    assert gtsam["selected"] == plain["selected"]
    assert gtsam["hypotheses"][0]["energy"] == pytest.approx(plain["hypotheses"][0]["energy"])
    mass = strict(run("plan", small, "--json", "-", "--select", "mass").stdout)
    weights = [h["probability_mass"] for h in mass["hypotheses"]]
    assert weights == sorted(weights, reverse=True)
    held = strict(run("plan", small, "--json", "-", "--crowd", "predicted").stdout)
    assert plain["hypotheses"][0]["displacement"]["anna"] > 0
    assert held["hypotheses"][0]["displacement"]["anna"] == 0


def test_all_mistakes_of_a_file_are_named_and_the_exit_code_is_2(small: Path) -> None:
    small.write_text(BAD, encoding="utf-8")
    result = run("plan", small)
    assert result.exit_code == 2
    assert result.stdout == ""
    for path in ("robot.velocity", "robot.radius", "goal"):
        assert path in result.stderr
    assert "Traceback" not in result.stderr
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("position = [7.0, 0.2]", "position = [3.5, 0.2]"), "goal.position"),
        (("polygons = [", "polygons = [[[5, -4], [5.5, -4], [5.5, 4], [5, 4]], "), "NO_VALID_PATH"),
        (("resolution = 0.1", "resolution = -1.0"), "map.resolution"),
        (("[robot]", "[robot"), "small.toml"),
    ],
)
def test_bad_input_is_refused_in_words(small: Path, change: tuple[str, str], says: str) -> None:
    small.write_text(SMALL.replace(*change), encoding="utf-8")
    for command in (("plan", small), ("graph", small)):
        result = run(*command)
        assert (result.exit_code, result.stdout) == (2, "")
        assert says in result.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        (),
        ("small.toml", "--recording", "folder"),
        ("--recording", "folder"),
        ("small.toml", "--case", "x"),
        ("small.toml", "--solver", "magic"),
    ],
)
def test_contradictory_arguments(small: Path, arguments: tuple[str, ...]) -> None:
    assert run("plan", *arguments).exit_code == 2
    assert list(small.parent.iterdir()) == [small]


def test_folder_that_cannot_be_written(small: Path) -> None:
    Path("out").write_text("a file", encoding="utf-8")
    result = run("plan", small)
    assert result.exit_code == 2
    assert "cannot be written" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("stack", "--out", "x.xyz"), ("x.xyz", "'.xyz'", ".png, .svg, .pdf")),
        (("stack", "--out", "picture"), ("'no suffix'", ".png, .svg, .pdf")),
        (("graph", "--out", "g/min.png"), ("g/min.png", "'.png'", ".dot, .gv, .txt")),
        (("simulate", "--gif", "a.txt"), ("a.txt", "'.txt'", ".gif")),
        (("plan", "--out", "shut/x"), ("shut/x/plan.json", "cannot be written")),
        (("plan", "--json", "shut/x.json"), ("shut/x.json", "cannot be written")),
        (("plan", "--json", "."), ("it is a folder",)),
        (("graph", "--out", "shut/x.dot"), ("shut/x.dot", "cannot be written")),
        (("stack", "--out", "shut/x.png"), ("shut/x.png", "cannot be written")),
        (("simulate", "--csv", "shut/a.csv"), ("shut/a.csv", "cannot be written")),
        (("simulate", "--json", "shut/a.json"), ("shut/a.json", "cannot be written")),
    ],
)
def test_what_cannot_be_written_is_refused_before_any_work(
    small: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], says: tuple[str, ...]
) -> None:
    """The scenario is not even read, and nothing is made."""
    Path("shut").write_text("a file, where a folder is needed", encoding="utf-8")

    def refuse(*_: object) -> None:
        raise AssertionError("worked")

    monkeypatch.setattr(Scenario, "load", refuse)
    command, *options = arguments
    result = run(command, small, *options)
    assert (result.exit_code, result.stdout) == (2, "")
    assert all(words in result.stderr for words in says)
    assert {path.name for path in small.parent.iterdir()} == {"small.toml", "shut"}


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no /proc")
def test_a_place_where_no_file_can_be_made(small: Path) -> None:
    """It is tried, not looked up: whoever runs this may write everywhere, by the book."""
    result = run("plan", small, "--out", "/proc/x")
    assert (result.exit_code, result.stdout) == (2, "")
    assert "/proc/x/plan.json cannot be written" in result.stderr


def test_a_file_is_written_anew_and_a_new_folder_made(small: Path) -> None:
    Path("old.dot").write_text("old", encoding="utf-8")
    assert run("graph", small, "--out", "old.dot").exit_code == 0
    assert run("graph", small, "--out", "new/er/graph.GV").exit_code == 0
    assert Path("old.dot").read_bytes() == Path("new/er/graph.GV").read_bytes()


def test_no_plan_is_exit_code_1(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(*_: object, **__: object) -> None:
        raise NoPlan("none of ['A'] has a finite posterior")

    monkeypatch.setattr(cli, "plan", nothing)
    result = run("plan", small)
    assert result.exit_code == 1
    assert "none of ['A'] has a finite posterior" in result.stderr


def test_unexpected_errors_keep_their_traceback(
    small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("a bug")

    monkeypatch.setattr(cli, "plan", broken)
    result = run("plan", small)
    assert isinstance(result.exception, RuntimeError)


def test_a_stop_that_is_not_clear_is_no_plan(small: Path) -> None:
    """At 9 m/s, 2 m before a wall: exit code 1, and all is written and said."""
    fast = SMALL.replace("[0.5, 0.0]", "[9.0, 0.0]").replace("[0.0, 0.2]", "[1.0, 0.2]")
    small.write_text(fast, encoding="utf-8")
    result = run("plan", small, "--json", "plan.json", "--out", "there")
    assert result.exit_code == 1
    assert "STOP      NOT CLEAR" in result.stdout
    assert not strict(Path("plan.json").read_text(encoding="utf-8"))["action"]["safe"]
    assert Path("there/plan.png").is_file()
    alone = run("plan", small, "--json", "-")
    assert (alone.exit_code, strict(alone.stdout)["action"]["safe"]) == (1, False)


def test_stop_is_a_success_and_is_printed_as_a_stop(small: Path) -> None:
    """People stand all around a robot that moves."""
    ring = 0.2j + 0.9 * np.exp(0.25j * np.pi * np.arange(8))
    people = "".join(
        f'[[people]]\nid = "q{i}"\n'
        f"track = [[-0.4, {p.real:.3f}, {p.imag:.3f}], [0.0, {p.real:.3f}, {p.imag:.3f}]]\n"
        for i, p in enumerate(ring)
    )
    alone = SMALL.partition("[[people]]")[0].replace("[0.5, 0.0]", "[1.0, 0.0]")
    small.write_text(alone + people, encoding="utf-8")
    result = run("plan", small, "--crowd", "predicted")
    assert result.exit_code == 0
    assert "selected  none" in result.stdout
    assert "STOP      clear of people and obstacles" in result.stdout


def test_recordings_are_planned(small: Path) -> None:
    folder = small.parent / "recordings"
    (folder / "tracks").mkdir(parents=True)
    (folder / "maps").mkdir()
    Scenario.load(small).grid.save(folder / "maps" / "walk.yaml")  # type: ignore[union-attr]
    columns = "case_id,dataset,agent_id,start_time,human_time,start_x,start_y,v0x,v0y,"
    (folder / "cases.csv").write_text(
        columns + "goal_x,goal_y,human_speed\nwalk_1,walk,1,10.0,6.0,0,0.2,1,0,7,0.2,1.1\n",
        encoding="utf-8",
    )
    rows = [
        f"{t:.1f},{i},{x + v * (t - 10):.2f},{y}"
        for i, x, y, v in ((1, 0.0, 0.2, 1.0), (2, 6.5, 1.8, -1.0))
        for t in np.arange(8.0, 16.0, 0.4)
    ]
    (folder / "tracks" / "walk.csv").write_text(
        "time_s,agent_id,x,y\n" + "\n".join(rows) + "\n", encoding="utf-8"
    )
    data = strict(
        run("plan", "--recording", folder, "--case", "walk_1", "--at", 1.2, "--json", "-").stdout
    )
    assert data["scenario"] == "walk_1 at 1.2 s"
    assert list(data["hypotheses"][0]["crowd"]) == ["p2"]
    assert data["hypotheses"][0]["robot"][0][1] == pytest.approx(1.2, abs=0.1)
    wrong = run("plan", "--recording", folder, "--case", "walk_7")
    assert wrong.exit_code == 2
    assert "walk_1" in wrong.stderr


def test_graph_lists_every_factor(small: Path) -> None:
    result = run("graph", small)
    assert result.exit_code == 0
    label, model = next(iter(models(Scenario.load(small)).items()))
    assert result.stdout.startswith(f"hypothesis {label}: ")
    assert f"{model.graph().size()} factors" in result.stdout
    for term in model.terms:
        assert f"\n{term.name} " in result.stdout
    dot = Path("out/graph.dot").read_text(encoding="utf-8")
    squares = sum(len(term.steps) for term in model.terms)
    assert dot.count("shape=square") == squares
    assert dot.count("shape=circle") == len(model.keys)
    edges = sum(len(term.steps) * len(term.variables) for term in model.terms)
    assert dot.count(" -- ") == edges


def test_graph_of_an_unknown_hypothesis(small: Path) -> None:
    result = run("graph", small, "--hypothesis", "Z")
    assert result.exit_code == 2
    assert "'Z' is none of A, B" in " ".join(result.stderr.split())


@pytest.mark.skipif(os.name != "posix", reason="the stand-in for Graphviz is a shell script")
def test_graph_is_drawn_where_graphviz_is(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for `dot` that checks how it is called."""
    program = small.parent / "bin" / "dot"
    program.parent.mkdir()
    program.write_text('#!/bin/sh\n[ "$1 $3" = "-Tsvg -o" ] && cat "$2" > "$4"\n', encoding="utf-8")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", str(program.parent), prepend=os.pathsep)
    assert run("graph", small, "--out", "g.dot").exit_code == 0
    assert Path("g.svg").read_bytes() == Path("g.dot").read_bytes()


def test_demo_shows_that_the_crowd_changes_the_corridor(tmp_path: Path) -> None:
    result = run("demo", "--out", tmp_path / "demo")
    assert result.exit_code == 0, result.output
    picked = {}
    for name in ("three_corridors", "three_corridors_crowd"):
        text = (tmp_path / "demo" / f"{name}.json").read_text(encoding="utf-8")
        picked[name] = strict(text)["selected"]
    before, after = picked.values()
    assert before != after
    assert f"Without people corridor {before} is chosen" in result.stdout
    assert f"it is {after} " in result.stdout
    assert (tmp_path / "demo" / "five_people.png").stat().st_size > 30_000


def test_demo_fails_when_the_crowd_changes_nothing(tmp_path: Path) -> None:
    """The sentence is computed: with the same file twice there is nothing to show."""
    scenarios = tmp_path / "scenarios"
    scenarios.mkdir()
    for name in ("three_corridors.toml", "three_corridors_crowd.toml"):
        (scenarios / name).write_text(SMALL, encoding="utf-8")
    result = run("demo", "--data", tmp_path, "--out", tmp_path / "demo")
    assert result.exit_code == 1
    assert "does not change" in result.stdout


def test_demo_without_its_data_says_so(tmp_path: Path) -> None:
    result = run("demo", "--data", tmp_path)
    assert result.exit_code == 2
    assert "--data" in result.stderr


def test_program_runs_from_the_shell(tmp_path: Path) -> None:
    """As users call it: warnings are errors, and nothing but JSON is on standard output."""
    command = [sys.executable, "-W", "error", "-m", "fgplan", "plan", str(CROWD), "--json", "-"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, check=True, env=environment
    )
    assert len(strict(done.stdout)["hypotheses"]) == 3
    assert list(tmp_path.iterdir()) == []
