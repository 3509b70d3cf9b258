"""The benchmark of inference methods, in short."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.inference import Row, measure, methods, table, winners
from benchmarks.inference.cases import cases, reference, two_modes
from benchmarks.inference.picture import corridor, expected_share, limited
from fgplan.inference import Importance, Laplace
from fgplan.solver import SecondOrder
from tests.pedestrians import FOLDER, needs_recordings

ROOT = Path(__file__).parents[2]


def test_two_modes_have_their_exact_reference():
    case = two_modes()
    truth = reference(case, short=True)
    assert len(case.optima) == 2
    assert np.exp(truth.log_z) == pytest.approx(0.299964, abs=1e-6)
    row = measure(case, truth, "Laplace", Laplace(check=0), True, 1)
    assert row.evidence_error == pytest.approx(np.log(0.305537 / 0.299964), abs=1e-5)
    assert row.mode_error == 0


@pytest.mark.parametrize("h", [0.03, 0.3, 3.0])
@pytest.mark.parametrize("steps", [3, 6])
def test_share_of_the_prior_has_its_closed_form(steps, h):
    case = corridor(steps, h)
    share = [
        Importance(8000, "prior").infer(case.assembly, 0, case.optima, seed).diagnostics.ess / 8000
        for seed in range(6)
    ]
    error = np.std(share, ddof=1) / np.sqrt(6)
    assert np.mean(share) == pytest.approx(expected_share(case, h), abs=4 * error + 1e-4)


def test_laplace_does_not_see_a_limit_that_the_optimum_does_not_touch():
    assembly = limited(0.5)
    found = SecondOrder().solve(assembly, np.zeros((1, 1, 2)), np.zeros(1, dtype=np.intp))
    flat = Laplace(limits="curvature")
    assert flat.infer(assembly, 0, found).log_evidence == pytest.approx(0, abs=1e-9)
    sampled = Importance(8192, "linear").infer(assembly, 0, found)
    assert sampled.log_evidence == pytest.approx(np.log(0.3829), abs=0.1)
    assert flat.infer(assembly, 0, found).warnings
    propagated = Laplace(check=0).infer(assembly, 0, found).log_evidence
    assert propagated == pytest.approx(np.log(0.3829), abs=0.1)


def test_winners_are_the_least_errors_within_the_budget():
    def row(method: str, seconds: float, error: float, evidence: float | None) -> Row:
        return Row("c", method, 1, seconds, error, 0.0, evidence, None, True, 0.0)

    rows = [row("quick", 0.005, 0.5, None), row("slow", 0.5, 0.1, 0.2)]
    by_budget = {line["budget_s"]: line for line in winners(rows)}
    assert by_budget[0.01]["mean"] == "quick"
    assert by_budget[0.01]["evidence"] is None
    assert by_budget[1.0]["mean"] == by_budget[1.0]["evidence"] == "slow"
    assert by_budget[1.0]["mode"] == "quick"
    assert table(rows)[2:] == [
        "| c | 0.01 s | quick: 0.5 | – |",
        "| c | 1 s | slow: 0.1 | slow: 0.2 |",
    ]


@needs_recordings
def test_a_recorded_crowd_is_among_the_cases():
    *_, last = cases(True, FOLDER)
    assert last.name == "recorded crowd"
    assert last.optima


def test_short_run_prints_json_alone():
    command = [sys.executable, "-m", "benchmarks.inference", "--short", "--json", "-"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    printed = json.loads(done.stdout)
    assert "skipped: recorded crowd" in done.stderr or "recorded" in done.stdout
    assert {row["method"] for row in printed["rows"]} == {name for name, *_ in methods(True)}
    assert {line["case"] for line in printed["winners"]} >= {"two modes", "three corridors, crowd"}
