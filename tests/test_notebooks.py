"""Notebooks run from top to bottom, without a warning, and define nothing."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.py"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_imports_and_never_defines(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    defined = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Lambda)
    assert not [node.lineno for node in ast.walk(tree) if isinstance(node, defined)]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_a_notebook(path: Path) -> None:
    jupytext = pytest.importorskip("jupytext")
    cells = jupytext.read(path)["cells"]
    assert {cell["cell_type"] for cell in cells} == {"markdown", "code"}
    assert cells[0]["source"].startswith("# ")


def run(path: Path) -> str:
    environment = {**os.environ, "MPLBACKEND": "Agg", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-W", "error", str(path)]
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_five_people() -> None:
    """What the text of the notebook says is what its numbers show."""
    printed = run(ROOT / "notebooks" / "five_people.py")
    alone, among = re.findall(r"alone (\w), among people (\w)", printed)[0]
    assert alone != among
    flips = [float(ratio) for ratio in re.findall(r"above w1/w2 = ([\d.]+)", printed)]
    assert flips[0] < 1 < flips[1]
    without, with_factor = (float(vx) for vx in re.findall(r"vx = ([\d.]+) m/s", printed))
    assert with_factor == pytest.approx(0.5, abs=0.05)
    assert without > 0.6


def test_any_inference() -> None:
    """The samplers agree, a mean over modes comes too near, and the prior collapses."""
    printed = run(ROOT / "notebooks" / "any_inference.py")
    evidence = {
        name: (float(log_z), float(error))
        for name, log_z, error in re.findall(r"(\w+) +log Z = (-?[\d.]+) ± ([\d.]+)", printed)
    }
    assert "map         no evidence; one mode of" in printed
    log_z, error = evidence.pop("laplace")
    assert len(evidence) == 3
    for other, its_error in evidence.values():
        assert log_z == pytest.approx(other, abs=4 * (error + its_error) + 0.01)
    left, mean, best = map(
        float, re.findall(r"left ([\d.]+); .* mean ([\d.]+) m, best ([\d.]+) m", printed)[0]
    )
    assert 0.4 < left < 0.6
    assert mean < 0.4 < 0.5 < best
    shares = [[float(s) for s in re.findall(r": ([\d.]+)", line.partition("samples:")[2])]
              for line in printed.splitlines() if "effective share" in line]  # fmt: skip
    from_prior, around = shares
    assert from_prior == sorted(from_prior, reverse=True)
    assert from_prior[-1] < 0.01 < 0.05 < min(around)
    assert "same = True" in printed
