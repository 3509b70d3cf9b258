"""The suite and the hour of driving, in their short forms."""

from __future__ import annotations

import json

import pytest

from benchmarks.hour.__main__ import main as hour
from benchmarks.suite import SUITE, Case, beats, lines
from benchmarks.suite.__main__ import main as suite
from fgplan.simulation.planners import PLANNERS


def test_the_short_suite_passes_a_doorway(capsys):
    suite(["--short", "--planner", "fgplan", "--planner", "straight", "--json", "-"])
    ours, straight = json.loads(capsys.readouterr().out)
    assert (ours["planner"], ours["success"], ours["episodes"]) == ("fgplan", 1.0, 2)
    assert straight["more_than_fgplan"] == straight["value"] - ours["value"]


def test_every_case_names_a_file_and_planners_that_there_are():
    for case in SUITE:
        case.setup.check()
        assert set(case.without) <= PLANNERS.keys()
        for corridor, path in case.corridors:
            told = case.told(corridor, path)(0).scenario
            assert [given.label for given in told.plans] == [corridor]


def test_the_oracle_takes_the_better_corridor_of_each_seed():
    case = Case("s1_corridors", "time", corridors=(("A", "[]"), ("B", "[]")))
    runs = {"fgplan": [30.0, 31.0], "told A": [25.0, None], "told B": [28.0, 27.0]}
    driven = {(case.name, name): [_row(t) for t in times] for name, times in runs.items()}
    found = {line["planner"]: line for line in lines(case, driven)}
    assert found["oracle"]["value"] == pytest.approx(26.0)
    assert found["oracle"]["more_than_fgplan"] == pytest.approx(-4.5)
    assert found["told A"]["value"] == pytest.approx((25.0 + 60.0) / 2)
    assert beats(found["oracle"], found["fgplan"])
    assert not beats(found["fgplan"], found["oracle"])


def test_the_short_hour_finds_nothing_wrong(capsys):
    hour(["--short", "--json", "-"])
    for row in json.loads(capsys.readouterr().out):
        assert (row["steps"], row["error"], row["broken"]) == (20, "", [])
        assert row["unsafe"] == 0


def _row(time):
    return {
        "time": time, "success": time is not None, "collisions": 0, "path_ratio": None,
        "stopped_fraction": 0.0, "switches": 0, "people_delay": None, "unsafe": 0,
        "step_ms_p50": 1.0,
    }  # fmt: skip
