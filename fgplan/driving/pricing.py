"""What people cost on the part of a route that the density does not see: J beyond the horizon.

Two beliefs, in seconds. A *blockage*, people who stand where nobody can pass, is expected to last
as long again as it has lasted, and is remembered when out of sight; going round at the moment when
that costs less wastes at most the time that the way round takes (the ski-rental argument). A
*crowd* that comes the other way costs the time to pass each one, the more the narrower the place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import Belief
from fgplan.driving.routing import Way, densified
from fgplan.occupancy import OccupancyGrid
from fgplan.scenario import Scenario
from fgplan.timing import arc_length

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CELL = 0.1
"""Of the raster on which a passage is looked for [m]."""
WINDOW = 1.5
"""A passage leads round people at most this far from the route [m]."""


@dataclass(frozen=True)
class Pricing:
    """What people on a route cost.

    Args:
        standing: Slower people stand [m/s].
        least: What a blockage that was just seen is expected to last [s].
        memory: How long a blockage out of sight is remembered [s].
        passing: What somebody who comes the other way costs where robot and person just fit beside
            each other [s]: 1.1 s in a corridor of 2 m, as driven among 4 to 12 people in S1.
        lane: Widest part of a corridor that counts as one way [m].
    """

    standing: float = 0.25
    least: float = 1.0
    memory: float = 60.0
    passing: float = 3.5
    lane: float = 3.0


@dataclass(frozen=True, eq=False)
class Blockage:
    """People who stand where the robot cannot pass.

    Args:
        place: Where, shape (2,) [m].
        since: When it was first seen [s].
        last: When it was last seen [s].
        free: Whether the place was seen free since. It costs nothing then, and is remembered as
            long as it lasted: who only shifts their feet does not begin to stand anew.
    """

    place: Array
    since: float
    last: float
    free: bool = False

    def remaining(self, settings: Pricing) -> float:
        """How long it is expected to last from when it was last seen [s]."""
        return max(self.last - self.since, settings.least)


def update(
    blockages: Sequence[Blockage],
    scenario: Scenario,
    belief: Belief,
    ways: Sequence[Way],
    settings: Pricing,
    visible: Callable[[Array], Mask],
) -> tuple[Blockage, ...]:
    """What is known about blockages after a look round."""
    now = scenario.now
    seen = [place for way in ways for place in _blocked(scenario, belief, way, settings)]
    kept = []
    for old in blockages:
        near = [i for i, place in enumerate(seen) if np.hypot(*(place - old.place)) < WINDOW]
        if near:
            kept.append(replace(old, place=seen[near[0]], last=now, free=False))
            seen = [place for i, place in enumerate(seen) if i not in near]
            continue
        free = old.free or bool(visible(old.place[None])[0])
        if now - old.last < (old.remaining(settings) if free else settings.memory):
            kept.append(replace(old, free=free))
    for place in seen:
        if all(np.hypot(*(place - known.place)) >= WINDOW for known in kept):
            kept.append(Blockage(place, now, now))
    return tuple(kept)


def delay(
    way: Way, blockages: Sequence[Blockage], scenario: Scenario, settings: Pricing
) -> tuple[float, float]:
    """What blockages cost on a route, beyond the time it takes to reach them [s], and how far
    along it the first one is [m], inf where there is none."""
    blockages = [blockage for blockage in blockages if not blockage.free]
    if not blockages:
        return 0.0, np.inf
    path = densified(way.path, CELL)
    s = arc_length(path)
    cost, first = 0.0, np.inf
    for blockage in blockages:
        apart = np.linalg.norm(path - blockage.place, axis=1)
        nearest = int(np.argmin(apart))
        if apart[nearest] < 2 * scenario.robot.radius + CELL:
            until = blockage.remaining(settings)
            cost = max(cost, until - float(s[nearest]) / scenario.robot.preferred_speed)
            first = min(first, float(s[nearest]))
    return cost, first


def congestion(way: Way, scenario: Scenario, belief: Belief, settings: Pricing) -> float:
    """What people cost beyond the horizon, Σ passing (d/w)² [s], d the widths of robot and person
    together and w that of the way there, at least d.

    It is a sum over people, and so does not depend on how they happen to be spread. They count as
    far as they come towards the robot: who walks the same way, and no slower, costs nothing.
    """
    grid, robot = scenario.grid, scenario.robot
    if grid is None or not belief.count:
        return 0.0
    path = densified(way.path, 2 * CELL)
    s = arc_length(path)
    beyond = robot.preferred_speed * scenario.density.horizon
    if s[-1] <= beyond:
        return 0.0
    tangent = np.gradient(path, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    half = np.maximum(_half_width(grid, path, tangent, settings.lane), robot.radius)
    apart = np.linalg.norm(belief.mean[:, None, :2] - path, axis=-1)
    nearest = apart.argmin(axis=1)
    on = (apart[np.arange(belief.count), nearest] < half[nearest]) & (s[nearest] > beyond)
    if not on.any():
        return 0.0
    with_us = np.einsum("ij,ij->i", belief.mean[:, 2:], tangent[nearest])
    weight = np.clip(1 - with_us / robot.preferred_speed, 0.0, 2.0) / 2
    share = np.minimum((robot.radius + belief.radii) / half[nearest], 1.0)
    return settings.passing * float((weight * share**2)[on].sum())


def _half_width(grid: OccupancyGrid, path: Array, tangent: Array, lane: float) -> Array:
    """Half the width of the passage at each point of a path (N, 2), at most half a lane: the
    largest clearance on the line across it, shape (N,) [m]. That of the path itself is none, as
    the shortest way leads along corners."""
    offset = np.arange(0.0, lane / 2 + CELL / 2, CELL)
    across = offset[:, None] * np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)[:, None]
    clearance = grid.clearance(np.stack([path[:, None] + across, path[:, None] - across]), 0.0)
    free = np.logical_and.accumulate(clearance > 0, axis=-1)
    widest = np.where(free, clearance, 0.0).max(axis=(0, 2))
    return np.asarray(np.minimum(widest, lane / 2))


def _blocked(scenario: Scenario, belief: Belief, way: Way, settings: Pricing) -> list[Array]:
    """Places on a route where those who stand leave no way past them."""
    if scenario.grid is None or not belief.count:
        return []
    # Of somebody who was seen once the velocity is not known: that is no standing.
    known = np.sqrt(belief.covariance[:, 2, 2]) < settings.standing
    standing = known & (np.linalg.norm(belief.mean[:, 2:], axis=1) < settings.standing)
    people, radii = belief.mean[standing, :2], belief.radii[standing]
    if not len(people):
        return []
    path = densified(way.path, CELL)
    apart = np.linalg.norm(people[:, None] - path, axis=-1)
    near = np.flatnonzero(apart.min(axis=1) < scenario.robot.radius + radii)
    places: list[Array] = []
    for person in near[np.argsort(apart[near].argmin(axis=1), kind="stable")]:
        at = int(apart[person].argmin())
        if all(np.hypot(*(path[at] - p)) > WINDOW for p in places) and not _passable(
            scenario.grid, scenario.robot.radius, path, at, people, radii
        ):
            places.append(path[at])
    return places


def _passable(
    grid: OccupancyGrid, radius: float, path: Array, at: int, people: Array, radii: Array
) -> bool:
    """Whether, near a point of a path, the robot's disc finds a way on past people who stand."""
    from scipy.ndimage import label

    centre = path[at]
    steps = np.arange(-WINDOW, WINDOW + CELL, CELL)
    cells = centre + np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)
    free = grid.clearance(cells, radius) >= 0
    for person, r in zip(people, radii, strict=True):
        free &= np.linalg.norm(cells - person, axis=-1) >= radius + r
    parts, _ = label(free, np.ones((3, 3)))
    along = np.linalg.norm(path - centre, axis=1) <= WINDOW - CELL
    inside = np.flatnonzero(along)
    run = inside[(inside <= at)], inside[(inside >= at)]
    index = np.round((path - centre + WINDOW) / CELL).astype(int)
    reached = [set(parts[tuple(index[part].T)].tolist()) - {0} for part in run]
    before, after = reached
    if not before or not after:
        return False
    return bool(before & after)
