"""Walls for people: the occupied cells of a map as few rectangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fgplan.occupancy import OccupancyGrid

Array = NDArray[np.float64]


def rectangles(grid: OccupancyGrid | None) -> list[Array]:
    """Rectangles that cover the occupied cells, each cell once.

    Returns:
        Corners, counter-clockwise, each of shape (4, 2) [m].
    """
    if grid is None:
        return []
    left = grid.occupied.copy()
    found = []
    for row, col in np.argwhere(grid.occupied).tolist():
        if not left[row, col]:
            continue
        right = col
        while right < left.shape[1] and left[row, right]:
            right += 1
        top = row
        while top < left.shape[0] and left[top, col:right].all():
            top += 1
        left[row:top, col:right] = False
        # Corners are centres of cells, half a cell back.
        corners = np.array([[row, col], [row, right], [top, right], [top, col]]) - 0.5
        found.append(grid.cell_to_world(corners))
    return found
