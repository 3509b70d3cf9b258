"""GPMP2's planar examples come out as in its own C++."""

from __future__ import annotations

import json
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from benchmarks.gpmp2 import (
    CASES,
    DENSE,
    RADIUS,
    Case,
    Row,
    build,
    min_clearance,
    multi_obstacle_field,
    run,
)

ROOT = Path(__file__).parents[2]

# Case, optimizer, initial error, final error, iterations: GPMP2's C++, all printed digits.
EXPECTED = [
    ("matlab_point", "GaussNewton", 1940002718.535358, 231.317914, 39),
    ("python_point", "Dogleg", 485001572.434326, 101.058888, 17),
    ("python_point", "LevenbergMarquardt", 485001572.434326, 101.059021, 14),
    ("python_point", "GaussNewton", 485001572.434326, 899.23, 2),
]


@cache
def rows() -> dict[tuple[str, str], Row]:
    return {(row.case, row.optimizer): row for row in run()}


@pytest.mark.parametrize(("case", "optimizer", "initial", "final", "iterations"), EXPECTED)
def test_errors_and_iterations_match_gpmp2(
    case: str, optimizer: str, initial: float, final: float, iterations: int
) -> None:
    row = rows()[case, optimizer]
    assert row.initial_error == pytest.approx(initial, rel=1e-9)
    assert row.final_error == pytest.approx(final, rel=1e-5)
    assert row.iterations == iterations


def test_only_gauss_newton_on_python_point_ends_in_collision() -> None:
    colliding = [key for key, row in rows().items() if row.min_clearance < 0]
    assert colliding == [("python_point", "GaussNewton")]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_clearance_agrees_with_a_hermite_spline(case: Case) -> None:
    """The prior's mean between two states is the cubic that joins them."""
    field = multi_obstacle_field()
    _, initial = build(case, field)
    rng = np.random.default_rng(0)
    times = case.dt * np.arange(case.intervals + 1)
    states = np.array([initial.atVector(k) for k in range(len(times))])
    states += rng.normal(size=states.shape)
    spline = CubicHermiteSpline(times, states[:, :2], states[:, 2:])
    along = spline(np.linspace(0, case.duration, case.intervals * (DENSE + 1) + 1))
    expected = field.distance(along).min() - RADIUS
    assert min_clearance(case, field, states) == pytest.approx(expected, abs=1e-9)


def test_without_the_obstacles_the_plan_goes_through_them() -> None:
    """What keeps the plan clear is the obstacle factor: the straight start is in collision."""
    case, field = CASES[1], multi_obstacle_field()
    _, initial = build(case, field)
    states = np.array([initial.atVector(k) for k in range(case.intervals + 1)])
    assert min_clearance(case, field, states) < -RADIUS


def test_json_alone_on_standard_output() -> None:
    command = [sys.executable, "-m", "benchmarks.gpmp2", "--json", "-"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    printed = json.loads(done.stdout)
    assert [(row["case"], row["optimizer"]) for row in printed] == [row[:2] for row in EXPECTED]
    assert list(printed[0]) == [
        "case",
        "optimizer",
        "initial_error",
        "final_error",
        "iterations",
        "min_clearance",
    ]
