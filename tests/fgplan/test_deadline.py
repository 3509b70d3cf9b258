"""A deadline is shared out in the order in which a plan is made."""

from __future__ import annotations

import numpy as np
import pytest

from fgplan.deadline import Deadline


def test_shares_are_in_the_order_of_the_work_and_end_at_the_deadline():
    time = Deadline.until(10.0)
    assert time.end - time.began == pytest.approx(10.0)
    assert list(time) == sorted(time)
    assert len(set(time)) == len(time)


def test_without_a_deadline_nothing_ends():
    time = Deadline.until(None)
    assert np.isfinite(time.began)
    assert set(time[1:]) == {np.inf}


def test_no_time_at_all_is_over_at_once():
    time = Deadline.until(0.0)
    assert set(time) == {time.began}
