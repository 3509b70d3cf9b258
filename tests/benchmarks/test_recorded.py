"""Every recorded case plans: a sample here, all of them by `python -m benchmarks.recorded`."""

from __future__ import annotations

import json

import numpy as np

from benchmarks.recorded import run, summary
from benchmarks.recorded.__main__ import main
from tests.pedestrians import FOLDER, needs_recordings


@needs_recordings
def test_recorded_cases_plan_and_most_are_feasible():
    rows = run(FOLDER, every=16)
    assert len(rows) == 3 * 7
    assert np.mean([row["feasible"] for row in rows]) > 0.9
    assert all(row["action"] == "follow" or row["reason"] for row in rows)
    assert {line["name"] for line in summary(rows)} >= {"time_ms", "iterations", "feasible"}


@needs_recordings
def test_the_command_prints_strict_json(capsys):
    main(["--data", str(FOLDER), "--every", "60", "--crowd", "predicted", "--json", "-"])
    rows = json.loads(capsys.readouterr().out, parse_constant=lambda name: 1 / 0)
    assert len(rows) == 6
