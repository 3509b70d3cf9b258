"""Names of hypotheses, shortened and broken where it can be read.

Those of a mission list its stops, "shelf>desk #1"; hypotheses that ended in one optimum have their
names joined with "+".
"""

from __future__ import annotations

import re


def lines(label: str, longest: int) -> list[str]:
    """A label in lines of at most so many characters, broken before "+" and after ">" alone; what
    is longer between two of these stays whole."""
    if len(label) <= longest:
        return [label]
    found: list[str] = []
    for piece in re.split(r"(?=\+)|(?<=>)", label):
        if found and not piece.startswith("+") and len(found[-1]) + len(piece) <= longest:
            found[-1] += piece
        else:
            found.append(piece)
    return found


def short(label: str, longest: int) -> str:
    """A label in one line of some `longest` characters: of joined hypotheses the first, and how
    many more."""
    if len(label) <= longest:
        return label
    first, *others = label.split("+")
    more = f" +{len(others)}" if others else ""
    return (first if len(first) <= longest else f"{first[: longest - 1]}…") + more
