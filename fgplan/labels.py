"""Names of hypotheses: shortened, broken where it can be read, placed where they hide nothing.

Those of a mission list its stops, "shelf>desk #1", and join the regions of one stop with "&";
hypotheses that ended in one optimum have their names joined with "+", those of several levels with
"/". What joins names is in none of them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

JOINED = "+"
"""Between the names of hypotheses that ended in one optimum."""
AT_ONCE = "&"
"""Between the regions of one stop."""
OF_LEVELS = "/"
"""Between the names of a hypothesis on several levels."""
WAITING = ", waiting"
"""Ends the label of a hypothesis that waits."""
IN_NO_PLAN = (JOINED, OF_LEVELS, WAITING)
"""What is in no name of a plan: it would be read as more than one."""
IN_NO_REGION = (*IN_NO_PLAN, AT_ONCE, ">", " #")
"""What is in no name of a region."""

ROOM = 1.0
"""A label this far from everything hides nothing [m]."""
BESIDE = (0.0, 2.0, -2.0, 4.0, -4.0)
"""How far above its line a label may be, the line itself first [half its height]."""


def misread(name: str, parts: Sequence[str]) -> str | None:
    """What of a name would be read as the end of it, in words; None where nothing would."""
    found = next((part for part in parts if part in name), None)
    return None if found is None else f"has {found!r}, which ends a name; leave it out"


def lines(label: str, longest: int) -> list[str]:
    """A label in lines of at most so many characters, broken before "+" and after ">" alone; what
    is longer between two of these stays whole."""
    if len(label) <= longest:
        return [label]
    found: list[str] = []
    for piece in re.split(r"(?=\+)|(?<=>)", label):
        if found and not piece.startswith(JOINED) and len(found[-1]) + len(piece) <= longest:
            found[-1] += piece
        else:
            found.append(piece)
    return found


def short(label: str, longest: int) -> str:
    """A label in one line of some `longest` characters: of joined hypotheses the first, and how
    many more."""
    if len(label) <= longest:
        return label
    first, *others = label.split(JOINED)
    more = f" +{len(others)}" if others else ""
    return (first if len(first) <= longest else f"{first[: longest - 1]}…") + more


def place(line: Array, half: Array, marks: Array, others: Sequence[Array], box: Array) -> Array:
    """Where a label of a line hides nothing: on the line, or above or below it.

    Args:
        line: Points of the line, shape (N, 2) [m].
        half: Half the width and height of the label, shape (2,) [m].
        marks: What must not be hidden, shape (M, 2) [m].
        others: Lines that the label could be taken to belong to, (M, 2) each [m].
        box: Corners of the picture, shape (2, 2) [m].

    Returns:
        Its centre, shape (2,) [m].
    """
    best, most = line[len(line) // 2], -np.inf
    for shift in BESIDE:
        centres = np.clip(line + np.array([0.0, shift * half[1]]), box[0] + half, box[1] - half)
        room = 2 * _room(centres, half, marks)
        room += _room(centres, half, np.vstack([np.zeros((0, 2)), *others]))
        room -= _room(centres, half, line)
        if room.max() > most + 0.1:
            roomy = centres[room >= room.max() - 0.1]
            best, most = roomy[len(roomy) // 2], float(room.max())
    return np.asarray(best)


def _room(centres: Array, half: Array, points: Array) -> Array:
    """From labels to the nearest of all points, at most `ROOM`, shape (N,) [m]."""
    apart = np.maximum(np.abs(centres[:, None] - points) - half, 0.0)
    return np.asarray(np.linalg.norm(apart, axis=-1).min(axis=1, initial=ROOM))
