"""How near robot and people came during a substep."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgplan.simulation.body import Body
from fgplan.simulation.people import Disc, People

Array = NDArray[np.float64]


class Still(NamedTuple):
    """People before a substep; shapes as in `People`."""

    positions: Array
    velocities: Array
    present: NDArray[np.bool_]


Gap = Callable[[Disc, Still, Body, People, float], float]
"""From robot and people before and after a substep of dt [s]: least distance between the edges of
the robot and anybody [m]; negative in a contact, inf where nobody is about."""


def moved(robot: Disc, before: Still, body: Body, people: People, dt: float) -> float:
    """While all moved evenly from where they were to where they are; who came in anew counts
    where they are now."""
    present = people.present
    if not present.any():
        return np.inf
    ends = people.positions - body.position
    stayed = (before.present & present)[:, None]
    starts = np.where(stayed, before.positions - robot.position, ends)
    apart = nearest(starts, ends - starts) - people.radii
    return float(apart[present].min()) - body.radius


def extrapolated(robot: Disc, before: Still, body: Body, people: People, dt: float) -> float:
    """While the robot moved as it did and people went on as before: what the published CrowdNav
    code checks."""
    if not before.present.any():
        return np.inf
    starts = before.positions - robot.position
    way = dt * before.velocities - (body.position - robot.position)
    apart = nearest(starts, way) - people.radii
    return float(apart[before.present].min()) - body.radius


def nearest(starts: Array, ways: Array) -> Array:
    """Least distance of segments from the origin, by starts and ways (..., 2): shape (...)."""
    square = np.einsum("...j,...j->...", ways, ways)
    share = -np.einsum("...j,...j->...", starts, ways) / np.maximum(square, 1e-12)
    points = starts + np.clip(share, 0.0, 1.0)[..., None] * ways
    return np.asarray(np.hypot(points[..., 0], points[..., 1]))
