"""`fgplan plan --inference NAME`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fgplan import cli
from fgplan.inference import HMC

OPEN = """
[robot]
position = [0.0, 0.0]
velocity = [0.5, 0.0]
[goal]
position = [5.0, 0.5]
[density]
horizon = 1.6
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "open.toml"
    path.write_text(OPEN, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", ["map", "laplace", "importance", "mcmc", "hmc"])
def test_every_method_has_a_name(small, name, monkeypatch):
    if name == "hmc":
        short = HMC(chains=4, draws=50, warmup=50)
        monkeypatch.setitem(cli.METHODS, cli.InferenceName.HMC, short)
    if name == "mcmc":
        from fgplan.inference import EllipticalSlice

        short_slices = EllipticalSlice(chains=4, draws=50, warmup=50, thin=1)
        monkeypatch.setitem(cli.METHODS, cli.InferenceName.MCMC, short_slices)
    result = CliRunner().invoke(
        cli.app, ["plan", str(small), "--inference", name, "--seed", "2", "--json", "-"]
    )
    assert result.exit_code == 0, result.output
    assert set(cli.METHODS) == set(cli.InferenceName)
    (hypothesis,) = json.loads(result.stdout)["hypotheses"]
    assert hypothesis["inference"]["method"] == name
    assert hypothesis["log_evidence"] == hypothesis["inference"]["log_evidence"]
    assert (hypothesis["log_evidence"] is None) == (name == "map")


def test_the_table_is_followed_by_what_the_method_says(small, tmp_path):
    out = str(tmp_path / "out")
    result = CliRunner().invoke(
        cli.app, ["plan", str(small), "--inference", "importance", "--out", out]
    )
    (line,) = [line for line in result.stdout.splitlines() if line.startswith("inference ")]
    assert "by importance: log evidence" in line
    assert "effective of 8192 draws" in line


def test_an_unknown_method_is_refused(small):
    assert CliRunner().invoke(cli.app, ["plan", str(small), "--inference", "x"]).exit_code == 2


def test_a_point_has_no_mass_to_select_by(small):
    command = ["plan", str(small), "--inference", "map", "--select", "mass"]
    result = CliRunner().invoke(cli.app, command)
    assert result.exit_code == 2
    assert "no evidence" in result.output
