"""The benchmark of robots with wheels, in short: what it says, not how fast."""

from __future__ import annotations

import json

from benchmarks.robots import MODELS, run
from benchmarks.robots.__main__ import main


def test_optima_hardly_slide_and_what_is_driven_does_not() -> None:
    rows = run(4)
    assert {row.model for row in rows} == set(MODELS)
    for row in rows:
        assert row.converged == 1
        assert row.slip_optimum_mm < 1
        assert row.slip_driven_mm < 1e-6
        assert row.iterations_p50 <= 25


def test_it_prints_json_alone(capsys) -> None:
    main(["--scenes", "2", "--json", "-"])
    rows = json.loads(capsys.readouterr().out, parse_constant=lambda name: 1 / 0)
    assert {row["start"] for row in rows} == {"along", "reversed"}
