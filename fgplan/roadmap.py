"""What global paths need to know of a map and a radius: where the robot's centre may be, how far
obstacles are, the lattice and the skeleton of the free space. Built once, asked at every replan.

Everything here is in lattice coordinates: points (column, row) in units of a cell, cell centres at
whole numbers.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from factors.distance_field import SignedDistanceField

if TYPE_CHECKING:
    from fgplan.occupancy import OccupancyGrid

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Nodes = NDArray[np.intp]

SPACING = 0.25
"""Of the samples of a segment [cells]."""

BESIDE = 0.5 - 1e-6
"""A point this near to a node [cells] is in the square of its cell, and of no other."""

COMFORT = 0.2
"""Clearance [m] beyond the radius that routes take where there is room for it."""


@dataclass(frozen=True, eq=False)
class Roadmap:
    """The free space of a disc's centre.

    A cell is free when its centre is far enough from every obstacle square that all straight
    steps between neighbouring free cells (diagonal ones only where both cells beside them are
    free) keep the radius: not only at the centres. That asks for √(rho² + ½) cells instead of
    rho, 2.5 mm for a radius of 0.25 m and cells of 0.05 m. A lane is found when it holds a free
    cell centre, so at worst half a cell of its width is not used.

    Args:
        occupied: Obstacle cells, shape (rows, cols).
        cell: Side of a cell [m].
        corner: Lower left corner of cell (0, 0) in the map frame, shape (2,) [m].
        rotation: From the grid's axes to the map frame, shape (2, 2).
        rho: The robot's radius [cells].
    """

    occupied: Mask
    cell: float
    corner: Array
    rotation: Array
    rho: float

    @classmethod
    def build(cls, grid: OccupancyGrid, radius: float) -> Self:
        """Cells wider than half the radius are first divided by 3, or 5: a lattice cannot resolve
        a lane for a robot no larger than its cells. (Odd, so that a lane has a middle.)"""
        coarse = np.inf if radius <= 0 else 2 * grid.resolution / radius
        divide = 1 if coarse <= 1 else 3 if coarse <= 3 else 5
        occupied = np.kron(grid.occupied, np.ones((divide, divide), dtype=bool))
        cell = grid.resolution / divide
        c, s = np.cos(grid.origin[2]), np.sin(grid.origin[2])
        return cls(occupied, cell, grid.origin[:2], np.array([[c, -s], [s, c]]), radius / cell)

    # Places

    def to_lattice(self, points: Any) -> Array:
        """Map frame [m] to lattice coordinates, shape (..., 2)."""
        return (np.asarray(points, dtype=float) - self.corner) @ self.rotation / self.cell - 0.5

    def to_map(self, points: Any) -> Array:
        """Lattice coordinates to the map frame [m], shape (..., 2)."""
        return self.corner + self.cell * (np.asarray(points, dtype=float) + 0.5) @ self.rotation.T

    def place(self, nodes: Any) -> Array:
        """Lattice coordinates (..., 2) of nodes, numbered along rows."""
        rows, cols = np.divmod(np.asarray(nodes), self.occupied.shape[1])
        return np.stack([cols, rows], axis=-1).astype(float)

    # Clearance

    @cached_property
    def required(self) -> float:
        """Distance [cells] that a free cell's centre keeps from obstacle squares."""
        return float(np.sqrt(self.rho**2 + 0.5 + SPACING**2 / 4))

    @cached_property
    def field(self) -> SignedDistanceField:
        """Exact distance [cells] of cell centres to obstacle squares, capped where nobody asks."""
        reach = int(np.ceil(self.required + COMFORT / self.cell)) + 2
        values = square_distance(self.occupied, reach)
        rows, cols = values.shape
        values = np.tile(values, (1 + (rows == 1), 1 + (cols == 1)))
        return SignedDistanceField(values, np.zeros(2), 1.0)

    @cached_property
    def free(self) -> Mask:
        """Cells whose centre the robot's centre may be at, shape (rows, cols)."""
        rows, cols = self.occupied.shape
        return np.asarray(self.field.values[:rows, :cols] >= self.required - 1e-9)

    def clearance(self, paths: Iterable[Array]) -> list[Array]:
        """Lower bound of the distance [cells] between each segment of the paths (N, 2) and every
        obstacle square, shape (N − 1,) each.

        A bilinear value F of distances at four nodes bounds the distance D of the point (s, t)
        between them by D² ≥ F² − s(1 − s) − t(1 − t): D is convex in the place seen from the
        nearest obstacle point, and Jensen's inequality does the rest. Between samples δ apart
        another δ²/4 is lost in the same way.
        """
        paths = list(paths)
        starts = np.vstack([p[:-1] for p in paths])
        ends = np.vstack([p[1:] for p in paths])
        points, first = _samples(starts, ends, SPACING)
        part = points - np.floor(points)
        F = np.maximum(self.field.distance(points), 0.0)
        squared = F**2 - np.sum(part * (1 - part), axis=-1) - SPACING**2 / 4
        bound = np.sqrt(np.maximum(np.minimum.reduceat(squared, first), 0.0))
        return np.split(bound, np.cumsum([len(p) - 1 for p in paths])[:-1])

    def crosses_obstacle(self, start: Array, ends: Array) -> Mask:
        """Whether the segments from start (2,) to ends (n, 2) pass through an obstacle cell."""
        points, first = _samples(np.broadcast_to(start, ends.shape), ends, SPACING)
        col, row = np.rint(points).astype(np.intp).T
        rows, cols = self.occupied.shape
        hit = self.occupied[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)]
        return np.asarray(np.logical_or.reduceat(hit, first))

    def sees(self, start: Array, ends: Array) -> Mask:
        """Whether the segments from start (2,) to ends (n, 2) stay, as far as samples half a cell
        apart tell, between free cells on all sides: quick, and on the safe side in lanes one cell
        wide."""
        step = ends - start
        count = int(2 * np.max(np.hypot(step[:, 0], step[:, 1]))) + 2
        share = np.linspace(0.0, 1.0, count)
        # Truncation is rounding down: coordinates of free places are not negative.
        col = (start[0] + step[:, :1] * share).astype(np.int32)
        row = (start[1] + step[:, 1:] * share).astype(np.int32)
        return np.asarray(self._open.take(row * self.free.shape[1] + col).all(axis=1))

    def surely_sees(self, start: Array, ends: Array) -> Mask:
        """As `sees`, without the doubt that is left between two samples."""
        seen = self.sees(start, ends)
        for number in np.flatnonzero(seen):
            seen[number] = self.clearance([np.array([start, ends[number]])])[0][0] >= self.rho
        return seen

    @cached_property
    def _open(self) -> Mask:
        """Whether all four nodes around a lattice square are free, by its lower left node."""
        f = np.pad(self.free, ((0, 1), (0, 1)))
        return np.ravel(f[:-1, :-1] & f[1:, :-1] & f[:-1, 1:] & f[1:, 1:])

    # Classes

    @cached_property
    def obstacles(self) -> Array:
        """A point in each obstacle: a connected piece of the space that is not free and does not
        reach the rim of the map, shape (M, 2). A path's class is how it winds around them."""
        from scipy.ndimage import label

        blocked = np.pad(~self.free, 1, constant_values=True)
        labels, count = label(blocked, np.ones((3, 3)))
        places, first = np.unique(labels, return_index=True)
        inner = first[(places != 0) & (places != labels[0, 0])]
        rows, cols = np.divmod(inner, labels.shape[1])
        assert len(inner) == count - 1
        return np.stack([cols - 1, rows - 1], axis=-1).astype(float)

    def crossings(self, starts: Array, ends: Array) -> NDArray[np.intp]:
        """Signed crossings of segments (n, 2) with the ray from each obstacle towards +column,
        shape (n, M). Two paths with the same ends wind alike around an obstacle exactly when the
        sums over their segments agree."""
        o = self.obstacles
        above = ends[:, None, 1] > o[:, 1]
        below = starts[:, None, 1] > o[:, 1]
        sign = above.astype(np.intp) - below
        rise = ends[:, 1] - starts[:, 1]
        run = (ends[:, 0] - starts[:, 0]) / np.where(rise == 0, 1.0, rise)
        at = starts[:, None, 0] + (o[:, 1] - starts[:, None, 1]) * run[:, None]
        return np.where(at > o[:, 0], sign, 0)

    def signature(self, path: Array) -> NDArray[np.intp]:
        """Signed crossings of a path (N, 2), shape (M,)."""
        return np.asarray(self.crossings(path[:-1], path[1:]).sum(axis=0))

    # Lattice

    @cached_property
    def lattice(self) -> Any:
        """Steps between free cells, their length as weight [cells]: a symmetric sparse matrix."""
        from scipy.sparse import csr_matrix

        free = self.free
        node = np.arange(free.size, dtype=np.int32).reshape(free.shape)
        h, v = free[:, :-1] & free[:, 1:], free[:-1] & free[1:]
        d = h[:-1] & h[1:]
        a = [node[:, :-1][h], node[:-1][v], node[:-1, :-1][d], node[:-1, 1:][d]]
        b = [node[:, 1:][h], node[1:][v], node[1:, 1:][d], node[1:, :-1][d]]
        straight, slanted = len(a[0]) + len(a[1]), 2 * len(a[2])
        weight = np.repeat([1.0, np.sqrt(2.0)], [straight, slanted])
        tail, head = np.concatenate(a), np.concatenate(b)
        both = (np.concatenate([tail, head]), np.concatenate([head, tail]))
        return csr_matrix((np.tile(weight, 2), both), shape=(free.size, free.size))

    def nearest_free(self, point: Array, within: float) -> int | None:
        """The nearest free node that a straight line reaches without touching an obstacle cell,
        at most `within` cells away; None where there is none."""
        rows, cols = self.free.shape
        x, y = np.rint(point).astype(int).tolist()
        aside = np.abs(point - (x, y))
        here = aside.max() < BESIDE and np.hypot(*aside) <= within
        if here and 0 <= x < cols and 0 <= y < rows and self.free[y, x]:
            return int(y * cols + x)
        low = np.clip(np.floor(point - within).astype(int), 0, [cols, rows])
        high = np.clip(np.ceil(point + within).astype(int) + 1, 0, [cols, rows])
        row, col = np.nonzero(self.free[low[1] : high[1], low[0] : high[0]])
        found = np.stack([col, row], axis=-1) + low
        away = np.linalg.norm(found - point, axis=1)
        # Of nodes equally far the first: which one must not depend on rounding, or on the machine.
        order = np.argsort(np.round(away, 6), kind="stable")[: np.count_nonzero(away <= within)]
        for some in (order[k : k + 32] for k in range(0, len(order), 32)):
            visible = ~self.crosses_obstacle(point, found[some].astype(float))
            if visible.any():
                col, row = found[some[np.argmax(visible)]]
                return int(row * cols + col)
        return None

    def reach(self, node: int) -> tuple[Array, NDArray[np.int32]]:
        """Length of the shortest lattice path from a node to every node [cells], inf where there
        is none, and the node before each on it."""
        from scipy.sparse.csgraph import dijkstra

        length, before = dijkstra(self.lattice, indices=node, return_predecessors=True)
        return length, before

    # Skeleton

    @cached_property
    def skeleton(self) -> tuple[Nodes, ...]:
        """The skeleton of the free space as chains of neighbouring nodes between its junctions and
        ends. A simple path through it is a homotopy class of its own."""
        from skimage.morphology import skeletonize

        return _chains(skeletonize(self.free), self.free)

    @cached_property
    def to_skeleton(self) -> NDArray[np.int32]:
        """The node before each on the shortest lattice path to it from the skeleton, as of `reach`;
        below 0 on the skeleton, and where it does not lead."""
        from scipy.sparse.csgraph import dijkstra

        bones = np.unique(np.concatenate([np.zeros(0, np.intp), *self.skeleton]))
        _, before, _ = dijkstra(
            self.lattice, indices=bones, return_predecessors=True, min_only=True
        )
        return np.asarray(before)


