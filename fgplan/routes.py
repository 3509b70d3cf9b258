"""K distinct global paths: pairwise non-homotopic, clear of obstacles, the shortest first.

The skeleton of the free space keeps its topology, so simple paths through it are the homotopy
classes a robot may sensibly choose from. They are enumerated by length, pulled taut and rounded
without leaving their class, and told apart by how they wind around each obstacle.
"""

from __future__ import annotations

import heapq
import math
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count as counter
from itertools import pairwise
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fgplan.errors import NoRoute
from fgplan.roadmap import Nodes, Roadmap, reach, roadmap, trace
from fgplan.smoothing import smooth, taut

if TYPE_CHECKING:
    from fgplan.occupancy import OccupancyGrid

Array = NDArray[np.float64]

START_TOLERANCE = 1.0
"""How far beyond its radius a robot that stands too near an obstacle looks for a free place [m]."""

GOAL_TOLERANCE = 0.5
"""How far from the goal a route may end [m], where the robot's disc does not fit at the goal."""

DETOUR = 0.7
"""A pulled path is rarely shorter than this share of its skeleton path: where to stop looking."""

MOST_CANDIDATES = 8
"""Skeleton paths looked at for each route asked for."""

MOST_EXPANSIONS = 20_000
"""Of the enumeration, so that a maze ends with fewer routes and not with a hang."""


@dataclass(frozen=True, eq=False)
class Route:
    """A global path and its homotopy class.

    Args:
        label: "A" for the shortest route, then "B", ...
        path: Vertices, shape (N, 2), N ≥ 2 [m].
        length: [m].
        signature: Winding number about each obstacle (each inner piece of the space where the
            robot does not fit), relative to the shortest route.
    """

    label: str
    path: Array
    length: float
    signature: tuple[int, ...]


def find_routes(
    grid: OccupancyGrid | None,
    start: Any,
    goal: Any,
    radius: float,
    count: int,
    until: float = np.inf,
) -> tuple[Route, ...]:
    """At most `count` routes, the shortest first; fewer where there are fewer classes.

    The robot's disc is clear of obstacles along each. Two exceptions: a robot that stands too
    near an obstacle already leaves by a straight line to the nearest free place; and where it
    does not fit at the goal, routes end at the nearest place where it does, at most
    `GOAL_TOLERANCE` away.

    Args:
        grid: None is open space, with the straight line as its only route.
        start: Shape (2,) [m].
        goal: Shape (2,) [m].
        radius: Of the robot [m].
        count: How many routes, at least 1.
        until: When to stop, on the clock of `time.perf_counter` [s]: one route there is in any
            case, but others are not looked for any more, nor are corners rounded further.

    Raises:
        NoRoute: start or goal is outside the map or in an obstacle, or nothing joins them.
        ValueError: a number is not finite, the radius is negative, or count is below 1.
    """
    a, b = _point(start, "start"), _point(goal, "goal")
    _size(radius)
    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}")
    if grid is None or np.linalg.norm(b - a) < 1e-9:
        if grid is not None:
            _ends(grid, a, b, radius)  # raises where the robot cannot stand
        return (Route("A", np.array([a, b]), float(np.linalg.norm(b - a)), ()),)
    road, first, last = _ends(grid, a, b, radius)
    head, tail = road.to_lattice(a)[None], _tail(road, road.to_lattice(b), last)
    classes: dict[bytes, Array] = {}
    lengths: list[float] = []
    for looked, nodes in enumerate(_candidates(road, first, last)):
        if lengths and perf_counter() >= until:
            break
        steps = road.place(nodes)
        bound = DETOUR * _length(steps)
        if looked >= count * MOST_CANDIDATES or (
            len(lengths) >= count and bound > sorted(lengths)[count - 1]
        ):
            break
        key = road.signature(np.vstack([head, steps, tail])).tobytes()
        if key not in classes:
            classes[key] = taut(road, steps)
            lengths.append(_length(classes[key]))
    order = sorted(classes.values(), key=_length)[:count]
    pulled = [np.vstack([head, path, tail]) for path in order]
    return _ranked(road, smooth(road, pulled, until), a)


