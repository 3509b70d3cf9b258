"""The benchmark of levels in short form."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmarks.levels import SHAPES, compiled, growth, stack
from benchmarks.levels.__main__ import main
from fgplan.stack import links


def test_growth_of_a_line_is_its_slope():
    rows = [{"shape": "chain", "levels": n, "plan_ms": 10.0 + 2.0 * n} for n in (1, 2, 4, 8)]
    found = growth(rows)
    assert (found["slope_ms"], found["start_ms"]) == pytest.approx((2.0, 10.0))
    assert found["r2"] == pytest.approx(1.0)


def test_growth_of_a_cube_is_not_linear():
    rows = [{"shape": "chain", "levels": n, "plan_ms": (n + 1.0) ** 3} for n in (1, 2, 4, 8)]
    assert growth(rows)["exponent"] == pytest.approx(3.0)


def test_stacks_are_what_they_are_called():
    assert [x.below for x in links(stack(4, "chain"))] == [1, 2, 3, None]
    tree = [(x.above, x.below) for x in links(stack(6, "tree"))]
    assert tree == [(0, 1), (0, 2), (1, 3), (1, 4), (2, 5), (3, None), (4, None), (5, None)]
    assert all(np.isinf(level.sigma) for level in stack(6, "tree")[1:])


def test_seven_eventualities_make_128_states():
    assert compiled(1)["states"] == 128


def test_the_command_prints_strict_json(capsys, monkeypatch):
    monkeypatch.setattr("benchmarks.levels.SIZES", (1, 3))
    main(["--short", "--json", "-"])
    found = json.loads(capsys.readouterr().out, parse_constant=lambda name: 1 / 0)
    assert [row["levels"] for row in found["plans"]] == [1, 3] * len(SHAPES)
    assert len(found["growth"]) == 2 * len(SHAPES)
    assert found["mission"]["compile_ms"] > 0
