"""Occupancy grids: from arrays, polygons and ROS map files, and the distances they hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from factors.distance_field import SignedDistanceField
from fgplan.errors import MapError

Array = NDArray[np.float64]

OCCUPIED = 65
"""A cell is an obstacle from this value on: 100 × map_server's default occupied_thresh of 0.65."""

NO_OBSTACLE = 1e3
"""Distance [m] everywhere in a map without obstacles (negative in a map without free cells)."""


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """A map of square cells in the ROS convention.

    Args:
        data: −1 unknown, 0 free ... 100 occupied, shape (rows, cols), row 0 at the lowest y (of
            the map's own frame, before yaw). A value of `OCCUPIED` or more is an obstacle.
        resolution: Side of a cell [m].
        origin: (x, y, yaw) of the lower left corner of cell (0, 0), shape (3,) [m, m, rad].
        unknown_is_free: Whether a cell of −1 may be driven through (Nav2's `allow_unknown`).

    Raises:
        MapError: a field has the wrong shape, or a value that makes no sense.
    """

    data: NDArray[np.int8]
    resolution: float
    origin: Array
    unknown_is_free: bool = True

    def __post_init__(self) -> None:
        data = np.asarray(self.data)
        if data.ndim != 2 or data.size == 0:
            raise MapError(f"data: got shape {data.shape}; give at least one row and column")
        whole = np.issubdtype(data.dtype, np.integer)
        if not whole or data.min() < -1 or data.max() > 100:
            raise MapError(
                f"data: got {data.dtype} from {data.min()} to {data.max()}; "
                "give whole numbers, -1 for unknown and 0 to 100 for occupancy"
            )
        resolution = _number(self.resolution, "resolution")
        if resolution <= 0:
            raise MapError(f"resolution: got {resolution}; give the side of a cell in metres, > 0")
        origin = _origin(self.origin, "origin")
        object.__setattr__(self, "data", np.ascontiguousarray(data, dtype=np.int8))
        object.__setattr__(self, "resolution", resolution)
        object.__setattr__(self, "origin", origin)

    @classmethod
    def load(cls, path: str | Path, unknown_is_free: bool = True) -> Self:
        """Read a map of ROS map_server or Nav2 (a YAML file and its image).

        Raises:
            MapError: a file is missing or cannot be read, or a field is missing or wrong.
        """
        from fgplan.map_file import read

        data, resolution, origin = read(Path(path))
        try:
            return cls(data, resolution, origin, unknown_is_free)
        except MapError as error:
            raise MapError(f"{path}: {error}") from error

    def save(self, path: str | Path) -> None:
        """Write the YAML file and, beside it, a PGM image of the same name; `load` gives back the
        same data."""
        from fgplan.map_file import write

        write(Path(path), self.data, self.resolution, self.origin)

    @classmethod
    def from_array(cls, occupied: Any, resolution: float, origin: Any = (0.0, 0.0, 0.0)) -> Self:
        """From booleans, shape (rows, cols), row 0 at the lowest y; origin may leave out the yaw.

        Raises:
            MapError: as the class.
        """
        cells = np.asarray(occupied)
        if cells.dtype != np.bool_:
            raise MapError(
                f"occupied: got {cells.dtype}; give booleans, or use OccupancyGrid(data, ...) for "
                "values from -1 to 100"
            )
        place = np.asarray(origin, dtype=float)
        if place.shape == (2,):
            place = np.append(place, 0.0)
        return cls(np.where(cells, 100, 0).astype(np.int8), resolution, place)

    @classmethod
    def from_polygons(
        cls,
        polygons: Sequence[Any],
        bounds: tuple[float, float, float, float],
        resolution: float,
        border: bool = False,
    ) -> Self:
        """From obstacles given by their vertices.

        A cell that a polygon touches is occupied: the map never shows less than there is.

        Args:
            polygons: One array (N, 2) of vertices an obstacle, N ≥ 3 [m]; closed by itself.
            bounds: (x_min, y_min, x_max, y_max) of the map [m]; rounded up to whole cells.
            resolution: Side of a cell [m].
            border: Whether the outermost ring of cells is a wall.

        Raises:
            MapError: a polygon or the bounds make no sense; or as the class.
        """
        box = np.asarray(bounds, dtype=float)
        if box.shape != (4,) or not np.all(np.isfinite(box)) or np.any(box[2:] <= box[:2]):
            raise MapError(f"bounds: got {bounds}; give x_min, y_min, x_max, y_max with min < max")
        if not _number(resolution, "resolution") > 0:
            raise MapError(f"resolution: got {resolution}; give the side of a cell in metres, > 0")
        # 1e-9: 10 m / 0.1 m is 100 cells and not, by rounding, 101.
        cols, rows = np.ceil((box[2:] - box[:2]) / resolution - 1e-9).astype(int)
        occupied = np.zeros((rows, cols), dtype=bool)
        for number, polygon in enumerate(polygons):
            vertices = np.asarray(polygon, dtype=float)
            if vertices.ndim != 2 or vertices.shape[1] != 2 or len(vertices) < 3:
                raise MapError(
                    f"polygons[{number}]: got shape {vertices.shape}; give 3 or more points (x, y)"
                )
            cells = (vertices - box[:2]) / resolution
            if not np.all(np.abs(cells) < 2.0**52):  # false for NaN as well
                raise MapError(f"polygons[{number}]: got {vertices.tolist()}; give finite numbers")
            _rasterise(cells, occupied)
        if border:
            occupied[[0, -1], :] = True
            occupied[:, [0, -1]] = True
        return cls.from_array(occupied, resolution, (box[0], box[1], 0.0))

    @cached_property
    def occupied(self) -> NDArray[np.bool_]:
        """Which cells are obstacles, shape (rows, cols)."""
        occupied = self.data >= OCCUPIED
        return occupied if self.unknown_is_free else occupied | (self.data < 0)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(x_min, y_min, x_max, y_max) of the map in the map frame [m]."""
        rows, cols = self.data.shape
        corners = np.array([[0, 0], [cols, 0], [cols, rows], [0, rows]], dtype=float) - 0.5
        points = self.cell_to_world(corners[:, ::-1])
        low, high = points.min(axis=0), points.max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    @cached_property
    def distance_field(self) -> SignedDistanceField:
        """Signed distance to the edge of the nearest obstacle cell.

        At a cell centre it is the distance to the nearest obstacle centre less half a cell (and
        the mirror image inside), so that it is 0 on the edges of walls and rises with slope 1
        through them. Off the corner of an obstacle that overestimates, by at most
        (√2 − 1)/2 = 0.21 cells. What is outside the map counts as free; see `Outside` for the
        distance there.
        """
        from scipy.ndimage import distance_transform_edt

        occupied = self.occupied
        if not occupied.any():
            values: Array = np.full(occupied.shape, NO_OBSTACLE)
        elif occupied.all():
            values = np.full(occupied.shape, -NO_OBSTACLE)
        else:
            apart = distance_transform_edt(~occupied) - distance_transform_edt(occupied)
            values = self.resolution * (apart - 0.5 * np.sign(apart))
        # A field needs two nodes a side; a second one like the first says nothing new.
        rows, cols = values.shape
        values = np.tile(values, (1 + (rows == 1), 1 + (cols == 1)))
        centre = self.cell_to_world(np.zeros(2))
        return SignedDistanceField(values, centre, self.resolution, float(self.origin[2]))

    @cached_property
    def centres(self) -> Array:
        """Centres of all cells, shape (rows, cols, 2) [m]."""
        rows, cols = np.indices(self.data.shape)
        return self.cell_to_world(np.stack([rows, cols], axis=-1))

    def with_obstacles(self, cells: Any) -> OccupancyGrid:
        """The map with some cells occupied beside those that are, shape (rows, cols)."""
        data = np.where(cells, 100, self.data).astype(np.int8)
        return OccupancyGrid(data, self.resolution, self.origin, self.unknown_is_free)

    def cell_to_world(self, cells: Any) -> Array:
        """Centres of the cells (row, column), shape (..., 2) -> (..., 2) [m]."""
        rc = np.asarray(cells, dtype=float) + 0.5
        return self.origin[:2] + self.resolution * rc[..., ::-1] @ self._rotation.T

    def world_to_cell(self, points: Any) -> NDArray[np.intp]:
        """Cells (row, column) that hold the points, shape (..., 2); may lie outside the map.

        Raises:
            ValueError: a point is not finite.
        """
        x = np.asarray(points, dtype=float)
        if not np.all(np.isfinite(x)):
            raise ValueError(f"points must be finite, got {x.tolist()}")
        local = (x - self.origin[:2]) @ self._rotation / self.resolution
        return np.floor(local[..., ::-1]).astype(np.intp)

    def contains(self, points: Any) -> NDArray[np.bool_]:
        """Whether points (..., 2) lie in the map, shape (...)."""
        cells = self.world_to_cell(points)
        return np.asarray(np.all((cells >= 0) & (cells < self.data.shape), axis=-1))

    def is_occupied(self, points: Any) -> NDArray[np.bool_]:
        """Whether points (..., 2) lie in an obstacle cell, shape (...); not outside the map."""
        cells = self.world_to_cell(points)
        inside = np.clip(cells, 0, np.array(self.data.shape) - 1)
        hit = self.occupied[inside[..., 0], inside[..., 1]]
        return np.asarray(hit & np.all(inside == cells, axis=-1))

    def clearance(self, points: Any, radius: float) -> Array:
        """Gap between a disc at points (..., 2) and the nearest obstacle, shape (...) [m]."""
        return self.distance_field.distance(points) - radius

    def line_of_sight(self, a: Any, b: Any) -> NDArray[np.bool_]:
        """Whether b (..., 2) is seen from a (2,), shape (...).

        Sight ends at an obstacle cell; the segments are sampled every half cell. The cells that
        hold a and b themselves do not hide anything.
        """
        start, ends = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
        if ends.size == 0:
            return np.ones(ends.shape[:-1], dtype=bool)
        farthest = float(np.max(np.linalg.norm(ends - start, axis=-1)))
        count = int(np.ceil(farthest / (0.5 * self.resolution))) + 1
        t = np.linspace(0.0, 1.0, count)[:, None]
        points = start + t * (ends - start)[..., None, :]
        own = (self.world_to_cell(points) == self.world_to_cell(start)).all(axis=-1)
        own |= (self.world_to_cell(points) == self.world_to_cell(ends)[..., None, :]).all(axis=-1)
        return np.asarray(~np.any(self.is_occupied(points) & ~own, axis=-1))

    @cached_property
    def _rotation(self) -> Array:
        c, s = np.cos(self.origin[2]), np.sin(self.origin[2])
        return np.array([[c, -s], [s, c]])


def _number(value: Any, name: str) -> float:
    """A finite number, or a MapError that names it."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = np.nan
    if not np.isfinite(number) or isinstance(value, bool | str):
        raise MapError(f"{name}: got {value!r}; give a finite number")
    return number