def shortest_path(grid: OccupancyGrid, start: Any, goal: Any, radius: float) -> tuple[Array, float]:
    """The shortest path over free cells (`Roadmap.free`), straight and diagonal steps with their
    Euclidean length; a diagonal step needs both cells beside it.

    Returns:
        Cell centres from the start's to the goal's, shape (N, 2) [m], and the length [m].

    Raises:
        NoRoute, ValueError: as `find_routes`.
    """
    a, b = _point(start, "start"), _point(goal, "goal")
    _size(radius)
    road, first, last = _ends(grid, a, b, radius)
    length, before = reach(road, last)
    return road.to_map(road.place(trace(before, first))), float(length[first]) * road.cell


def _point(value: Any, name: str) -> Array:
    point = np.asarray(value, dtype=float)
    if point.shape != (2,) or not np.all(np.isfinite(point)):
        raise ValueError(f"{name} must be two finite numbers, got {value!r}")
    return point


def _size(radius: float) -> None:
    if not (math.isfinite(radius) and radius >= 0):
        raise ValueError(f"radius must be finite and not negative, got {radius}")


def _ends(grid: OccupancyGrid, a: Array, b: Array, radius: float) -> tuple[Roadmap, int, int]:
    """The roadmap and the free nodes that stand for start and goal, with a way between them."""
    for name, point in (("start", a), ("goal", b)):
        place = f"{name} ({point[0]:g}, {point[1]:g})"
        if not grid.contains(point):
            low_x, low_y, high_x, high_y = grid.bounds
            raise NoRoute(
                f"{name.upper()}_OUTSIDE_MAP",
                f"{place} is outside the map, which spans x {low_x:g} to {high_x:g} and "
                f"y {low_y:g} to {high_y:g}; move it or give a larger map",
            )
        if grid.is_occupied(point):
            raise NoRoute(
                f"{name.upper()}_OCCUPIED", f"{place} is in an obstacle; move it to a free place"
            )
    road = roadmap(grid, radius)
    first = road.nearest_free(road.to_lattice(a), (START_TOLERANCE + radius) / road.cell)
    if first is None:
        raise NoRoute(
            "NO_VALID_PATH",
            f"no place with room for a radius of {radius:g} m is in sight of start "
            f"({a[0]:g}, {a[1]:g}); move it or give a smaller radius",
        )
    last = road.nearest_free(road.to_lattice(b), GOAL_TOLERANCE / road.cell + 1)
    if last is None:
        raise NoRoute(
            "NO_VALID_PATH",
            f"no place with room for a radius of {radius:g} m is within {GOAL_TOLERANCE:g} m of "
            f"goal ({b[0]:g}, {b[1]:g}); move it or give a smaller radius",
        )
    if not np.isfinite(reach(road, last)[0][first]):
        raise NoRoute(
            "NO_VALID_PATH",
            f"nothing leads from start ({a[0]:g}, {a[1]:g}) to goal ({b[0]:g}, {b[1]:g}) for a "
            f"radius of {radius:g} m; move one of them or give a smaller radius",
        )
    return road, first, last


def _tail(road: Roadmap, goal: Array, last: int) -> Array:
    """The goal as the route's end, shape (1, 2), or nothing, shape (0, 2), where the route ends at
    the last node because the robot does not fit at the goal."""
    fits = road.clearance([np.array([road.place(last), goal])])[0][0] >= road.rho
    return goal[None] if fits else np.zeros((0, 2))


def _ranked(road: Roadmap, paths: list[Array], start: Array) -> tuple[Route, ...]:
    """Routes by length, labelled, with the winding relative to the first."""
    paths = sorted(paths, key=_length)
    crossed = [road.signature(path) for path in paths]
    routes = []
    for number, (path, crossing) in enumerate(zip(paths, crossed, strict=True)):
        vertices = road.to_map(path)
        vertices[0] = start
        winding = tuple((crossing - crossed[0]).tolist())
        routes.append(Route(label(number), vertices, _length(vertices), winding))
    return tuple(routes)


