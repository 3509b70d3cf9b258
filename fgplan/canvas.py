"""What all pictures share: colours, the map, and the regions on it."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.transforms import Affine2D

from fgplan.occupancy import OCCUPIED, OccupancyGrid
from fgplan.regions import Region

Box = tuple[float, float, float, float]
"""(x_min, y_min, x_max, y_max) [m]."""

# Okabe and Ito's colours and two of Tol's: a colour-blind reader can tell them apart.
ROBOT = "#0072b2"
PERSON = "#d55e00"
GOAL = "#f0e442"
HYPOTHESES = ("#56b4e9", "#009e73", "#cc79a7", "#e69f00", "#999999", "#332288", "#882255")
REGION = "#7a4b94"
GROUND = ("#f4f4f4", "#cfcfcf", "#5a5a5a")
"""Free, unknown, obstacle."""

FINE = 300
"""Points across the picture at which a region is looked at."""
EDGE = 0.06
"""Share of the picture at its edges where no name of a region begins."""


def draw_grid(axes: Axes, grid: OccupancyGrid, alpha: float = 1.0) -> None:
    """The map, where it is and turned as it is."""
    rows, cols = grid.data.shape
    kinds = np.where(grid.data >= OCCUPIED, 2, np.where(grid.data < 0, 1, 0))
    x, y, yaw = grid.origin.tolist()
    image = axes.imshow(
        kinds, cmap=ListedColormap(GROUND), vmin=0, vmax=2, origin="lower", alpha=alpha,
        extent=(0, cols, 0, rows), interpolation="nearest", zorder=0,
    )  # fmt: skip
    place = Affine2D().scale(grid.resolution).rotate(yaw).translate(x, y)
    image.set_transform(place + axes.transData)


def draw_region(axes: Axes, region: Region, box: Box) -> None:
    """Its outline, and its name in the middle of what is seen of it."""
    x, y = np.linspace(box[0], box[2], FINE), np.linspace(box[1], box[3], FINE)
    distance = region.shape.distance(np.stack(np.meshgrid(x, y), axis=-1))
    if distance.min() > 0:  # not in the picture
        return
    axes.contour(x, y, distance, [0.0], colors=REGION, linestyles="dashed", linewidths=1.0)
    axes.contourf(x, y, distance, [-np.inf, 0.0], colors=[REGION], alpha=0.08, zorder=0.5)
    edge = round(EDGE * FINE)
    inner = np.full_like(distance, np.inf)
    inner[edge:-edge, edge:-edge] = distance[edge:-edge, edge:-edge]
    if inner.min() > 0:  # a sliver at the edge
        return
    deepest = np.argwhere(inner <= 0.95 * inner.min())
    row, column = deepest[np.linalg.norm(deepest - deepest.mean(axis=0), axis=1).argmin()]
    axes.text(
        float(x[column]), float(y[row]), region.name, fontsize=8, color=REGION, ha="center",
        va="center", parse_math=False, clip_on=True, zorder=1,
    )  # fmt: skip
