"""The declared stack of planning levels: who guides whom, and how closely.

The factor graph is read off from here: a level is a variable (or a fixed path, without width), a
link is a coupling. `Level.follows` makes a tree; levels that nobody follows guide the robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import lcm

from fgplan.scenario import Level

MOST_STEPS = 2000
"""Looked at; no density has more."""

ROBOT = "robot"
"""What the lowest levels guide: f^R."""


@dataclass(frozen=True)
class Link:
    """A coupling ψ(above, below).

    Args:
        above: Index of the level that guides.
        below: Index of the level that follows; None: the robot.
        h: Variance [m²].
        every: It holds at every so many-th step: where both have states.
    """

    above: int
    below: int | None
    h: float
    every: int


def parent(levels: Sequence[Level], index: int) -> int | None:
    """Index of the level that a level follows; None for the first.

    Raises:
        ValueError: it follows a level that does not come before it.
    """
    if index == 0:
        return None
    name = levels[index].follows
    if name is None:
        return index - 1
    before = [level.name for level in levels[:index]]
    if name not in before:
        raise ValueError(
            f"level {levels[index].name!r} follows {name!r}, which is none of the levels before "
            f"it: {', '.join(before)}"
        )
    return before.index(name)


def links(levels: Sequence[Level]) -> tuple[Link, ...]:
    """All couplings of a stack, by the level above, the robot's last."""
    parents = [parent(levels, i) for i in range(len(levels))]
    found = []
    for i, level in enumerate(levels):
        followers = [j for j, above in enumerate(parents) if above == i]
        found += [Link(i, j, level.h, lcm(level.every, levels[j].every)) for j in followers]
        if not followers:
            found.append(Link(i, None, level.h, level.every))
    return tuple(found)


def name_of(levels: Sequence[Level], index: int | None) -> str:
    """Of a level, or the robot."""
    return ROBOT if index is None else levels[index].name


def coupling_name(levels: Sequence[Level], link: Link) -> str:
    """What the term of a coupling is called."""
    above = levels[link.above].name
    if sum(other.above == link.above for other in links(levels)) > 1:
        return f"{above} to {name_of(levels, link.below)} coupling"
    return f"{above} coupling"


def is_flat(level: Level) -> bool:
    """Whether nothing is said of a level but by couplings and data."""
    return level.sigma == float("inf") and level.Qc is None


def loose(levels: Sequence[Level]) -> tuple[int, ...]:
    """Indices of flat levels that at some step meet nothing that holds them: nobody could say
    where they are."""
    found: set[int] = set()
    couplings = links(levels)
    for k in range(min(MOST_STEPS, lcm(*(level.every for level in levels)))):
        held = {i for i, level in enumerate(levels) if not is_flat(level)} | {None}
        pairs = [(x.above, x.below) for x in couplings if k % x.every == 0]
        while new := {i for pair in pairs if held & {*pair} for i in pair} - held:
            held |= new
        found |= {i for i in range(len(levels)) if i not in held}
    return tuple(sorted(found))