def _origin(value: Any, name: str) -> Array:
    try:
        origin = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        origin = np.zeros(0)
    if origin.shape != (3,) or not np.all(np.isfinite(origin)):
        raise MapError(f"{name}: got {value!r}; give three finite numbers x, y, yaw")
    return origin


def _rasterise(vertices: Array, occupied: NDArray[np.bool_]) -> None:
    """Mark every cell that a polygon touches; vertices (N, 2) as (column, row) of cell corners."""
    rows, cols = occupied.shape
    ends = np.roll(vertices, -1, axis=0)
    # Cells crossed by an edge: an edge meets a closed square when their boxes overlap and the
    # square's corners are not all on one side of the edge's line (separating axes).
    for a, b in zip(vertices, ends, strict=True):
        low = np.floor(np.minimum(a, b) - 1e-9).astype(int)
        high = np.floor(np.maximum(a, b) + 1e-9).astype(int) + 1
        c0, r0 = np.clip(low, 0, [cols, rows])
        c1, r1 = np.clip(high, 0, [cols, rows])
        c, r = np.meshgrid(np.arange(c0, c1) + 0.5, np.arange(r0, r1) + 0.5)
        nx, ny = b[1] - a[1], a[0] - b[0]
        apart = np.abs(nx * (c - a[0]) + ny * (r - a[1]))
        occupied[r0:r1, c0:c1] |= apart <= 0.5 * (abs(nx) + abs(ny)) + 1e-9
    # Cells whose centre is inside: the outline winds around it, however often.
    y = np.arange(rows) + 0.5
    x = np.arange(cols) + 0.5
    winding = np.zeros(occupied.shape, dtype=np.intp)
    for a, b in zip(vertices, ends, strict=True):
        crossed = (a[1] > y) != (b[1] > y)
        at = a[0] + (y[crossed] - a[1]) * (b[0] - a[0]) / (b[1] - a[1])
        winding[crossed] += np.where(x > at[:, None], np.sign(b[1] - a[1]).astype(int), 0)
    occupied |= winding != 0
