"""The benchmarks of the operator in short form."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmarks.goals import Run, calibration, drive, measure
from benchmarks.goals.__main__ import draw
from benchmarks.operator.__main__ import main
from benchmarks.operator.gaps import waver


def test_calibration_is_that_of_a_table_made_by_hand():
    asked = [(np.array([0.95, 0.05]), 0)] * 9 + [(np.array([0.95, 0.05]), 1)]
    asked += [(np.array([0.45, 0.55]), 1)] * 3 + [(np.array([0.45, 0.55]), 0)] * 7
    error, bins = calibration(asked)
    assert [count for *_, count in bins] == [10, 10]
    assert [share for _, share, _ in bins] == pytest.approx([0.3, 0.9])
    assert error == pytest.approx(0.5 * 0.25 + 0.5 * 0.05)


def test_a_goal_is_known_when_it_is_so_for_good():
    run = Run(np.array([0.0, 0.1, 0.2, 0.3]), np.array([[0.5], [0.95], [0.8], [0.99]]), 0)
    assert run.known_after == 0.3
    assert run.at(0.15) == pytest.approx([0.8])


def test_a_drive_finds_its_goal_and_is_drawn(tmp_path):
    run = drive(3, seed=1)
    np.testing.assert_allclose(run.probability.sum(axis=1), 1)
    np.testing.assert_allclose(run.probability[-1, run.goal], 1, atol=0.05)
    assert run.known_after < 0.6
    draw([measure([run], "3", "noisy")], tmp_path / "reliability.png")
    assert (tmp_path / "reliability.png").stat().st_size > 1000


def test_the_robot_turns_back_exactly_when_the_closed_form_says_so():
    """A stick that says less than the way round costs is outweighed."""
    run = waver(1.0, 0)
    assert run.data < run.price
    assert not run.taken
    assert run.agrees == 1.0
    assert run.error < 1e-9


def test_a_stick_that_is_held_is_not_kept(capsys):
    main(["--minutes", "0.12", "--json", "-"])
    rows = json.loads(capsys.readouterr().out, parse_constant=lambda name: 1 / 0)["rows"]
    for sigma in (0.0, 0.5):
        own = [row for row in rows if row["sigma"] == sigma]
        assert len(own) == 6
        kept = [row["readings_kept"] + row["plans_kept"] for row in own[3:]]
        assert max(kept) <= min(kept) + 10
