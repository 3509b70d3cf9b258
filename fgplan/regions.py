"""Named regions of the map: what missions and tactical data speak of."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from factors.shape import Shape

Array = NDArray[np.float64]
Letter = frozenset[str]


@dataclass(frozen=True)
class Region:
    """All points within `radius` of a polygon: a polygon for radius 0, a disc for one vertex.

    Args:
        name: Unique in a scenario; what a mission calls it.
        polygon: Vertices (x, y) in either order [m]: one, two, or those of a simple polygon.
        radius: [m].

    Raises:
        ValueError: there is no vertex, a number is not finite, the radius is negative, or the
            region has no inside.
    """

    name: str
    polygon: tuple[tuple[float, float], ...]
    radius: float = 0.0

    def __post_init__(self) -> None:
        vertices = tuple((float(x), float(y)) for x, y in self.polygon)
        object.__setattr__(self, "polygon", vertices)
        object.__setattr__(self, "radius", float(self.radius))
        try:
            shape = self.shape
        except ValueError as error:
            raise ValueError(f"region {self.name!r}: {error}") from None
        if shape.radius == 0 and not shape.area > 0:
            raise ValueError(
                f"region {self.name!r}: has no inside; give three vertices or more, or a radius"
            )

    @classmethod
    def disc(cls, name: str, centre: Any, radius: float) -> Self:
        """All points within `radius` of a point [m]."""
        x, y = np.asarray(centre, dtype=float).tolist()
        return cls(name, ((x, y),), radius)

    @classmethod
    def box(cls, name: str, xmin: float, ymin: float, xmax: float, ymax: float) -> Self:
        """A rectangle along the axes [m]."""
        return cls(name, ((xmin, ymin), (xmax, ymin), (xmax, ymax), (xmin, ymax)))

    @cached_property
    def shape(self) -> Shape:
        """Its signed distance, for factors."""
        return Shape(np.array(self.polygon, dtype=float), self.radius)

    def contains(self, points: Any) -> NDArray[np.bool_]:
        """Whether points (..., 2) are in it, its rim included; shape (...)."""
        return np.asarray(self.shape.distance(np.asarray(points, dtype=float)) <= 0)


def letter_at(regions: Iterable[Region], point: Any) -> Letter:
    """Names of the regions that a point is in."""
    return frozenset(region.name for region in regions if region.contains(point))


def word_along(regions: Iterable[Region], path: Any, spacing: float = 0.02) -> list[Letter]:
    """The regions that a point is in as it moves along a path: a letter whenever they change.

    Args:
        regions: Of which it speaks.
        path: Vertices, shape (N, 2) [m].
        spacing: Of the points looked at [m]; a region cut by less may be missed.
    """
    p = np.asarray(path, dtype=float)
    steps = np.linalg.norm(np.diff(p, axis=0), axis=1)
    parts = [p[:1]]
    for a, b, length in zip(p[:-1], p[1:], steps, strict=True):
        count = max(1, int(np.ceil(length / spacing)))
        parts.append(a + (np.arange(1, count + 1) / count)[:, None] * (b - a))
    points = np.vstack(parts)
    named = tuple(regions)
    inside = np.stack([r.contains(points) for r in named], axis=1) if named else np.zeros((1, 0))
    changed = np.flatnonzero(np.any(inside[1:] != inside[:-1], axis=1)) + 1
    return [
        frozenset(r.name for r, is_in in zip(named, inside[k], strict=True) if is_in)
        for k in (0, *changed.tolist())
    ]
