"""Places that an operator names: waypoints and paths drawn by hand."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgplan.measuring import Reading
from fgplan.robots import Piece
from fgplan.timing import arc_length

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Waypoint:
    """A place to pass: z = η(t) + noise.

    Args:
        position: Shape (2,) [m], map frame.
        covariance: Shape (2, 2) [m²]; how near is near enough.
        time: When, on the clock of `Scenario.now` [s]. None: whenever the plan comes nearest,
            which each hypothesis answers for itself.
        on: Level that is measured; None for the first one.
        name: For reports.
    """

    position: Array
    covariance: Array
    time: float | None = None
    on: str | None = None
    name: str = "waypoint"

    @property
    def readings(self) -> tuple[Reading, ...]:
        """One position."""
        return (Reading(self.time, self.position, self.covariance),)

    def pieces(self, now: float, times: Array) -> Iterable[Piece]:
        """None."""
        return ()


@dataclass(frozen=True, eq=False)
class DrawnPath:
    """A path drawn by hand: places along it, each passed whenever the plan comes nearest, or at
    its own time.

    Args:
        path: Vertices, shape (N, 2) [m], map frame.
        covariance: Of a place, shape (2, 2) [m²].
        times: Of the vertices, shape (N,) [s]; None leaves the speed open.
        spacing: Between the places that are taken [m]: a line is one intention and not as many
            as it has points. With times all vertices are taken.
        on: Level that is measured; None for the first one.
        name: For reports.
    """

    path: Array
    covariance: Array
    times: Array | None = None
    spacing: float = 1.0
    on: str | None = None
    name: str = "drawn path"

    @property
    def readings(self) -> tuple[Reading, ...]:
        """Places along the path, its end among them.

        Raises:
            ValueError: the path is no list of points, has not as many times as vertices, or the
                spacing is none.
        """
        path = np.asarray(self.path, dtype=float)
        if path.ndim != 2 or path.shape[1] != 2 or len(path) == 0:
            raise ValueError(f"path has shape {path.shape}; give shape (N, 2)")
        if not 0 < self.spacing < np.inf:
            raise ValueError(f"spacing is {self.spacing!r}; give a finite length above 0")
        if self.times is not None and np.shape(self.times) != (len(path),):
            what = f"times have shape {np.shape(self.times)}"
            raise ValueError(f"{what}; give one for each vertex of path, shape ({len(path)},)")
        if self.times is not None:
            return tuple(
                Reading(float(t), p, self.covariance) for t, p in zip(self.times, path, strict=True)
            )
        return tuple(Reading(None, p, self.covariance) for p in self._places(path))

    def _places(self, path: Array) -> Array:
        if not np.all(np.isfinite(path)) or len(path) < 2:
            return path  # the rules of a scenario name what is wrong with it
        s = arc_length(path)
        count = max(1, round(float(s[-1]) / self.spacing))
        at = np.linspace(0.0, s[-1], count + 1)[1:]
        return np.column_stack([np.interp(at, s, path[:, 0]), np.interp(at, s, path[:, 1])])

    def pieces(self, now: float, times: Array) -> Iterable[Piece]:
        """None."""
        return ()