def label(number: int) -> str:
    """A, B, ..., Z, AA, AB, ..."""
    letters = ""
    number += 1
    while number:
        number, digit = divmod(number - 1, 26)
        letters = chr(ord("A") + digit) + letters
    return letters


def _length(path: Array) -> float:
    step = np.diff(path, axis=0)
    return float(np.hypot(step[:, 0], step[:, 1]).sum())


# Candidates


def _candidates(road: Roadmap, first: int, last: int) -> Iterator[Nodes]:
    """Paths as nodes from `first` to `last`: the shortest one, then simple ones along the
    skeleton by their length on it."""
    to_goal, before_goal = reach(road, last)
    yield trace(before_goal, first)
    chains = [chain for chain in road.skeleton if np.isfinite(to_goal[chain[0]])]
    if not chains:
        return
    bones = np.concatenate(chains)
    q = int(bones[np.argmin(to_goal[bones])])
    on = trace(road.to_skeleton, first)
    p = int(on[-1])
    off = trace(before_goal, q)
    for part in _simple_paths(_edges(road, chains, p, q), p, q):
        yield np.concatenate([on, *part, off])


Edge = tuple[int, int, float, Nodes]


def _edges(road: Roadmap, chains: list[Nodes], p: int, q: int) -> list[Edge]:
    """The skeleton as a graph in which p and q are vertices: end, end, length, nodes."""
    edges = []
    for chain in chains:
        cuts = {0, len(chain) - 1, *np.flatnonzero((chain == p) | (chain == q)).tolist()}
        for low, high in pairwise(sorted(cuts)):
            part = chain[low : high + 1]
            edges.append((int(part[0]), int(part[-1]), _length(road.place(part)), part))
    return edges


def _simple_paths(edges: list[Edge], p: int, q: int) -> Iterator[list[Nodes]]:
    """Simple paths from p to q by length, each as the nodes of its edges.

    Best first, with the distance to q as the bound of what is still to come.
    """
    near = _useful(edges, p, q)
    ahead = _distances(near, q)
    if p not in ahead or p == q:
        return
    tie = counter()
    queue: list[Any] = [(ahead[p], next(tie), 0.0, p, frozenset([p]), None)]
    for _ in range(MOST_EXPANSIONS):
        if not queue:
            return
        _, _, done, node, visited, way = heapq.heappop(queue)
        if node == q:
            yield _unwind(way)
            continue
        for other, length, nodes in near[node]:
            if other not in visited:
                total = done + length
                entry = (total + ahead[other], next(tie), total, other)
                heapq.heappush(queue, (*entry, visited | {other}, (way, nodes)))


def _unwind(way: Any) -> list[Nodes]:
    parts = []
    while way is not None:
        way, nodes = way
        parts.append(nodes)
    return parts[::-1]


def _useful(edges: list[Edge], p: int, q: int) -> dict[int, list[tuple[int, float, Nodes]]]:
    """Neighbours by edges that lie on a simple path from p to q: those that share a biconnected
    component with an edge from p to q."""
    import networkx as nx

    graph = nx.Graph((a, b) for a, b, _, _ in edges)
    graph.add_edge(p, q)
    useful: set[int] = set()
    for component in nx.biconnected_components(graph):
        if p in component and q in component:
            useful = component
    near = defaultdict(list)
    for a, b, length, nodes in edges:
        if a != b and a in useful and b in useful:
            near[a].append((b, length, nodes))
            near[b].append((a, length, nodes[::-1]))
    return near


def _distances(near: dict[int, list[tuple[int, float, Nodes]]], q: int) -> dict[int, float]:
    """Length of the shortest way from each vertex to q (Dijkstra)."""
    done: dict[int, float] = {}
    queue = [(0.0, q)]
    while queue:
        length, node = heapq.heappop(queue)
        if node not in done:
            done[node] = length
            for other, step, _ in near[node]:
                if other not in done:
                    heapq.heappush(queue, (length + step, other))
    return done
