"""Names of hypotheses, as tables and pictures show them."""

from __future__ import annotations

import pytest

from fgplan.labels import lines, short

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
