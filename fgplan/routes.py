"""K distinct global paths: pairwise non-homotopic, clear of obstacles, the shortest first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from fgplan.occupancy import OccupancyGrid

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Route:
    """A global path and its homotopy class.

    Args:
        label: "A" for the shortest route, then "B", ...
        path: Vertices, shape (N, 2) [m].
        length: [m].
        signature: Winding number about each obstacle, relative to the shortest route.
    """

    label: str
    path: Array
    length: float
    signature: tuple[int, ...]


def find_routes(
    grid: OccupancyGrid | None, start: Any, goal: Any, radius: float, count: int
) -> tuple[Route, ...]:
    """Interim: the straight line."""
    path = np.array([start, goal], dtype=float)
    return (Route("A", path, float(np.linalg.norm(path[1] - path[0])), ()),)
