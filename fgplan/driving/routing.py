"""The global plans that compete while driving: each keeps its name from step to step.

A search for routes costs tens of milliseconds, so it is made once a second, and when the map or
the goal changes. In between, every route is joined to where the robot is. A route that is found
again is known by its winding about the obstacles and keeps its name; the name of one that is lost
is given to another one after the next search at the earliest, and not while it is followed.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from itertools import count as counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgplan.errors import NoRoute
from fgplan.hypotheses import itineraries_of
from fgplan.labels import AT_ONCE
from fgplan.mission import Itinerary, Mission
from fgplan.occupancy import OccupancyGrid
from fgplan.roadmap import roadmap
from fgplan.routes import find_routes, label
from fgplan.safety import allowed
from fgplan.scenario import Scenario
from fgplan.timing import arc_length, path_length

Array = NDArray[np.float64]

LOOK_AT = 3
"""Itineraries of a mission looked at for each way asked for: many begin with the same way."""

ROUNDING = 1e-3
"""A path may come so near to an obstacle [m]: routes lead along corners, on a raster."""
SPACING = 0.05
"""Between points of a path that are looked at [m]."""


@dataclass(frozen=True)
class Routing:
    """How routes are kept up to date.

    Args:
        period: Between two searches [s].
        ahead: How far ahead of the robot a known route is joined [m].
        same: Where maps differ, two routes nearer to each other than this everywhere are one [m].
    """

    period: float = 1.0
    ahead: float = 1.0
    same: float = 0.5


@dataclass(frozen=True, eq=False)
class Way:
    """A global plan from where the robot is now.

    Args:
        label: Its name, for as long as it is known.
        path: Vertices, shape (N, 2) [m]; the first is where the robot is.
        log_weight: Of a plan that was given with one; 0 for others.
        stop: Where it ends, of a mission; "" for the goal.
        rest: What a mission still asks for beyond its end [m].
        born: Since when its name has been that of this way [s].
    """

    label: str
    path: Array
    log_weight: float = 0.0
    stop: str = ""
    rest: float = 0.0
    born: float = -np.inf

    @property
    def length(self) -> float:
        """Of the path [m]."""
        return path_length(self.path)

    @property
    def to_go(self) -> float:
        """All that is still to go [m]."""
        return self.length + self.rest


@dataclass(frozen=True, eq=False)
class Routes:
    """What is known about routes at one moment.

    Args:
        ways: The global plans, from where the robot is.
        searched: When they were searched last [s].
        grid, goal, mission: For what.
        trouble: Why there is no route, None where there is one.
    """

    ways: tuple[Way, ...] = ()
    searched: float = -np.inf
    grid: OccupancyGrid | None = None
    goal: Array | None = None
    trouble: NoRoute | None = None
    mission: Mission | None = None

    def update(self, scenario: Scenario, settings: Routing, keep: str | None) -> Routes:
        """The routes from where the robot is now.

        Args:
            scenario: What is known now.
            settings: See `Routing`.
            keep: Name of the route that is being followed: it stays, if it still leads on.
        """
        tried = [joined(way, scenario, settings) for way in self.ways]
        known = [way for way in tried if way is not None]
        here = scenario.robot.position
        lost = [
            replace(way, path=np.vstack([here, way.path]))
            for way, on in zip(self.ways, tried, strict=True)
            if on is None
        ]
        elsewhere = not _equal(self.goal, scenario.goal) or self.mission != scenario.mission
        changed = self.grid is not scenario.grid or elsewhere
        late = scenario.now - self.searched >= settings.period or scenario.now < self.searched
        # A straight line is no search.
        late |= scenario.grid is None and scenario.mission is None
        if not (changed or late or len(known) < len(self.ways) or not known):
            return replace(self, ways=tuple(known))
        if elsewhere:
            known = []
        if changed:
            lost = []
        if self.grid is not scenario.grid:
            known = [way for way in known if _leads_on(way, scenario)]
        trouble = None
        try:
            found = _search(scenario)
        except NoRoute as error:
            found, trouble = [], error
        used = set() if elsewhere else {keep, *(way.label for way in self.ways)}
        ways = _named(scenario, settings, found, known, lost, keep, used) if found else known
        return Routes(
            tuple(ways),
            scenario.now,
            scenario.grid,
            scenario.goal,
            None if ways else trouble,
            scenario.mission,
        )


def _search(scenario: Scenario) -> list[Way]:
    here = scenario.robot.position
    found = []
    for given in scenario.plans:
        vertices = np.asarray(given.path, dtype=float)
        weight = 0.0 if given.weight is None else float(np.log(max(given.weight, 1e-300)))
        found.append(Way(given.label, _from(here, vertices), weight))
    if scenario.mission is not None:
        found += _to_stops(scenario)
    elif scenario.goal is not None and scenario.count > 0:
        routes = find_routes(
            scenario.grid, here, scenario.goal, scenario.robot.radius, scenario.count
        )
        found += [Way("", route.path) for route in routes]
    return found


def _to_stops(scenario: Scenario) -> list[Way]:
    """The ways to the first stop of a mission's itineraries; the weights of itineraries that begin
    with the same way add up."""
    count, beta = max(scenario.count, 1), scenario.density.beta
    groups: dict[Any, list[Itinerary]] = {}
    for one in itineraries_of(scenario, LOOK_AT * count, count):
        groups.setdefault(one.signature[:1], []).append(one)
    ways = []
    for group in list(groups.values())[:count]:
        first, *_ = group
        more = [first.length - one.length for one in group]
        weight = float(np.logaddexp.reduce(beta / scenario.robot.preferred_speed * np.array(more)))
        stop = AT_ONCE.join(sorted(first.stops[0])) if first.stops else ""
        rest = first.length - path_length(first.ahead)
        ways.append(Way("", first.ahead, weight, stop, rest))
    return ways


def _named(
    scenario: Scenario,
    settings: Routing,
    found: list[Way],
    known: list[Way],
    lost: list[Way],
    keep: str | None,
    used: Collection[str | None],
) -> list[Way]:
    """New routes under the names of the old ones of their class, also of those that could not be
    joined; new names for new classes, which are none of those `used` until now."""
    named, left = [], list(known)
    for way in found:
        if way.label:
            twin = next((k for k in (*left, *lost) if k.label == way.label), None)
        else:
            twin = next((k for k in (*left, *lost) if _same(scenario, settings, way, k)), None)
        if twin is None:
            named.append(replace(way, born=scenario.now))
            continue
        left = [k for k in left if k is not twin]
        lost = [k for k in lost if k is not twin]
        named.append(replace(way, label=twin.label, born=twin.born))
    named += [way for way in left if way.label == keep]
    used = {*used, *(way.label for way in named)}
    for i, way in enumerate(named):
        if not way.label:
            names = (f"{way.stop} {label(n)}".strip() for n in counter())
            named[i] = replace(way, label=next(name for name in names if name not in used))
            used.add(named[i].label)
    return named


def _same(scenario: Scenario, settings: Routing, a: Way, b: Way) -> bool:
    """Whether two ways from the same place to the same goal wind about obstacles alike."""
    if a.stop != b.stop:
        return False
    if scenario.grid is None:
        return True
    if np.linalg.norm(a.path[-1] - b.path[-1]) > settings.same:
        return False
    road = roadmap(scenario.grid, scenario.robot.radius)
    loop = np.vstack([a.path, b.path[::-1]])
    return not np.any(road.signature(road.to_lattice(loop)))


def joined(way: Way, scenario: Scenario, settings: Routing) -> Way | None:
    """The way from here on; None where the straight line to it is not free."""
    here, radius, grid = scenario.robot.position, scenario.robot.radius, scenario.grid
    path = densified(way.path)
    nearest = int(np.argmin(np.linalg.norm(path - here, axis=1)))
    last = min(nearest + round(settings.ahead / SPACING), len(path) - 1)
    for at in (last, (nearest + last) // 2, min(nearest + 1, len(path) - 1)):
        rest = np.vstack([here, path[at:]])
        if grid is None or is_free(grid, rest[:2], radius):
            return replace(way, path=simplified(rest))
    return None


def is_free(grid: OccupancyGrid, path: Array, radius: float) -> bool:
    """Whether the robot's disc stays clear along a polyline (N, 2); where it is too near an
    obstacle at first, it must not come nearer, nor back."""
    gap = grid.clearance(densified(path), radius)[:, None]
    return bool(np.all(gap >= allowed(gap) - ROUNDING))


def densified(path: Array, spacing: float = SPACING) -> Array:
    """Points at most `spacing` apart along a polyline (N, 2), its vertices among them."""
    s = arc_length(path)
    at = np.union1d(s, np.linspace(0.0, s[-1], 1 + int(np.ceil(s[-1] / spacing))))
    return np.column_stack([np.interp(at, s, path[:, 0]), np.interp(at, s, path[:, 1])])


def simplified(path: Array) -> Array:
    """A polyline without the vertices on straight parts of it."""
    if len(path) < 3:
        return path
    step = np.diff(path, axis=0)
    turn = step[:-1, 0] * step[1:, 1] - step[:-1, 1] * step[1:, 0]
    back = np.einsum("ij,ij->i", step[:-1], step[1:]) < 0
    keep = np.concatenate([[True], (np.abs(turn) > 1e-9) | back, [True]])
    return np.asarray(path[keep])


def _leads_on(way: Way, scenario: Scenario) -> bool:
    grid = scenario.grid
    return grid is None or is_free(grid, way.path, scenario.robot.radius)


def _from(here: Array, vertices: Array) -> Array:
    """A given path from here on: from the vertex after the nearest point of it."""
    path = densified(vertices)
    nearest = int(np.argmin(np.linalg.norm(path - here, axis=1)))
    rest = path[nearest:]
    if np.allclose(rest[0], here, atol=1e-9):
        return simplified(rest)
    return simplified(np.vstack([here, rest[1:] if len(rest) > 1 else rest]))


def _equal(a: Array | None, b: Array | None) -> bool:
    if a is None or b is None:
        return a is b
    return bool(np.array_equal(a, b))
