"""Limits on a norm, compiled: what `factors.kinematics` says of speed and acceleration."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from factors.hinge import TINY, hinge_scale
from factors.kinematics import AccelerationLimit, SpeedLimit
from factors.residual import Array, Expansion, Residual
from fgplan.compiled.kernel import FLOAT, INT, exact, given, result
from fgplan.model import Term

Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class NormLimit(Residual):
    """½ (scale · max(0, ‖Δ‖ − limit))², Δ the velocity of one state or its change from one to the
    next.

    Args:
        original: The same in numpy, with its Jacobians.
        limit: Highest norm without penalty [m/s].
        scale: Whitens the excess [s/m].
    """

    convex: ClassVar[bool] = True

    original: SpeedLimit | AccelerationLimit
    limit: float
    scale: float

    @property
    def dims(self) -> tuple[int, ...]:
        return self.original.dims

    @property
    def rows(self) -> int:
        return 1

    @property
    def support(self) -> Index:
        return self.original.support

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        return self.original.linearize(*x)

    def energy(self, *x: Array) -> Array:
        states = _states(x)
        energy = np.zeros(states[0].shape[:2])
        _energy(*states, len(x), self.support[0], self.limit, self.scale, energy)
        return energy.reshape(x[0].shape[:-1])

    def expand(self, *x: Array) -> Expansion:
        states, size = _states(x), 2 * len(x)
        batch, shape = x[0].shape[:-1], states[0].shape[:2]
        sums = Expansion(np.zeros(shape), np.zeros((*shape, size)), np.zeros((*shape, size, size)))
        _expand(*states, len(x), self.support[0], self.limit, self.scale, *sums)
        return Expansion(*(part.reshape(*batch, *part.shape[2:]) for part in sums))


def compiled(term: Term) -> Term:
    """The term, compiled where it is such a limit in the plane."""
    original = term.residual
    if not isinstance(original, SpeedLimit | AccelerationLimit) or original.dim != 4:
        return term
    dt = original.dt if isinstance(original, AccelerationLimit) else 1.0
    scale = hinge_scale(original.sigma, original.weight) / dt
    return replace(term, residual=NormLimit(original, original.limit * dt, scale))


def _states(x: tuple[Array, ...]) -> tuple[Array, Array]:
    """The first and the last state, shape (N, S, dim) each."""
    return x[0].reshape(-1, *x[0].shape[-2:]), x[-1].reshape(-1, *x[-1].shape[-2:])


@exact()
def _difference(first: Array, last: Array, count: int, at: int) -> tuple[float, float]:
    """Velocity of the only state, or its change between two."""
    if count == 1:
        return last[at], last[at + 1]
    return last[at] - first[at], last[at + 1] - first[at + 1]


_GIVEN = (given(3), given(3), INT, INT, FLOAT, FLOAT)


@exact(*_GIVEN, result(2))
def _energy(
    first: Array, last: Array, count: int, at: int, limit: float, scale: float, energy: Array
) -> None:
    for n in range(first.shape[0]):
        for k in range(first.shape[1]):
            x, y = _difference(first[n, k], last[n, k], count, at)
            e = scale * (sqrt(x * x + y * y + TINY**2) - limit)
            if not e < 0:
                energy[n, k] = 0.5 * e * e


@exact(*_GIVEN, result(2), result(3), result(4))
def _expand(
    first: Array,
    last: Array,
    count: int,
    at: int,
    limit: float,
    scale: float,
    energy: Array,
    gradient: Array,
    hessian: Array,
) -> None:
    for n in range(first.shape[0]):
        for k in range(first.shape[1]):
            x, y = _difference(first[n, k], last[n, k], count, at)
            d = sqrt(x * x + y * y + TINY**2)
            e = scale * (d - limit)
            if e < 0:
                continue
            slope = scale * e / d
            b = (scale * scale - slope) / (d * d)
            energy[n, k] = 0.5 * e * e
            for q in range(count):
                sign = 1.0 if q == count - 1 else -1.0
                gradient[n, k, 2 * q] = sign * slope * x
                gradient[n, k, 2 * q + 1] = sign * slope * y
                for p in range(count):
                    both = sign if p == count - 1 else -sign
                    hessian[n, k, 2 * q, 2 * p] = both * (slope + b * x * x)
                    hessian[n, k, 2 * q + 1, 2 * p] = both * b * x * y
                    hessian[n, k, 2 * q, 2 * p + 1] = both * b * x * y
                    hessian[n, k, 2 * q + 1, 2 * p + 1] = both * (slope + b * y * y)
