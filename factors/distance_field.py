"""A signed distance field on a grid, with the derivatives that an obstacle factor needs."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FAR = 1e6
"""Distance [m] of a place that no obstacle is near to: no cost anywhere, but still a number."""


class Outside(Enum):
    """What a field says outside its grid."""

    LOWER_BOUND = "lower bound"
    """d(b) − |x − b| at the nearest point b of the grid: no 1-Lipschitz distance that agrees with
    the field at b is smaller there, so what is not known is never free of cost by accident, and
    the gradient leads back in."""
    FREE = "free"
    """`FAR`, without a gradient, as GPMP2 has it (Mukadam et al., IJRR 2018)."""


class _Cell(NamedTuple):
    """Where points lie: the coefficients (..., 4) of 1, s, t, st in their cell, the place (s, t)
    in it (..., 2), and how far they are outside the grid (..., 2) [m], all in the grid's own
    axes; None where all are inside."""

    coefficients: Array
    place: Array
    out: Array | None


@dataclass(frozen=True, eq=False)
class SignedDistanceField:
    r"""Bilinear interpolation of signed distances given at the nodes of a grid.

    In a cell, d = a + b s + c t + e s t with (s, t) in [0, 1]² the place between its four nodes.
    The field is continuous; its gradient jumps from cell to cell.

    Args:
        values: Distance at the node origin + R(yaw) (j·resolution, i·resolution) in row i and
            column j, shape (rows, cols) [m], negative inside obstacles. For an occupancy grid
            the nodes are the cell centres.
        origin: Of node (0, 0), shape (2,) [m].
        resolution: Between two nodes [m].
        yaw: Of the grid's columns, counter-clockwise from x [rad].
        outside: What holds outside the nodes.

    Raises:
        ValueError: fewer than two rows or columns, a number that is not finite, a resolution that
            is not positive.

    Reference:
        Mukadam, Dong, Yan, Dellaert, Boots, IJRR 2018 (GPMP2).
    """

    values: Array
    origin: Array
    resolution: float
    yaw: float = 0.0
    outside: Outside = Outside.LOWER_BOUND

    def __post_init__(self) -> None:
        values = np.ascontiguousarray(self.values, dtype=float)
        origin = np.asarray(self.origin, dtype=float)
        if values.ndim != 2 or min(values.shape) < 2:
            raise ValueError(f"values needs 2 rows and 2 columns, got shape {values.shape}")
        if origin.shape != (2,):
            raise ValueError(f"origin has shape {origin.shape}, expected (2,)")
        if not self.resolution > 0:
            raise ValueError(f"resolution must be positive, got {self.resolution}")
        if not (np.all(np.isfinite(values)) and np.all(np.isfinite([*origin, self.yaw]))):
            raise ValueError("values, origin and yaw must be finite")
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "origin", origin)

    def distance(self, points: Any) -> Array:
        """Signed distance at points (..., 2), shape (...) [m]; NaN where a point is NaN."""
        cell = self._locate(points)
        k, s, t = cell.coefficients, cell.place[..., 0], cell.place[..., 1]
        d = k[..., 0] + k[..., 1] * s + t * (k[..., 2] + k[..., 3] * s)
        return d if cell.out is None else self._leave(cell.out, d)

    def linearize(self, points: Any) -> tuple[Array, Array]:
        """Signed distance (...) [m] and its gradient (..., 2) in the map frame."""
        cell = self._locate(points)
        return self._slope(cell)

    def expand(self, points: Any) -> tuple[Array, Array, Array]:
        """Signed distance (...), gradient (..., 2) and Hessian (..., 2, 2) [1/m] in the map frame.

        Inside a cell only the mixed derivative (in the grid's axes) is not zero.
        """
        cell = self._locate(points)
        d, gradient = self._slope(cell)
        uv = cell.coefficients[..., 3] / self.resolution**2
        uu = np.zeros_like(uv)
        vv = uu
        if cell.out is not None:
            uu, uv, vv = self._leave_hessian(cell.out, uv)
        c, s = self._axes
        xx = c * c * uu - 2 * c * s * uv + s * s * vv
        yy = s * s * uu + 2 * c * s * uv + c * c * vv
        xy = c * s * (uu - vv) + (c * c - s * s) * uv
        hessian = np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)
        return d, gradient, hessian

    @cached_property
    def _axes(self) -> tuple[float, float]:
        return float(np.cos(self.yaw)), float(np.sin(self.yaw))

    @cached_property
    def _table(self) -> Array:
        """Coefficients of every cell, shape ((rows − 1)(cols − 1), 4): one gather a point."""
        v = self.values
        a, b, c = v[:-1, :-1], v[:-1, 1:] - v[:-1, :-1], v[1:, :-1] - v[:-1, :-1]
        e = v[1:, 1:] - v[1:, :-1] - b
        return np.ascontiguousarray(np.stack([a, b, c, e], axis=-1).reshape(-1, 4))

    @cached_property
    def _last(self) -> Array:
        """Column and row of the last node."""
        rows, cols = self.values.shape
        return np.array([cols - 1.0, rows - 1.0])

    def _locate(self, points: Any) -> _Cell:
        at = (np.asarray(points, dtype=float) - self.origin) / self.resolution
        if self.yaw:
            c, s = self._axes
            u, v = at[..., 0], at[..., 1]
            at = np.stack([c * u + s * v, c * v - s * u], axis=-1)
        # fmin and fmax put NaN on the border, so that it comes out as NaN and not as a crash.
        inside = np.fmax(np.fmin(at, self._last), 0.0)
        node = np.minimum(inside.astype(np.intp), self._last.astype(np.intp) - 1)
        which = node[..., 1] * (self.values.shape[1] - 1) + node[..., 0]
        out = at - inside
        return _Cell(
            self._table.take(which, axis=0),
            inside - node,
            out * self.resolution if np.any(out) else None,
        )

    def _slope(self, cell: _Cell) -> tuple[Array, Array]:
        k, s, t = cell.coefficients, cell.place[..., 0], cell.place[..., 1]
        row = k[..., 2] + k[..., 3] * s
        d = k[..., 0] + k[..., 1] * s + t * row
        gradient = np.empty(cell.place.shape)
        gradient[..., 0] = k[..., 1] + k[..., 3] * t
        gradient[..., 1] = row
        gradient /= self.resolution
        if cell.out is not None:
            d = self._leave(cell.out, d)
            gradient = self._leave_gradient(cell.out, gradient)
        if self.yaw:
            c, n = self._axes
            gu, gv = gradient[..., 0], gradient[..., 1]
            gradient = np.stack([c * gu - n * gv, n * gu + c * gv], axis=-1)
        return d, gradient

    def _leave(self, out: Array, d: Array) -> Array:
        """The distance, corrected for points outside the grid."""
        away = np.hypot(out[..., 0], out[..., 1])
        if self.outside is Outside.FREE:
            return np.where(away > 0, FAR, d + away)  # d + away keeps NaN
        return np.asarray(d - away)

    def _leave_gradient(self, out: Array, gradient: Array) -> Array:
        away = np.hypot(out[..., 0], out[..., 1])[..., None]
        if self.outside is Outside.FREE:
            return np.where(away > 0, 0.0, gradient)
        return np.where(out == 0, gradient, -out / np.where(away > 0, away, 1.0))

    def _leave_hessian(self, out: Array, uv: Array) -> tuple[Array, Array, Array]:
        """Beside an edge everything is linear; beyond a corner −|x − b| is a cone."""
        u, v = out[..., 0], out[..., 1]
        corner = (u != 0) & (v != 0) & (self.outside is Outside.LOWER_BOUND)
        cubed = np.where(corner, np.hypot(u, v), 1.0) ** 3
        inside = np.where((u == 0) & (v == 0), uv, 0.0)
        uu = np.where(corner, -v * v / cubed, 0.0)
        vv = np.where(corner, -u * u / cubed, 0.0)
        return uu, np.where(corner, u * v / cubed, inside), vv
