"""What the robot's sensors make of the truth: noise, losses, delay, a limited view, a map that
grows."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import visible
from fgplan.driving import Detection
from fgplan.occupancy import OccupancyGrid
from fgplan.scenario import FieldOfView
from fgplan.simulation.body import Body
from fgplan.simulation.people import People
from fgplan.simulation.world import Seen

Array = NDArray[np.float64]

STREAM = 5
"""Of the seed's random numbers, so that sensors change nothing else of a world."""
MAP_PERIOD = 0.5
"""Between two maps, where the map grows [s]."""


@dataclass(frozen=True)
class Quality:
    """How well the robot sees; the default is the truth, without velocities.

    Args:
        noise: Standard deviation of a detection along each axis [m].
        missed: Share of the detections that are missed.
        dropout: Share of the moments at which nothing is sensed.
        latency: What is seen is so old [s].
        identities: Whether people are told apart by name.
        velocities: Whether it is seen how people move.
        view: Where people are seen; None is everywhere.
        map_range: The map is known so far around where the robot has been [m].
    """

    noise: float = 0.0
    missed: float = 0.0
    dropout: float = 0.0
    latency: float = 0.0
    identities: bool = True
    velocities: bool = False
    view: FieldOfView | None = None
    map_range: float = np.inf


class Sensors:
    """Sees a world with some quality.

    Args:
        quality: How well.
        grid: The true map; None is open space.
        seed: Of noise and losses.
    """

    def __init__(self, quality: Quality, grid: OccupancyGrid | None, seed: int) -> None:
        self.quality = quality
        self._truth = grid
        self._rng = np.random.default_rng([seed, STREAM])
        self._waiting: deque[tuple[float, tuple[Detection, ...]]] = deque()
        self._known: NDArray[np.bool_] | None = None
        self._told: tuple[float, int] = (-np.inf, -1)

    def __call__(self, time: float, body: Body, people: People) -> Seen:
        quality = self.quality
        self._waiting.append((time, self._look(body, people)))
        detections = None
        # 1e-9: a sum of periods must meet the latency that was stated.
        while self._waiting and self._waiting[0][0] <= time - quality.latency + 1e-9:
            detections = self._waiting.popleft()[1]
        if quality.dropout > 0 and self._rng.random() < quality.dropout:
            detections = None
        return Seen(detections, self._explore(time, body.position))

    def _look(self, body: Body, people: People) -> tuple[Detection, ...]:
        quality, mask = self.quality, people.present.copy()
        if quality.view is not None:
            here = np.flatnonzero(mask)
            points = people.positions[here]
            view = quality.view
            mask[here] = visible(view, body.position, body.heading, points, self._truth)
        if quality.missed > 0:
            mask &= self._rng.random(len(mask)) >= quality.missed
        shift = np.zeros_like(people.positions)
        if quality.noise > 0:
            shift = self._rng.normal(0.0, quality.noise, people.positions.shape)
        return tuple(
            Detection(
                people.positions[i] + shift[i],
                people.names[i] if quality.identities else None,
                float(people.radii[i]),
                people.velocities[i].copy() if quality.velocities else None,
            )
            for i in np.flatnonzero(mask).tolist()
        )

    def _explore(self, time: float, position: Array) -> OccupancyGrid | None:
        """The map so far, where it is time and it shows more obstacles than the last one given."""
        truth, reach = self._truth, self.quality.map_range
        if truth is None or np.isinf(reach):
            return None
        near = _within(truth, position, reach)
        self._known = near if self._known is None else self._known | near
        obstacles = int(np.sum(truth.occupied & self._known))
        when, before = self._told
        if obstacles == before or time - when < MAP_PERIOD - 1e-9:
            return None
        self._told = time, obstacles
        return _seen_part(truth, self._known)


def known_at_first(
    grid: OccupancyGrid | None, position: Array, map_range: float
) -> OccupancyGrid | None:
    """What is known of a map [m] before the first step."""
    if grid is None or np.isinf(map_range):
        return grid
    return _seen_part(grid, _within(grid, position, map_range))


def _within(grid: OccupancyGrid, position: Array, reach: float) -> NDArray[np.bool_]:
    """Cells whose centre is near, shape (rows, cols)."""
    offset = grid.centres - position
    return np.asarray(np.hypot(offset[..., 0], offset[..., 1]) <= reach)


def _seen_part(grid: OccupancyGrid, known: NDArray[np.bool_]) -> OccupancyGrid:
    """The map with all other cells unknown, which may be driven through."""
    data = np.where(known, grid.data, -1).astype(np.int8)
    return replace(grid, data=data, unknown_is_free=True)
