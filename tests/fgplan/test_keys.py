"""Keys: no two variables share one, and every one reads back."""

from __future__ import annotations

import gtsam
import pytest

from fgplan import keys


def test_keys_have_readable_names():
    assert keys.name(keys.robot(3)) == "robot(3)"
    assert keys.name(keys.crowd(0)) == "crowd(0)"
    assert keys.name(keys.level(2, 17)) == "level(2, 17)"
    assert keys.name(gtsam.symbol("q", 5)) == "q5"


def test_keys_are_gtsam_symbols():
    assert keys.robot(7) == gtsam.symbol("r", 7)
    assert keys.crowd(7) == gtsam.symbol("c", 7)


def test_no_two_variables_share_a_key():
    made = [keys.robot(k) for k in range(2001)] + [keys.crowd(k) for k in range(2001)]
    made += [keys.level(index, k) for index in range(12) for k in range(2001)]
    assert len(set(made)) == len(made)


@pytest.mark.parametrize("k", [0, 1, 12, 2000, 999_999])
def test_the_step_reads_back(k):
    for key in (keys.robot(k), keys.crowd(k), keys.level(0, k), keys.level(11, k)):
        assert keys.step(key) == k


def test_a_foreign_key_has_no_step():
    assert keys.step(gtsam.symbol("x", 4)) is None
    assert keys.step(12) is None