@lru_cache(maxsize=4)
def roadmap(grid: OccupancyGrid, radius: float) -> Roadmap:
    """The roadmap of a grid, kept for the next question."""
    return Roadmap.build(grid, radius)


@lru_cache(maxsize=8)
def reach(road: Roadmap, node: int) -> tuple[Array, NDArray[np.int32]]:
    """`Roadmap.reach` from a goal, kept while the robot moves."""
    return road.reach(node)


def trace(before: NDArray[np.int32], node: int) -> Nodes:
    """Nodes from `node` back to where `before` starts."""
    nodes = [node]
    while (node := int(before[node])) >= 0:
        nodes.append(node)
    return np.array(nodes, dtype=np.intp)


def square_distance(occupied: Mask, reach: int) -> Array:
    """Distance of cell centres to the nearest occupied square (not centre) [cells], at most
    `reach`, shape of `occupied`. Exact."""
    rows, cols = occupied.shape
    row = np.arange(rows)[:, None]
    last = np.maximum.accumulate(np.where(occupied, row, -rows - reach), axis=0)
    following = np.minimum.accumulate(np.where(occupied, row, 2 * rows + reach)[::-1], axis=0)[::-1]
    gap = np.maximum(np.minimum(row - last, following - row) - 0.5, 0.0)
    column = np.minimum(gap, reach) ** 2
    squared = column.copy()
    for shift in range(1, min(reach, cols - 1) + 1):
        aside = (shift - 0.5) ** 2
        near = column + aside
        np.minimum(squared[:, shift:], near[:, :-shift], out=squared[:, shift:])
        np.minimum(squared[:, :-shift], near[:, shift:], out=squared[:, :-shift])
    return np.asarray(np.minimum(np.sqrt(squared), reach), dtype=float)


