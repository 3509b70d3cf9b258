"""What the robot can do: speed, acceleration and turn limits, as one-sided penalties."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from factors.hinge import Hinge, hinge_scale, linearize_norm, norm
from factors.radial import components, square
from factors.residual import Array, Expansion, Residual, positive

AT_REST = 5e-4
"""Smooths |v| and |ω|·radius around 0 in a curvature limit [m/s]."""


@dataclass(frozen=True, eq=False)
class SpeedLimit(Residual):
    r"""e = √weight · max(0, ‖v‖ − limit)/sigma on the velocity of one state.

    Args:
        limit: Highest speed without penalty, not negative [m/s].
        sigma: [m/s]; inf switches the penalty off.
        weight: Exponent of the potential, dt/t_ref.
        dim: Size of the state: dim/2 positions, then dim/2 velocities.

    Raises:
        ValueError: limit or weight is negative, sigma is not positive, or dim is odd.
    """

    convex: ClassVar[bool] = True

    limit: float
    sigma: float
    weight: float = 1.0
    dim: int = 4

    def __post_init__(self) -> None:
        _check(self.limit, self.dim)
        hinge_scale(self.sigma, self.weight)

    @property
    def dims(self) -> tuple[int, ...]:
        return (self.dim,)

    @property
    def rows(self) -> int:
        return 1

    @cached_property
    def support(self) -> NDArray[np.intp]:
        return np.arange(self.dim // 2, self.dim)

    @cached_property
    def _hinge(self) -> Hinge:
        return Hinge(self.limit, hinge_scale(self.sigma, self.weight), "above")

    def error(self, *x: Array) -> Array:
        return self._hinge.error(norm(self._velocity(x[0])))[..., None]

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        e, slope = self._hinge.linearize(*linearize_norm(self._velocity(x[0])))
        J = np.zeros((*e.shape, 1, self.dim))
        J[..., 0, self.dim // 2 :] = slope
        return e[..., None], (J,)

    def expand(self, *x: Array) -> Expansion:
        v = components(self._velocity(x[0]))
        return self._hinge.radial(square(v)).of(v)

    def energy(self, *x: Array) -> Array:
        return self._hinge.energy_of(square(components(self._velocity(x[0]))))

    def _velocity(self, state: Array) -> Array:
        return state[..., self.dim // 2 :]


@dataclass(frozen=True, eq=False)
class AccelerationLimit(Residual):
    r"""e = √weight · max(0, ‖v_{k+1} − v_k‖/dt − limit)/sigma on two consecutive states.

    Args:
        limit: Highest acceleration without penalty, not negative [m/s²].
        sigma: [m/s²]; inf switches the penalty off.
        dt: Time between the two states [s].
        weight: Exponent of the potential, dt/t_ref.
        dim: Size of the state: dim/2 positions, then dim/2 velocities.

    Raises:
        ValueError: limit or weight is negative, sigma or dt is not positive, or dim is odd.
    """

    convex: ClassVar[bool] = True

    limit: float
    sigma: float
    dt: float
    weight: float = 1.0
    dim: int = 4

    def __post_init__(self) -> None:
        _check(self.limit, self.dim)
        hinge_scale(self.sigma, self.weight)
        positive(dt=self.dt)

    @property
    def dims(self) -> tuple[int, ...]:
        return (self.dim, self.dim)

    @property
    def rows(self) -> int:
        return 1

    @cached_property
    def support(self) -> NDArray[np.intp]:
        velocity = np.arange(self.dim // 2, self.dim)
        return np.concatenate([velocity, self.dim + velocity])

    @cached_property
    def _hinge(self) -> Hinge:
        """On the change of velocity, in m/s: where v hardly changes the norm is smoothed there."""
        scale = hinge_scale(self.sigma, self.weight) / self.dt
        return Hinge(self.limit * self.dt, scale, "above")

    def error(self, *x: Array) -> Array:
        return self._hinge.error(norm(self._change(*x)))[..., None]

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        e, slope = self._hinge.linearize(*linearize_norm(self._change(*x)))
        J = np.zeros((*e.shape, 1, self.dim))
        J[..., 0, self.dim // 2 :] = slope
        return e[..., None], (-J, J)

    def expand(self, *x: Array) -> Expansion:
        change = components(self._change(*x))
        energy, slope, H = self._hinge.radial(square(change)).of(change)
        m = self.dim // 2
        hessian = np.empty((*energy.shape, 2 * m, 2 * m))
        hessian[..., :m, :m] = hessian[..., m:, m:] = H
        hessian[..., :m, m:] = hessian[..., m:, :m] = -H
        return Expansion(energy, np.concatenate([-slope, slope], axis=-1), hessian)

    def energy(self, *x: Array) -> Array:
        return self._hinge.energy_of(square(components(self._change(*x))))

    def _change(self, before: Array, after: Array) -> Array:
        m = self.dim // 2
        return np.asarray(after[..., m:] - before[..., m:])


@dataclass(frozen=True, eq=False)
class LinearLimit(Residual):
    r"""e = √weight · max(0, Σ A_i x_i − b)/sigma: one-sided limits on linear functions, one a row.

    Args:
        A: One matrix (rows, dims[i]) per variable.
        b: The limits, shape (rows,), in the unit of the rows.
        sigma: The same unit; inf switches the penalty off.
        weight: Exponent of the potential, dt/t_ref.

    Raises:
        ValueError: shapes do not fit, sigma is not positive, or weight is negative.
    """

    convex: ClassVar[bool] = True

    A: tuple[Array, ...]
    b: Array
    sigma: float
    weight: float = 1.0

    def __post_init__(self) -> None:
        if any(a.shape[0] != len(self.b) for a in self.A):
            raise ValueError(f"{[a.shape for a in self.A]} does not fit {len(self.b)} limits")
        hinge_scale(self.sigma, self.weight)

    @property
    def dims(self) -> tuple[int, ...]:
        return tuple(a.shape[1] for a in self.A)

    @property
    def rows(self) -> int:
        return len(self.b)

    @cached_property
    def support(self) -> NDArray[np.intp]:
        return np.flatnonzero(np.concatenate(self.A, axis=1).any(axis=0))

    @cached_property
    def _hinge(self) -> Hinge:
        return Hinge(self.b, hinge_scale(self.sigma, self.weight), "above")

    def error(self, *x: Array) -> Array:
        return self._hinge.error(self._value(x))

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        e, slope = self._hinge.linearize(self._value(x), np.ones(1))
        return e, tuple(slope * a for a in self.A)

    def _value(self, x: tuple[Array, ...]) -> Array:
        terms = [xi @ a.T for a, xi in zip(self.A, x, strict=True)]
        return np.asarray(sum(terms[1:], terms[0]))


@dataclass(frozen=True, eq=False)
class CurvatureLimit(Residual):
    r"""e = √weight · max(0, radius·|ω| − |v|)/sigma on one state (x, y, θ, v, ω).

    A car turns only as it drives. Absolute values are rounded off within `AT_REST`, and equal at
    rest, where the limit is met.

    Args:
        radius: Smallest turning radius [m].
        sigma: [m/s]; inf switches the penalty off.
        weight: Exponent of the potential, dt/t_ref.

    Raises:
        ValueError: radius or sigma is not positive, or weight is negative.
    """

    radius: float
    sigma: float
    weight: float = 1.0

    def __post_init__(self) -> None:
        positive(radius=self.radius)
        hinge_scale(self.sigma, self.weight)

    @property
    def dims(self) -> tuple[int, ...]:
        return (5,)

    @property
    def rows(self) -> int:
        return 1

    @cached_property
    def support(self) -> NDArray[np.intp]:
        return np.array([3, 4])

    @cached_property
    def _hinge(self) -> Hinge:
        return Hinge(0.0, hinge_scale(self.sigma, self.weight), "above")

    def error(self, *x: Array) -> Array:
        return self._hinge.error(self._excess(x[0])[0])[..., None]

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        e, slope = self._hinge.linearize(*self._excess(x[0])[:2])
        J = np.zeros((*e.shape, 1, 5))
        J[..., 0, 3:] = slope
        return e[..., None], (J,)

    def expand(self, *x: Array) -> Expansion:
        excess, slope, second = self._excess(x[0])
        return self._hinge.expand(excess, slope, second[..., None] * np.eye(2))

    def _excess(self, x: Array) -> tuple[Array, Array, Array]:
        """radius·|ω| − |v|, its gradient (..., 2) and the diagonal of its Hessian (..., 2)."""
        moving = x[..., 3:] * np.array([1.0, self.radius])
        size = np.sqrt(moving**2 + AT_REST**2)
        sign = np.array([-1.0, self.radius])
        slope = sign * moving / size
        second = np.array([-1.0, self.radius**2]) * AT_REST**2 / size**3
        return size[..., 1] - size[..., 0], slope, second


@dataclass(frozen=True, eq=False)
class RestBetweenDirections(Residual):
    r"""e = √weight · max(0, −v_k v_{k+1})/sigma on two consecutive states (x, y, θ, v, ω).

    A car that changes direction is at rest at one of its states: there its wheels are straight,
    and the cone of its curvature is convex on either side of it.

    Args:
        sigma: Of the product of two speeds of opposite sign [m²/s²]; inf switches the penalty off.
        weight: Exponent of the potential, dt/t_ref.

    Raises:
        ValueError: sigma is not positive, or weight is negative.
    """

    sigma: float
    weight: float = 1.0

    def __post_init__(self) -> None:
        hinge_scale(self.sigma, self.weight)

    @property
    def dims(self) -> tuple[int, ...]:
        return (5, 5)

    @property
    def rows(self) -> int:
        return 1

    @cached_property
    def support(self) -> NDArray[np.intp]:
        return np.array([3, 8])

    @cached_property
    def _hinge(self) -> Hinge:
        return Hinge(0.0, hinge_scale(self.sigma, self.weight), "above")

    def error(self, *x: Array) -> Array:
        return self._hinge.error(-x[0][..., 3] * x[1][..., 3])[..., None]

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        e, slope = self._hinge.linearize(*self._product(*x))
        J = np.zeros((2, *e.shape, 1, 5))
        J[0, ..., 0, 3], J[1, ..., 0, 3] = slope[..., 0], slope[..., 1]
        return e[..., None], (J[0], J[1])

    def expand(self, *x: Array) -> Expansion:
        return self._hinge.expand(*self._product(*x), np.array([[0.0, -1.0], [-1.0, 0.0]]))

    def _product(self, before: Array, after: Array) -> tuple[Array, Array]:
        """−v_k v_{k+1} and its gradient (..., 2)."""
        v, w = before[..., 3], after[..., 3]
        return -v * w, -np.stack([w, v], axis=-1)


def _check(limit: float, dim: int) -> None:
    if not limit >= 0:
        raise ValueError(f"limit must not be negative, got {limit}")
    if dim < 2 or dim % 2:
        raise ValueError(f"a state has as many velocities as positions, got dim = {dim}")
