"""Pull a path taut and round its corners, within its homotopy class and clear of obstacles.

Lattice coordinates, as in `fgplan.roadmap`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fgplan.roadmap import COMFORT, Roadmap

Array = NDArray[np.float64]

PROBES = 16
"""Shortcuts tried at once."""

LEVELS = ((8.0, 30), (4.0, 20), (2.0, 10))
"""Spacing of a band's points [cells] and sweeps over them, coarse to fine."""

COMFORT_GAIN = 0.1
"""Share of a missing comfort that one sweep makes up for."""


def pull(road: Roadmap, path: Array) -> Array:
    """Join a lattice path's vertices (N, 2) by long straight lines that keep the radius and the
    class; shape (n, 2)."""
    wound = np.zeros((len(path), len(road.obstacles)), dtype=np.intp)
    np.cumsum(road.crossings(path[:-1], path[1:]), axis=0, out=wound[1:])
    chosen = [0]
    while chosen[-1] < len(path) - 1:
        chosen.append(_farthest(road, path, wound, chosen[-1]))
    return path[chosen]


def _farthest(road: Roadmap, path: Array, wound: NDArray[np.intp], here: int) -> int:
    """A far vertex that a straight line from vertex `here` reaches, by two rounds of probes."""
    best, beyond = here + 1, len(path)
    for _ in range(2):
        if beyond - best < 2:
            break
        targets = np.unique(np.linspace(best + 1, beyond - 1, PROBES).astype(int))
        ends = path[targets]
        seen = road.sees(path[here], ends)
        turns = road.crossings(np.broadcast_to(path[here], ends.shape), ends)
        seen &= np.all(turns == wound[targets] - wound[here], axis=1)
        for number in np.flatnonzero(seen)[::-1]:
            # `sees` may miss a corner between two samples.
            if road.clearance([path[[here, targets[number]]]])[0][0] >= road.rho:
                best = int(targets[number])
                beyond = int(targets[number + 1]) if number + 1 < len(targets) else best + 1
                break
        else:
            beyond = int(targets[0])
    return best


def tighten(road: Roadmap, path: Array) -> Array:
    """A pulled path (n, 2), pulled again from its other end with vertices between its own."""
    if len(path) <= 2:
        return path
    return pull(road, _subdivided(path, 6.0)[::-1])[::-1]


def _subdivided(path: Array, spacing: float) -> Array:
    """The same polyline with more vertices, at most `spacing` apart."""
    parts = []
    for a, b in zip(path[:-1], path[1:], strict=True):
        pieces = max(1, int(np.ceil(np.linalg.norm(b - a) / spacing)))
        parts.append(a + np.arange(pieces)[:, None] / pieces * (b - a))
    return np.vstack([*parts, path[-1:]])


def smooth(road: Roadmap, paths: list[Array]) -> list[Array]:
    """Paths (n, 2) as elastic bands: each point moves towards the middle of its neighbours and
    away from obstacles, up to `COMFORT`. Ends stay. Where a band would come too near an obstacle
    it is the given path again, and all of it where it would leave its class.

    All paths at once: the work is in the calls, not in the points.
    """
    bands = paths
    for spacing, sweeps in LEVELS:
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
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    return length / max(length[-1], 1e-12)


def _relaxed(road: Roadmap, bands: list[Array], anchors: list[Array], sweeps: int) -> list[Array]:
    ends = np.cumsum([len(band) for band in bands])
    x = np.vstack(bands)
    inner = np.ones(len(x), dtype=bool)
    inner[ends - 1] = False
    inner[np.append(0, ends[:-1])] = False
    at = np.flatnonzero(inner)
    # A robot that stands too near an obstacle is asked for no more than its straight way out.
    need = np.minimum(road.required, road.field.distance(np.vstack(anchors)[at]))
    wish = road.required + COMFORT / road.cell
    for _ in range(sweeps):
        y = 0.5 * x[at] + 0.25 * (x[at - 1] + x[at + 1])
        F, slope = road.field.linearize(y)
        steep = np.maximum(np.einsum("ij,ij->i", slope, slope), 0.25)
        push = np.maximum(need - F, 0.0) + COMFORT_GAIN * np.maximum(wish - F, 0.0)
        x[at] = y + (push / steep)[:, None] * slope
    return np.split(x, ends[:-1])


def _checked(road: Roadmap, bands: list[Array], anchors: list[Array]) -> list[Array]:
    """The bands, with the anchor's points back where a segment keeps less than the radius (or,
    on the way out of an obstacle's neighbourhood, less than the anchor)."""
    floor = [np.minimum(road.rho, kept) for kept in road.clearance(anchors)]
    while True:
        back = False
        for number, kept in enumerate(road.clearance(bands)):
            low = np.flatnonzero(kept < floor[number] - 1e-12)
            if len(low):
                back = True
                points = np.unique(np.clip(low[:, None] + np.arange(-1, 3), 0, len(kept)))
                bands[number][points] = anchors[number][points]
        if not back:
            return bands