def _samples(starts: Array, ends: Array, spacing: float) -> tuple[Array, Nodes]:
    """Points on the segments, their ends included, at most `spacing` apart, one after the other;
    and the index of each segment's first."""
    step = ends - starts
    count = np.ceil(np.linalg.norm(step, axis=1) / spacing).astype(np.intp) + 1
    first = np.cumsum(count) - count
    which = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(which)) - first[which]) / np.maximum(count - 1, 1)[which]
    return starts[which] + share[:, None] * step[which], first


def _chains(skeleton: Mask, free: Mask) -> tuple[Nodes, ...]:
    """Chains of nodes between the junctions and ends of a skeleton.

    A diagonal step with an obstacle beside it becomes two straight ones around the other side;
    with obstacles on both sides the robot cannot take it, and it is left out.
    """
    near = _links(skeleton, free)
    ends = [node for node, others in near.items() if len(others) != 2]
    seen: set[tuple[int, int]] = set()
    chains = []
    loops = iter(near)
    while True:
        for end in ends:
            for other in near[end]:
                if (end, other) not in seen:
                    chain = _walk(near, end, other)
                    seen |= {(chain[0], chain[1]), (chain[-1], chain[-2])}
                    chains.append(np.array(chain, dtype=np.intp))
                    for node in chain[1:-1]:
                        near[node] = []
        # What is left are rings without a junction: any of their nodes may stand for one.
        start = next((node for node in loops if len(near[node]) == 2 and node not in ends), None)
        if start is None:
            return tuple(chains)
        ends = [start]


