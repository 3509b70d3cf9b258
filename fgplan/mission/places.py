"""The map as a mission sees it: places where the same regions hold, and the legs between them.

This is the graph that missions are planned on. Its nodes are places (pieces of the free space in
the same regions), its edges legs through the free space, one for each way round the obstacles. A
k-best search on grid cells would return copies of one path; two edges are two homotopy classes.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from fgplan.errors import NoRoute
from fgplan.mission.progression import Letter
from fgplan.occupancy import OccupancyGrid
from fgplan.regions import Region, letter_at, word_along
from fgplan.roadmap import Roadmap, roadmap
from fgplan.routes import Route, find_routes

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SHORTER = 0.9
"""A path on the lattice, times this, is no longer than any path of a robot: it takes only eight
directions, and is at most 1/cos(π/8) = 1.08 times too long."""

MOST_CARVINGS = 12
"""Attempts to lead a leg round what it must not enter."""

MOST_LEGS = 1000
"""Kept: a goal that moves must not fill the memory."""

OPEN_CELL, OPEN_MARGIN = 0.1, 3.0
"""Without a map: cells of the one made, and the room around what is known [m]."""


@dataclass(frozen=True, eq=False)
class Place:
    """A connected piece of the free space in the same regions.

    Args:
        letter: The regions, at least one.
        anchor: Where the robot goes to visit it: a free point deep inside, shape (2,) [m].
        ahead: Shortest distance from there to every node of the lattice [m], inf where there is
            none.
    """

    letter: Letter
    anchor: Array
    ahead: Array


@dataclass(frozen=True, eq=False)
class Leg:
    """A way between two places.

    Args:
        route: Its path, length and winding.
        round: The regions that it was led around, as letters.
        word: The letters read along it, without that of its start.
    """

    route: Route
    round: tuple[Letter, ...]
    word: tuple[Letter, ...]


class Places:
    """The places of a map, and legs between them, kept while the map stays the same.

    Args:
        grid: The map; regions that are closed are obstacles in it.
        regions: Those that the mission speaks of.
        radius: Of the robot [m].
    """

    def __init__(self, grid: OccupancyGrid, regions: tuple[Region, ...], radius: float) -> None:
        self.grid, self.regions, self.radius = grid, regions, radius
        self._legs: dict[tuple[Hashable, ...], tuple[Leg, ...]] = {}

    @cached_property
    def road(self) -> Roadmap:
        """Where the robot's centre may be at all."""
        return roadmap(self.grid, self.radius)

    @cached_property
    def places(self) -> tuple[Place, ...]:
        """All places, in the order of the regions."""
        from scipy.ndimage import distance_transform_edt, label

        free, points = self.road.free, self._points
        number = _numbers(self.regions, points)
        found = []
        for value in np.unique(number[number > 0]).tolist():
            letter = _letter(self.regions, value)
            pieces, count = label((number == value) & free)
            for piece in range(1, count + 1):
                # Padded: the rim of the map is an edge as well.
                depth = distance_transform_edt(np.pad(pieces == piece, 1))[1:-1, 1:-1]
                node = int(np.argmax(depth))
                length, _ = self.road.reach(node)
                anchor = self.road.to_map(self.road.place(node))
                found.append(Place(letter, anchor, length * self.road.cell * SHORTER))
        return tuple(found)

    @cached_property
    def letters(self) -> tuple[Letter, ...]:
        """What can be read on this map, in free space."""
        values = np.unique(_numbers(self.regions, self._points)[self.road.free])
        return tuple(_letter(self.regions, value) for value in {0, *values.tolist()})

    def at(self, point: Array) -> Letter:
        """The regions that a point is in."""
        return letter_at(self.regions, point)

    def word(self, path: Array) -> list[Letter]:
        """The letters read along a path, that of its start included."""
        return word_along(self.regions, path)

    def distance(self, place: int, point: Array) -> float:
        """At most the length of the shortest way from a point to a place [m]; inf: none."""
        road = self.road
        within = (1.0 + self.radius) / road.cell
        node = road.nearest_free(road.to_lattice(point), within)
        return np.inf if node is None else float(self.places[place].ahead[node])

    def between(self, a: int, b: int, allowed: frozenset[Letter], count: int) -> tuple[Leg, ...]:
        """At most `count` legs between two places that stay where the letters are allowed."""
        start, goal = self.places[a], self.places[b]
        return self._led(start.anchor, goal.anchor, allowed, count, (a, b))

    def onwards(
        self, a: int, goal: Array, allowed: frozenset[Letter], count: int
    ) -> tuple[Leg, ...]:
        """The same from a place to a point that is no place, such as the scenario's goal."""
        anchor = self.places[a].anchor
        return self._led(anchor, goal, allowed, count, (a, *goal.tolist()))

    def legs(
        self, start: Array, goal: Array, allowed: frozenset[Letter], count: int
    ) -> tuple[Leg, ...]:
        """The same between two points, which are not kept."""
        return self._led(start, goal, allowed, count, None)

    def _led(
        self,
        start: Array,
        goal: Array,
        allowed: frozenset[Letter],
        count: int,
        key: tuple[Hashable, ...] | None,
    ) -> tuple[Leg, ...]:
        """Led around what it must not enter, as far as that is in the way: carving everything
        would close ways that are open, and make new classes around what nobody meets."""
        carved: frozenset[Letter] = frozenset()
        for _ in range(MOST_CARVINGS):
            if key is not None and (*key, count, carved) in self._legs:
                legs = self._legs[(*key, count, carved)]
            else:
                legs = self._found(start, goal, carved, count)
                if key is not None:
                    if len(self._legs) >= MOST_LEGS:
                        self._legs.clear()
                    self._legs[(*key, count, carved)] = legs
            wrong = {letter for leg in legs for letter in leg.word} - allowed
            if not wrong:
                return legs
            if wrong <= carved:  # still cut at a rim: those that are clear must do
                return tuple(leg for leg in legs if not set(leg.word) - allowed)
            carved |= wrong
        return ()

    def _found(
        self, start: Array, goal: Array, carved: frozenset[Letter], count: int
    ) -> tuple[Leg, ...]:
        grid = self._carved(carved)
        try:
            routes = find_routes(grid, start, goal, self.radius, count)
        except NoRoute:
            return ()
        around = tuple(sorted(carved, key=sorted))
        return tuple(Leg(r, around, tuple(self.word(r.path)[1:])) for r in routes)

    def _carved(self, letters: frozenset[Letter]) -> OccupancyGrid:
        """The map with what these letters cover as obstacles."""
        if not letters:
            return self.grid
        return _carved(self, letters)

    @cached_property
    def _points(self) -> Array:
        """Centres of the lattice's cells, shape (rows, cols, 2) [m]."""
        rows, cols = self.road.free.shape
        nodes = np.arange(rows * cols).reshape(rows, cols)
        return self.road.to_map(self.road.place(nodes))


