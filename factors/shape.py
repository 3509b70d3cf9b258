"""Signed distance to a region in the plane: a polygon, rounded by a radius."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from factors.hinge import TINY
from factors.residual import Array


@dataclass(frozen=True, eq=False)
class Shape:
    r"""All points within `radius` of a polygon; d(p) < 0 inside.

    d(p) = ±min over edges of ‖p − nearest point of the edge‖ − radius, minus inside the polygon.
    One vertex makes a disc, two a capsule. The gradient is a unit vector away from the nearest
    point; the curvature is 0 where that lies inside an edge and (I − u uᵀ)/‖p − v‖ where it is a
    vertex v. Where two nearest points are equally far it has a kink.

    Args:
        vertices: In either order, shape (n, 2), n ≥ 1 [m].
        radius: [m].

    Raises:
        ValueError: the shape of the vertices is wrong, a number is not finite, or the radius is
            negative.
    """

    vertices: Array
    radius: float = 0.0

    def __post_init__(self) -> None:
        v = np.asarray(self.vertices, dtype=float)
        if v.ndim != 2 or v.shape[1] != 2 or len(v) == 0:
            raise ValueError(f"vertices must have shape (n, 2) with n ≥ 1, got {v.shape}")
        if not np.all(np.isfinite(v)):
            raise ValueError(f"vertices must be finite, got {v.tolist()}")
        if not (np.isfinite(self.radius) and self.radius >= 0):
            raise ValueError(f"radius must be finite and not negative, got {self.radius}")
        object.__setattr__(self, "vertices", v)

    @cached_property
    def area(self) -> float:
        """Of the polygon [m²]."""
        x, y = self.vertices.T
        return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))

    def distance(self, p: Array) -> Array:
        """d, shape (...), at points p (..., 2) [m]."""
        _, away, _ = self._nearest(p)
        return np.asarray(self._sign(p) * np.sqrt(away) - self.radius)

    def linearize(self, p: Array) -> tuple[Array, Array]:
        """d and its gradient, shape (..., 2)."""
        d, gradient, _ = self.expand(p)
        return d, gradient

    def expand(self, p: Array) -> tuple[Array, Array, Array]:
        """d, its gradient and its Hessian, shape (..., 2, 2)."""
        offset, away, at_vertex = self._nearest(p)
        length = np.sqrt(away + TINY**2)
        sign = self._sign(p)
        u = offset / length[..., None]
        # On an edge `offset` is along the edge's normal whatever p is: no curvature.
        bend = (np.eye(2) - u[..., :, None] * u[..., None, :]) / length[..., None, None]
        hessian = sign[..., None, None] * np.where(at_vertex[..., None, None], bend, 0.0)
        return sign * np.sqrt(away) - self.radius, sign[..., None] * u, hessian

    def _nearest(self, p: Array) -> tuple[Array, Array, Array]:
        """p minus the nearest point of the outline (..., 2), its square (...), and whether that
        point is a vertex (...)."""
        a, b = self._edges
        along = b - a
        square = np.maximum(np.einsum("ij,ij->i", along, along), 1e-300)
        to = p[..., None, :] - a
        share = np.clip(np.einsum("...ij,ij->...i", to, along) / square, 0.0, 1.0)
        offset = to - share[..., None] * along
        squares = np.einsum("...ij,...ij->...i", offset, offset)
        which = np.argmin(squares, axis=-1)[..., None]
        share = np.take_along_axis(share, which, axis=-1)[..., 0]
        nearest = np.take_along_axis(offset, which[..., None], axis=-2)[..., 0, :]
        away = np.take_along_axis(squares, which, axis=-1)[..., 0]
        return nearest, away, (share == 0) | (share == 1)

    def _sign(self, p: Array) -> Array:
        """−1 inside the polygon, 1 outside, by counting edges to the right."""
        a, b = self._edges
        y = p[..., None, 1]
        spans = (a[:, 1] > y) != (b[:, 1] > y)
        rise = np.where(a[:, 1] == b[:, 1], 1.0, b[:, 1] - a[:, 1])
        x = a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / rise
        odd = np.count_nonzero(spans & (p[..., None, 0] < x), axis=-1) % 2
        return np.where(odd == 1, -1.0, 1.0)

    @cached_property
    def _edges(self) -> tuple[Array, Array]:
        """First and second end of each edge, shape (n, 2) each."""
        return self.vertices, np.roll(self.vertices, -1, axis=0)
