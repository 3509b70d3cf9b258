"""Static obstacles: a hinge on the signed distance, at the states and between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from factors.distance_field import SignedDistanceField
from factors.gp_prior import GPPrior
from factors.hinge import Hinge, hinge_scale
from factors.residual import Array, Expansion, Residual


@dataclass(frozen=True, eq=False)
class Obstacle(Residual):
    r"""e = √weight · max(0, margin + radius − d(p))/sigma at the position p of one state.

    Args:
        field: Signed distance d to the nearest obstacle; it also says what lies outside the map.
        radius: Of the robot's disc [m].
        margin: ε, the clearance below which the penalty starts [m].
        sigma: [m]; inf switches the penalty off.
        weight: Exponent of the potential, dt/t_ref.
        dim: Size of the state, whose first two components are the position.

    Raises:
        ValueError: radius, margin or weight is negative, sigma is not positive, or dim < 2.

    Reference:
        Mukadam et al., IJRR 2018, eq. 37.
    """

    field: SignedDistanceField
    radius: float
    margin: float
    sigma: float
    weight: float = 1.0
    dim: int = 4

    def __post_init__(self) -> None:
        _hinge(self.radius, self.margin, self.sigma, self.weight)
        if self.dim < 2:
            raise ValueError(f"a state needs a position in the plane, got dim = {self.dim}")

    @property
    def dims(self) -> tuple[int, ...]:
        return (self.dim,)

    @property
    def rows(self) -> int:
        return 1

    @cached_property
    def support(self) -> NDArray[np.intp]:
        return np.arange(2)

    @cached_property
    def _hinge(self) -> Hinge:
        return _hinge(self.radius, self.margin, self.sigma, self.weight)

    def error(self, *x: Array) -> Array:
        return self._hinge.error(self.field.distance(x[0][..., :2]))[..., None]

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        e, slope = self._hinge.linearize(*self.field.linearize(x[0][..., :2]))
        J = np.zeros((*e.shape, 1, self.dim))
        J[..., 0, :2] = slope
        return e[..., None], (J,)

    def gauss_newton(self, *x: Array) -> Expansion:
        return self._hinge.gauss_newton(*self.field.linearize(x[0][..., :2]))

    def expand(self, *x: Array) -> Expansion:
        return self._hinge.expand(*self.field.expand(x[0][..., :2]))


@dataclass(frozen=True, eq=False)
class InterpolatedObstacle(Residual):
    r"""The same hinge at points between two states, one row a point:

    p(τ) = position of Λ(τ) x_k + Ψ(τ) x_{k+1}, the mean of the GP prior given its neighbours.

    Args:
        field, radius, margin, sigma: See `Obstacle`.
        dt: Time between the two states [s].
        checks: How many points, evenly spaced; or where, as fractions of dt between 0 and 1.
        weight: Exponent of the potential over the interval, dt/t_ref: the points share it
            equally, so that more points do not weigh more.

    Raises:
        ValueError: See `Obstacle`; or dt is not positive, or there is no check, or one outside
            the interval.

    Reference:
        Mukadam et al., IJRR 2018, section 4.3.
    """

    field: SignedDistanceField
    radius: float
    margin: float
    sigma: float
    dt: float
    checks: int | tuple[float, ...]
    weight: float = 1.0

    def __post_init__(self) -> None:
        fractions = self.fractions
        if not fractions or not all(0 < f < 1 for f in fractions):
            raise ValueError(f"checks must lie between two states, got {self.checks}")
        _hinge(self.radius, self.margin, self.sigma, self.weight)
        GPPrior(self.dt, np.eye(2))

    @property
    def dims(self) -> tuple[int, ...]:
        return (4, 4)

    @property
    def rows(self) -> int:
        return len(self.fractions)

    @property
    def fractions(self) -> tuple[float, ...]:
        """τ/dt of each point."""
        if isinstance(self.checks, int):
            return tuple((i + 1) / (self.checks + 1) for i in range(self.checks))
        return self.checks

    @cached_property
    def _hinge(self) -> Hinge:
        return _hinge(self.radius, self.margin, self.sigma, self.weight / self.rows)

    @cached_property
    def _M(self) -> Array:
        """p(τ_i) = M_i (x_k, x_{k+1}), shape (rows, 2, 8)."""
        prior = GPPrior(self.dt, np.eye(2))  # the mean between two states does not depend on Qc
        halves = [prior.interpolate(fraction * self.dt) for fraction in self.fractions]
        return np.stack([np.concatenate(half, axis=1)[:2] for half in halves])

    @cached_property
    def _congruence(self) -> Array:
        """Takes the Hessians at all points to Σ M_iᵀ H_i M_i in one matrix product, which is
        several times faster than a small product a point; shape (rows·4, 64)."""
        outer = np.einsum("iar,ibs->iabrs", self._M, self._M)
        return np.asarray(outer).reshape(4 * self.rows, 64)

    def points(self, before: Array, after: Array) -> Array:
        """Where the robot is checked, shape (..., rows, 2) [m]."""
        both = np.concatenate([before, after], axis=-1)
        return np.asarray(both @ self._M.reshape(-1, 8).T).reshape(*both.shape[:-1], -1, 2)

    def error(self, *x: Array) -> Array:
        return self._hinge.error(self.field.distance(self.points(*x)))

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        e, slope = self._hinge.linearize(*self.field.linearize(self.points(*x)))
        J = (slope[..., None, :] @ self._M)[..., 0, :]
        return e, (J[..., :4], J[..., 4:])

    def gauss_newton(self, *x: Array) -> Expansion:
        return self._gather(self._hinge.gauss_newton(*self.field.linearize(self.points(*x))))

    def expand(self, *x: Array) -> Expansion:
        return self._gather(self._hinge.expand(*self.field.expand(self.points(*x))))

    def _gather(self, each: Expansion) -> Expansion:
        """From expansions in the points (..., rows) to one in the two states."""
        batch = each.energy.shape[:-1]
        gradient = np.asarray(each.gradient.reshape(*batch, -1) @ self._M.reshape(-1, 8))
        hessian = each.hessian.reshape(*batch, -1) @ self._congruence
        return Expansion(each.energy.sum(-1), gradient, hessian.reshape(*batch, 8, 8))


def _hinge(radius: float, margin: float, sigma: float, weight: float) -> Hinge:
    if not (radius >= 0 and margin >= 0):
        raise ValueError(f"radius and margin must not be negative, got {radius} and {margin}")
    return Hinge(radius + margin, hinge_scale(sigma, weight), "below")
