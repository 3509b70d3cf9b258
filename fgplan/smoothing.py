"""Pull a path taut and round its corners, within its homotopy class and clear of obstacles.

Lattice coordinates, as in `fgplan.roadmap`.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from fgplan.roadmap import COMFORT, Roadmap
from fgplan.timing import arc_length

Array = NDArray[np.float64]
Sight = Callable[[Array, Array], NDArray[np.bool_]]

PROBES = 10
"""Shortcuts tried at once."""

LEVELS = ((8.0, 30), (4.0, 20), (2.0, 10))
"""Spacing of a band's points [cells] and sweeps over them, coarse to fine."""

SLACK = 0.05
"""By how much the bound of a clearance [cells] may miss the radius only because it is a bound."""

COMFORT_GAIN = 0.1
"""Share of a missing comfort that one sweep makes up for."""


def taut(road: Roadmap, path: Array) -> Array:
    """A lattice path (N, 2), pulled taut within its class: straight lines between few of its
    vertices, shape (n, 2), all of which keep the radius."""
    quick = _pulled(road, path, road.sees)
    if np.all(road.clearance([quick])[0] >= road.rho):
        return quick
    return _pulled(road, path, road.surely_sees)


def _pulled(road: Roadmap, path: Array, sees: Sight) -> Array:
    """Once from each end: a greedy shortcut turns late, right at the end it comes from."""
    once = _shortcut(road, path, sees)
    if len(once) <= 2:
        return once
    return _shortcut(road, _subdivided(once, 8.0)[::-1], sees)[::-1]


def _shortcut(road: Roadmap, path: Array, sees: Sight) -> Array:
    wound = np.zeros((len(path), len(road.obstacles)), dtype=np.intp)
    np.cumsum(road.crossings(path[:-1], path[1:]), axis=0, out=wound[1:])
    chosen = [0]
    while chosen[-1] < len(path) - 1:
        chosen.append(_farthest(road, path, wound, chosen[-1], sees))
    return path[chosen]


def _farthest(road: Roadmap, path: Array, wound: NDArray[np.intp], here: int, sees: Sight) -> int:
    """A far vertex that a straight line from vertex `here` reaches, by two rounds of probes."""
    best, beyond = here + 1, len(path)
    for _ in range(2):
        if beyond - best < 2:
            break
        targets = np.linspace(best + 1, beyond - 1, PROBES).astype(int)
        targets = targets[np.append(True, targets[1:] > targets[:-1])]
        ends = path[targets]
        turns = road.crossings(path[here : here + 1], ends)
        same = np.all(turns == wound[targets] - wound[here], axis=1)
        seen = np.flatnonzero(same & sees(path[here], ends))
        if len(seen):
            best = int(targets[seen[-1]])
        after = targets[targets > best]
        beyond = int(after[0]) if len(after) else best
    return best


def _subdivided(path: Array, spacing: float) -> Array:
    """The same polyline with more vertices, at most `spacing` apart."""
    step = np.diff(path, axis=0)
    pieces = np.maximum(np.ceil(np.linalg.norm(step, axis=1) / spacing), 1.0).astype(np.intp)
    which = np.repeat(np.arange(len(step)), pieces)
    share = (np.arange(len(which)) - (np.cumsum(pieces) - pieces)[which]) / pieces[which]
    return np.vstack([path[which] + share[:, None] * step[which], path[-1:]])


def smooth(road: Roadmap, paths: list[Array], until: float = np.inf) -> list[Array]:
    """Paths (n, 2) as elastic bands: each point moves towards the middle of its neighbours and
    away from obstacles, up to `COMFORT`. Ends stay. Where a band would come too near an obstacle
    it is the given path again, and all of it where it would leave its class.

    All paths at once: the work is in the calls, not in the points. After `until`, on the clock of
    `time.perf_counter` [s], no finer level is begun.
    """
    bands = anchors = paths
    for spacing, sweeps in LEVELS:
        if perf_counter() >= until:
            break
        anchors = [_subdivided(path, spacing) for path in paths]
        bands = [_resampled(band, anchor) for band, anchor in zip(bands, anchors, strict=True)]
        bands = _relaxed(road, bands, anchors, sweeps)
    bands = _checked(road, bands, anchors)
    return [
        band if np.array_equal(road.signature(band), road.signature(path)) else path
        for band, path in zip(bands, anchors, strict=True)
    ]


def _resampled(band: Array, anchor: Array) -> Array:
    """Points on a band at the same shares of its length as the anchor's points have of theirs."""
    reached, wanted = _shares(band), _shares(anchor)
    return np.stack([np.interp(wanted, reached, band[:, k]) for k in (0, 1)], axis=-1)


def _shares(path: Array) -> Array:
    length = arc_length(path)
    return np.asarray(length / max(length[-1], 1e-12))


def _relaxed(road: Roadmap, bands: list[Array], anchors: list[Array], sweeps: int) -> list[Array]:
    ends = np.cumsum([len(band) for band in bands])
    x = np.vstack(bands)
    # Slices over all points are cheaper than a choice of those between the ends of a band.
    fixed = np.sort(np.concatenate([ends - 1, ends[:-1]]))
    held, inner = x[fixed], slice(1, -1)
    # A robot that stands too near an obstacle is asked for no more than its straight way out.
    need = np.minimum(road.required, road.field.distance(np.vstack(anchors)[inner]))
    wish = road.required + COMFORT / road.cell
    aside = np.zeros_like(x)
    for _ in range(sweeps):
        y = _averaged(x)
        F, slope = road.field.linearize(y)
        slope /= np.maximum(np.einsum("ij,ij->i", slope, slope), 0.25)[:, None]
        # In the middle of a lane the slope flips from point to point: the wish for more room is
        # averaged over neighbours, the need for enough is not.
        aside[inner] = np.maximum(wish - F, 0.0)[:, None] * slope
        aside[fixed] = 0.0
        x[inner] = y + np.maximum(need - F, 0.0)[:, None] * slope
        x[inner] += COMFORT_GAIN * _averaged(aside)
        x[fixed] = held
    return np.split(x, ends[:-1])


def _averaged(x: Array) -> Array:
    """Of points (N, 2), each but the first and last with its two neighbours, shape (N − 2, 2)."""
    mean = x[:-2] + x[2:]
    mean *= 0.25
    mean += 0.5 * x[1:-1]
    return mean


def _checked(road: Roadmap, bands: list[Array], anchors: list[Array]) -> list[Array]:
    """The bands, with the anchor's points back where a segment keeps less than the radius (or,
    on the way out of an obstacle's neighbourhood, less than the anchor)."""
    floor = [np.where(kept > road.rho - SLACK, road.rho, kept) for kept in road.clearance(anchors)]
    given = [np.zeros(len(anchor), dtype=bool) for anchor in anchors]
    while True:
        changed = False
        for number, kept in enumerate(road.clearance(bands)):
            low = np.flatnonzero(kept < floor[number])
            back = np.zeros_like(given[number])
            back[np.clip(low[:, None] + np.arange(-1, 3), 0, len(kept))] = True
            if np.any(back & ~given[number]):
                changed = True
                given[number] |= back
                bands[number] = np.where(given[number][:, None], anchors[number], bands[number])
        if not changed:
            return bands