@lru_cache(maxsize=8)
def places(
    grid: OccupancyGrid | None,
    regions: tuple[Region, ...],
    closed: frozenset[str],
    radius: float,
    room: tuple[float, float, float, float],
) -> Places:
    """The places of a map, kept for the next question.

    Args:
        grid: None: open space, of which `room` is looked at.
        regions: Those that the mission speaks of, and those that are closed.
        closed: Names of regions that cannot be entered.
        radius: Of the robot [m].
        room: (x_min, y_min, x_max, y_max) [m]; only without a map.
    """
    if grid is None:
        cell = max(OPEN_CELL, float(np.hypot(room[2] - room[0], room[3] - room[1])) / 700)
        grid = OccupancyGrid.from_polygons([], room, cell)
    shut = [region for region in regions if region.name in closed]
    if shut:
        grid = grid.with_obstacles(np.any([r.contains(grid.centres) for r in shut], axis=0))
    return Places(grid, tuple(r for r in regions if r.name not in closed), radius)


def room_for(
    points: Iterable[Array], regions: Iterable[Region]
) -> tuple[float, float, float, float]:
    """What to look at without a map: everything known with room around it, in steps of 5 m, so
    that it stays the same while the robot moves."""
    every = [np.atleast_2d(point) for point in points]
    for region in regions:
        outline = np.array(region.polygon)
        every += [outline - region.radius, outline + region.radius]
    known = np.vstack(every)
    low = 5.0 * np.floor((known.min(axis=0) - OPEN_MARGIN) / 5.0)
    high = 5.0 * np.ceil((known.max(axis=0) + OPEN_MARGIN) / 5.0)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


@lru_cache(maxsize=16)
def _carved(places: Places, letters: frozenset[Letter]) -> OccupancyGrid:
    grid = places.grid
    number = _numbers(places.regions, grid.centres)
    values = [v for v in np.unique(number).tolist() if _letter(places.regions, v) in letters]
    return grid.with_obstacles(np.isin(number, values))


def _numbers(regions: tuple[Region, ...], points: Array) -> NDArray[np.int64]:
    """The regions that each point is in, as the bits of a number."""
    number = np.zeros(points.shape[:-1], dtype=np.int64)
    for bit, region in enumerate(regions):
        low, high = _box(region)
        near = np.all((points >= low) & (points <= high), axis=-1)
        inside = np.zeros(near.shape, dtype=bool)
        inside[near] = region.contains(points[near])
        number |= inside.astype(np.int64) << bit
    return number


def _box(region: Region) -> tuple[Array, Array]:
    outline = np.array(region.polygon)
    return outline.min(axis=0) - region.radius, outline.max(axis=0) + region.radius


def _letter(regions: tuple[Region, ...], number: int) -> Letter:
    return frozenset(r.name for bit, r in enumerate(regions) if number >> bit & 1)
