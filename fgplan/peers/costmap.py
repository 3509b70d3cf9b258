"""ROS costmaps: obstacles and people as cells, inflated; distances and paths along the cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgplan.occupancy import OCCUPIED, OccupancyGrid

Array = NDArray[np.float64]
Cells = NDArray[np.intp]

UNKNOWN = 255
LETHAL = 254
"""An obstacle is in the cell."""
INSCRIBED = 253
"""The centre of the robot in this cell means contact, however it is turned."""
FREE = 0

NEUTRAL = 50.0
"""Cost of a free cell to the global planner, as in navfn."""
FACTOR = 0.8
"""Of a cell's value, on top of it, as in navfn."""


@dataclass(frozen=True)
class Inflation:
    """How obstacles spread: 252·exp(−scaling·(d − inscribed)) at a distance d.

    Args:
        inscribed: Radius of the robot's disc [m].
        radius: Beyond this distance a cell is free [m].
        scaling: k [1/m].

    Reference:
        costmap_2d of the ROS navigation stack.
    """

    inscribed: float
    radius: float = 0.75
    scaling: float = 5.0

    def cost(self, distance: Array) -> NDArray[np.uint8]:
        """Values of cells at a distance from the nearest lethal cell [m]."""
        decay = np.exp(-self.scaling * np.maximum(distance - self.inscribed, 0.0))
        values = np.where(distance <= self.radius, np.floor((INSCRIBED - 1) * decay), FREE)
        values = np.where(distance <= self.inscribed, INSCRIBED, values)
        return np.where(distance <= 0, LETHAL, values).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Costmap:
    """Values of the cells of a grid.

    Args:
        grid: Where the cells are.
        values: Shape (rows, cols): 255 unknown, 254 lethal, 253 inscribed, ... 0 free.
    """

    grid: OccupancyGrid
    values: NDArray[np.uint8]

    @classmethod
    def build(
        cls,
        grid: OccupancyGrid,
        inflation: Inflation,
        people: Any = (),
        person_radius: float = 0.3,
    ) -> Costmap:
        """Obstacles of the map and discs of people, inflated.

        Args:
            grid: The map.
            inflation: How obstacles spread.
            people: Positions of people now, shape (n, 2) [m]: a snapshot, as a laser sees it.
            person_radius: [m].
        """
        from scipy.ndimage import distance_transform_edt

        lethal = grid.data >= OCCUPIED
        for person in np.asarray(people, dtype=float).reshape(-1, 2):
            _stamp(grid, lethal, person, person_radius)
        if lethal.any():
            values = inflation.cost(grid.resolution * distance_transform_edt(~lethal))
        else:
            values = np.zeros(lethal.shape, dtype=np.uint8)
        if not grid.unknown_is_free:
            values[(grid.data < 0) & (values < INSCRIBED)] = UNKNOWN
        return cls(grid, values)

    def at(self, points: Any) -> NDArray[np.int64]:
        """Values at points (..., 2), shape (...); unknown outside the map."""
        return look_up(self.grid, self.values, points, UNKNOWN).astype(np.int64)

    @property
    def blocked(self) -> NDArray[np.bool_]:
        """Cells where the robot's centre must not be."""
        return np.asarray(self.values >= INSCRIBED)

    def steps_to(self, targets: Cells) -> Array:
        """Cells to walk (four neighbours, round what is blocked) to the nearest of the target
        cells (N, 2), shape (rows, cols); inf where no walk leads, as in base_local_planner's
        MapGrid."""
        from skimage.graph import MCP

        ground = np.where(self.blocked, np.inf, 1.0)
        free = targets[~self.blocked[targets[:, 0], targets[:, 1]]]
        if not len(free):
            return np.full(ground.shape, np.inf)
        reached, _ = MCP(ground, fully_connected=False).find_costs(
            [tuple(t) for t in free.tolist()]
        )
        return np.asarray(reached - 1.0)  # MCP counts the first cell, too


def look_up(grid: OccupancyGrid, table: NDArray[Any], points: Any, outside: float) -> NDArray[Any]:
    """Values of a table (rows, cols) over the cells of a grid, at points (..., 2)."""
    cells = grid.world_to_cell(points)
    inside = np.clip(cells, 0, np.array(table.shape) - 1)
    within = np.all(inside == cells, axis=-1)
    return np.where(within, table[inside[..., 0], inside[..., 1]], outside)


def window(grid: OccupancyGrid, centre: Any, side: float) -> OccupancyGrid:
    """The part of a map within a square (in the map's own axes) round a point."""
    half = int(np.ceil(0.5 * side / grid.resolution))
    low = np.maximum(grid.world_to_cell(centre) - half, 0)
    high = np.minimum(grid.world_to_cell(centre) + half + 1, grid.data.shape)
    high = np.maximum(high, np.minimum(low, np.array(grid.data.shape) - 1) + 1)
    low = np.minimum(low, high - 1)
    corner = grid.cell_to_world(low - 0.5)
    origin = np.array([*corner, grid.origin[2]])
    data = grid.data[low[0] : high[0], low[1] : high[1]]
    return OccupancyGrid(data, grid.resolution, origin, grid.unknown_is_free)


def shortest_path(costmap: Costmap, start: Any, goal: Any) -> Array | None:
    """Dijkstra over cells (eight neighbours), each at navfn's price 50 + 0.8·value.

    The robot's own cell is free whatever is in it, as navfn clears it.

    Returns:
        Cell centres from start to goal, shape (N, 2) [m]; None when no path leads there.
    """
    from skimage.graph import MCP_Geometric

    grid = costmap.grid
    ends = [tuple(grid.world_to_cell(point).tolist()) for point in (start, goal)]
    if not all(grid.contains(np.asarray(point, dtype=float)) for point in (start, goal)):
        return None
    price = NEUTRAL + FACTOR * costmap.values.astype(float)
    price[costmap.blocked] = np.inf
    price[ends[0]] = NEUTRAL
    finder = MCP_Geometric(price)
    reached, _ = finder.find_costs([ends[0]], [ends[1]])
    if not np.isfinite(reached[ends[1]]):
        return None
    return grid.cell_to_world(np.array(finder.traceback(ends[1])))


def _stamp(grid: OccupancyGrid, lethal: NDArray[np.bool_], centre: Array, radius: float) -> None:
    """Mark the cells whose centre is in a disc, and the one that holds its centre."""
    reach = int(np.ceil(radius / grid.resolution)) + 1
    row, col = grid.world_to_cell(centre).tolist()
    rows = np.arange(max(row - reach, 0), min(row + reach + 1, lethal.shape[0]))
    cols = np.arange(max(col - reach, 0), min(col + reach + 1, lethal.shape[1]))
    if not (len(rows) and len(cols)):
        return
    cells = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1)
    near = np.linalg.norm(grid.cell_to_world(cells) - centre, axis=-1) <= radius
    lethal[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1] |= near
    if 0 <= row < lethal.shape[0] and 0 <= col < lethal.shape[1]:
        lethal[row, col] = True
