"""Limits on speed and acceleration, compiled: what `factors.kinematics` says of two states."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from factors.hinge import TINY, hinge_scale
from factors.kinematics import AccelerationLimit, SpeedLimit
from factors.residual import Array, Expansion, Residual
from fgplan.compiled.kernel import BOOL, FLOAT, exact, given, result
from fgplan.model import Term

Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Limits(Residual):
    """Of a robot in the plane: on its speed at a state, and on the change of its velocity since
    the state before.

    Args:
        speed: Highest speed without penalty [m/s].
        speed_scale: Whitens what is above [s/m].
        change: Highest change without penalty [m/s].
        change_scale: Whitens what is above [s/m].
    """

    convex: ClassVar[bool] = True

    speed: float
    speed_scale: float
    change: float
    change_scale: float

    @property
    def dims(self) -> tuple[int, ...]:
        return (4, 4)

    @property
    def rows(self) -> int:
        return 2

    @property
    def support(self) -> Index:
        return np.array([2, 3, 6, 7])

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        raise TypeError("linearize the limits one by one")

    def energy(self, *x: Array) -> Array:
        before, after = (part.reshape(-1, *part.shape[-2:]) for part in x)
        energy = np.empty(before.shape[:2])
        _energy(before, after, *self._numbers, energy)
        return energy.reshape(x[0].shape[:-1])

    def expand(self, *x: Array) -> Expansion:
        return self._expansion(x, flat=False)

    def gauss_newton(self, *x: Array) -> Expansion:
        return self._expansion(x, flat=True)

    def _expansion(self, x: tuple[Array, ...], flat: bool) -> Expansion:
        before, after = (part.reshape(-1, *part.shape[-2:]) for part in x)
        shape, batch = before.shape[:2], x[0].shape[:-1]
        sums = Expansion(np.zeros(shape), np.zeros((*shape, 4)), np.zeros((*shape, 4, 4)))
        _expand(before, after, *self._numbers, flat, *sums)
        return Expansion(*(part.reshape(*batch, *part.shape[2:]) for part in sums))

    @property
    def _numbers(self) -> tuple[float, float, float, float]:
        return self.speed, self.speed_scale, self.change, self.change_scale


def fused(terms: Sequence[Term]) -> Iterator[Term]:
    """The terms, a limit on speed and one on acceleration of the same states as one, compiled."""
    rest = list(terms)
    for term in terms:
        speed = next((other for other in rest if _limits_speed_of(other, term)), None)
        if speed is not None:
            rest.remove(term)
            rest.remove(speed)
            yield replace(term, residual=_limits(speed.residual, term.residual))
    yield from rest


def _limits_speed_of(one: Term, other: Term) -> bool:
    """Whether one is a limit on the speed of the later states of a limit on acceleration."""
    kinds = isinstance(one.residual, SpeedLimit) and isinstance(other.residual, AccelerationLimit)
    if not kinds or one.residual.dims + one.residual.dims != other.residual.dims:
        return False
    later = range(other.steps.start + 1, other.steps.stop + 1, other.steps.step)
    variable = one.variables[0]
    return (
        one.residual.dims == (4,)
        and one.steps == later
        and other.variables == (variable, (variable[0], 1))
    )


def _limits(speed: Residual, acceleration: Residual) -> Limits:
    assert isinstance(speed, SpeedLimit)
    assert isinstance(acceleration, AccelerationLimit)
    return Limits(
        speed.limit,
        hinge_scale(speed.sigma, speed.weight),
        acceleration.limit * acceleration.dt,
        hinge_scale(acceleration.sigma, acceleration.weight) / acceleration.dt,
    )


_GIVEN = (given(3), given(3), FLOAT, FLOAT, FLOAT, FLOAT)


@exact()
def _excess(x: float, y: float, limit: float, scale: float) -> float:
    return scale * (sqrt(x * x + y * y + TINY**2) - limit)


@exact(*_GIVEN, result(2))
def _energy(
    before: Array,
    after: Array,
    speed: float,
    speed_scale: float,
    change: float,
    change_scale: float,
    energy: Array,
) -> None:
    for n in range(before.shape[0]):
        for k in range(before.shape[1]):
            x, y, u, v = after[n, k, 2], after[n, k, 3], before[n, k, 2], before[n, k, 3]
            fast = _excess(x, y, speed, speed_scale)
            hard = _excess(x - u, y - v, change, change_scale)
            total = 0.0
            if not fast < 0:
                total += 0.5 * fast * fast
            if not hard < 0:
                total += 0.5 * hard * hard
            energy[n, k] = total


@exact()
def _radial(
    x: float, y: float, limit: float, scale: float, flat: bool
) -> tuple[float, float, float, float]:
    """Energy, slope, a and b of `factors.radial.Radial`; with `flat`, the Gauss–Newton
    curvature."""
    e = _excess(x, y, limit, scale)
    if e < 0:
        return 0.0, 0.0, 0.0, 0.0
    d2 = x * x + y * y + TINY**2
    slope = scale * e / sqrt(d2)
    a = 0.0 if flat else slope
    return 0.5 * e * e, slope, a, (scale * scale - a) / d2


@exact(*_GIVEN, BOOL, result(2), result(3), result(4))
def _expand(
    before: Array,
    after: Array,
    speed: float,
    speed_scale: float,
    change: float,
    change_scale: float,
    flat: bool,
    energy: Array,
    gradient: Array,
    hessian: Array,
) -> None:
    for n in range(before.shape[0]):
        for k in range(before.shape[1]):
            g, H = gradient[n, k], hessian[n, k]
            x, y = after[n, k, 2], after[n, k, 3]
            e, slope, a, b = _radial(x, y, speed, speed_scale, flat)
            energy[n, k] = e
            g[2], g[3] = slope * x, slope * y
            H[2, 2], H[2, 3], H[3, 3] = a + b * x * x, b * x * y, a + b * y * y
            x, y = x - before[n, k, 2], y - before[n, k, 3]
            e, slope, a, b = _radial(x, y, change, change_scale, flat)
            energy[n, k] += e
            g[0], g[1] = -slope * x, -slope * y
            g[2] += slope * x
            g[3] += slope * y
            xx, xy, yy = a + b * x * x, b * x * y, a + b * y * y
            H[0, 0], H[0, 1], H[1, 1] = xx, xy, yy
            H[2, 2] += xx
            H[2, 3] += xy
            H[3, 3] += yy
            H[0, 2], H[0, 3], H[1, 2], H[1, 3] = -xx, -xy, -xy, -yy
            for r in range(4):
                for c in range(r):
                    H[r, c] = H[c, r]