def _walk(near: dict[int, list[int]], start: int, node: int) -> list[int]:
    """Nodes from `start` by way of `node` to the next junction or end (or back to the start)."""
    chain = [start, node]
    while node != start and len(near[node]) == 2:
        a, b = near[node]
        node = b if a == chain[-2] else a
        chain.append(node)
    return chain


def _links(skeleton: Mask, free: Mask) -> dict[int, list[int]]:
    """Neighbours of each skeleton node."""
    cols = skeleton.shape[1]
    s, f = np.pad(skeleton, 1), np.pad(free, 1)
    row, col = np.nonzero(skeleton)
    own = row * cols + col
    r, c = row + 1, col + 1
    links = [(own[s[r, c + 1]], 1), (own[s[r + 1, c]], cols)]
    for side in (1, -1):
        # A diagonal says something new only where no straight steps join the two nodes.
        slanted = s[r + 1, c + side] & ~s[r, c + side] & ~s[r + 1, c]
        beside, above = f[r, c + side], f[r + 1, c]
        links.append((own[slanted & beside & above], cols + side))
        for taken, via in ((slanted & beside & ~above, side), (slanted & above & ~beside, cols)):
            links += [(own[taken], via), (own[taken] + via, cols + side - via)]
    near: dict[int, set[int]] = {node: set() for node in own.tolist()}
    for tails, step in links:
        for tail in tails.tolist():
            near.setdefault(tail, set()).add(tail + step)
            near.setdefault(tail + step, set()).add(tail)
    return {node: list(others) for node, others in near.items()}
