"""Names of hypotheses, as tables and pictures show them."""

from __future__ import annotations

import numpy as np
import pytest

from fgplan.labels import lines, place, short

ROUND = "pharmacy>laboratory>ward_b"


def test_lines_break_between_stops_and_joined_names_only() -> None:
    label = f"{ROUND} #1+{ROUND} #2"
    assert lines(label, 22) == [
        "pharmacy>laboratory>", "ward_b #1", "+pharmacy>laboratory>", "ward_b #2",
    ]  # fmt: skip
    assert lines("A+B", 22) == ["A+B"]
    assert lines("a_name_that_is_longer_than_that", 22) == ["a_name_that_is_longer_than_that"]


@pytest.mark.parametrize("longest", [1, 5, 9, 22, 60])
def test_nothing_is_lost_in_lines(longest: int) -> None:
    label = f"+{ROUND} #1+{ROUND}>+"
    assert "".join(lines(label, longest)) == label


def test_short_says_how_many_more() -> None:
    assert short("A+B", 28) == "A+B"
    assert short(f"{ROUND}+{ROUND} #2+x", 28) == f"{ROUND} +2"
    assert short(f"{ROUND}>{ROUND}", 28) == "pharmacy>laboratory>ward_b>…"


LINE = np.column_stack([np.linspace(0.0, 10.0, 60), np.zeros(60)])
HALF = np.array([1.0, 0.2])
BOX = np.array([[-1.0, -4.0], [11.0, 4.0]])


def test_a_label_is_on_its_line_where_there_is_room() -> None:
    ends = LINE[[0, -1]]
    assert place(LINE, HALF, ends, [], BOX) == pytest.approx([5.0, 0.0], abs=0.2)


def test_a_label_is_beside_a_line_that_must_be_seen() -> None:
    x, y = place(LINE, HALF, LINE, [LINE + np.array([0.0, 0.8])], BOX)
    assert abs(y) >= HALF[1]
    assert y < 0  # the other line is above
    assert BOX[0, 0] + HALF[0] <= x <= BOX[1, 0] - HALF[0]
