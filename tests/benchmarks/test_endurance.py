"""The endurance benchmark in short form."""

from __future__ import annotations

import json

from benchmarks.endurance import deadlines, growth
from benchmarks.endurance.__main__ import main


def test_growth_is_the_slope_over_the_run():
    rows = [{"plans": 10.0 * i, "rss_mb": 100 + 0.5 * i} for i in range(1, 11)]
    assert abs(growth(rows) - 5.0) < 1e-9


def test_deadlines_are_reported_with_what_was_finished():
    (row,) = deadlines(2, times=(10.0,), n=2)
    assert row["finished"] == 1
    assert row["overshoot_max_ms"] == 0


def test_the_command_prints_strict_json(capsys, monkeypatch):
    monkeypatch.setattr("benchmarks.endurance.WARM_UP", 2)
    main(["--plans", "10", "--late", "1", "--json", "-"])
    found = json.loads(capsys.readouterr().out, parse_constant=lambda name: 1 / 0)
    assert len(found["memory"]) == 10
    assert len(found["deadlines"]) == 3
