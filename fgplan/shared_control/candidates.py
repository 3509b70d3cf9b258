"""No goal is known: places the operator may be going to, each a hypothesis.

Candidates are given, or found on the map: doors, ends of corridors and open corners, from the
shape of the free space alone. A candidate's weight is what the operator's data makes of it; how far
it is says nothing about whether somebody wants to go there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import Belief
from fgplan.errors import NoRoute
from fgplan.hypotheses import hypothesise
from fgplan.hypothesis import Hypothesis
from fgplan.labels import IN_NO_PLAN, misread
from fgplan.occupancy import OccupancyGrid
from fgplan.roadmap import Roadmap, roadmap
from fgplan.scenario import Scenario
from fgplan.timing import arc_length

Array = NDArray[np.float64]
Kind = Literal["given", "door", "end", "corner"]

DOOR = 0.7
"""Narrow is less than this share of the widest space on the way."""
SAME_WIDTH = 1.3
"""A corridor's width may vary by this factor along it."""
CORRIDOR = 2.5
"""Space narrower than this is a corridor [m]."""
REACH = 1.5
"""A shorter narrow part is a door, a longer one a corridor [m]."""
APART = 1.0
"""Candidates are at least this far from each other [m]."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A place somebody may want to go to.

    Args:
        label: Its name.
        position: Shape (2,) [m].
        kind: What it is on the map, or "given".

    Raises:
        ValueError: the label has what ends a name in that of a hypothesis, such as "+" or "/".
    """

    label: str
    position: Array
    kind: Kind = "given"

    def __post_init__(self) -> None:
        if (why := misread(self.label, IN_NO_PLAN)) is not None:
            raise ValueError(f"candidate {self.label!r} {why}")


def toward(candidates: Sequence[Candidate]) -> Callable[[Scenario, Belief], Sequence[Hypothesis]]:
    """A source of hypotheses for `plan`: the shortest route to each candidate, equally weighted.

    Candidates that nothing leads to are left out.

    Raises:
        NoRoute: by the source, when nothing leads to any of them.
    """

    def hypotheses(scenario: Scenario, belief: Belief) -> Sequence[Hypothesis]:
        found, trouble = [], None
        for candidate in candidates:
            towards = scenario.replace(goal=candidate.position, count=1, plans=())
            try:
                route = hypothesise(towards, belief)[0]
            except NoRoute as error:
                trouble = error
                continue
            found.append(replace(route, label=candidate.label))
        if not found and trouble is not None:
            raise trouble
        weight = -float(np.log(max(len(found), 1)))
        return tuple(replace(h, log_prior=weight) for h in found)

    return hypotheses


def find_candidates(
    grid: OccupancyGrid, here: Array, radius: float, most: int = 9
) -> tuple[Candidate, ...]:
    """Places of interest on a map that the robot can reach: doors, then ends and corners.

    A door is where the skeleton of the free space is much narrower than on both sides of it. A
    place from which nothing leads further away, by the length of the shortest path, is the end of
    a corridor where there is little room, and a corner of open space else.

    Args:
        grid: The map.
        here: Where the robot is, shape (2,) [m]; places nearer than `APART` to it are none.
        radius: Of the robot [m].
        most: How many, at most: the narrowest doors, then the farthest places.
    """
    road = roadmap(grid, radius)
    start = road.nearest_free(road.to_lattice(np.asarray(here, dtype=float)), 2 / road.cell)
    if start is None:
        return ()
    length = road.reach(start)[0]
    kept: list[Candidate] = []
    places: list[tuple[Kind | None, int]] = [*_narrows(grid, road, length)]
    places += [(None, node) for node in _farthest(road, length)]
    for kind, node in places:
        place = road.to_map(road.place(node))
        near = [np.asarray(here, dtype=float), *(c.position for c in kept)]
        if len(kept) == most or any(np.hypot(*(place - other)) < APART for other in near):
            continue
        if kind is None:
            kind = "end" if _width(grid, place) < CORRIDOR else "corner"
        kept.append(Candidate(f"{kind} {len(kept) + 1}", place, kind))
    return tuple(kept)


def _narrows(grid: OccupancyGrid, road: Roadmap, length: Array) -> list[tuple[Kind, int]]:
    """Nodes of the skeleton at short narrow parts, which are doors, the narrowest first; then
    those where a long narrow part, a corridor, opens into space."""
    doors, ends = [], []
    for chain in road.skeleton:
        path = road.to_map(road.place(chain))
        if len(path) < 3 or not np.isfinite(length[chain[0]]):
            continue
        room = grid.clearance(path, 0.0)
        s = arc_length(path)
        width = min(DOOR * room.max(), SAME_WIDTH * room.min() + grid.resolution)
        narrow = np.concatenate([[False], room < width, [False]])
        edges = np.flatnonzero(np.diff(narrow.astype(int)))
        for first, stop in zip(edges[::2], edges[1::2], strict=True):
            last = stop - 1
            if s[last] - s[first] < REACH and first > 0 and stop < len(chain):
                at = first + int(np.argmin(room[first:stop]))
                doors.append((float(room[at]), int(chain[at])))
            elif s[last] - s[first] >= REACH:
                ends += [int(chain[first])] * bool(first > 0)
                ends += [int(chain[last])] * bool(stop < len(chain))
    return [("door", node) for _, node in sorted(doors)] + [("end", node) for node in ends]


def _farthest(road: Roadmap, length: Array) -> list[int]:
    """Nodes from which nothing nearby is further away, the farthest first."""
    from scipy.ndimage import maximum_filter

    far = np.where(np.isfinite(length), length, -1.0).reshape(road.occupied.shape)
    size = 2 * round(APART / road.cell) + 1
    peaks = np.flatnonzero((far > 0) & (far == maximum_filter(far, size, mode="constant", cval=-1)))
    return [int(node) for node in peaks[np.argsort(-length[peaks], kind="stable")]]


def _width(grid: OccupancyGrid, place: Array) -> float:
    """Of the widest free space near a place [m]."""
    steps = np.linspace(-REACH, REACH, 21)
    around = place + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    return 2 * float(grid.clearance(around, 0.0).max())
