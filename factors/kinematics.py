"""What the robot can do: speed and acceleration limits, as one-sided penalties."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from factors.hinge import Hinge, expand_norm, hinge_scale, linearize_norm, norm
from factors.residual import Array, Expansion, Residual


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
        return self._hinge.expand(*expand_norm(self._velocity(x[0])))

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

    limit: float
    sigma: float
    dt: float
    weight: float = 1.0
    dim: int = 4

    def __post_init__(self) -> None:
        _check(self.limit, self.dim)
        hinge_scale(self.sigma, self.weight)
        if not (np.isfinite(self.dt) and self.dt > 0):
            raise ValueError(f"dt must be positive, got {self.dt}")

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
        energy, slope, H = self._hinge.expand(*expand_norm(self._change(*x)))
        m = self.dim // 2
        hessian = np.empty((*energy.shape, 2 * m, 2 * m))
        hessian[..., :m, :m] = hessian[..., m:, m:] = H
        hessian[..., :m, m:] = hessian[..., m:, :m] = -H
        return Expansion(energy, np.concatenate([-slope, slope], axis=-1), hessian)

    def _change(self, before: Array, after: Array) -> Array:
        m = self.dim // 2
        return np.asarray(after[..., m:] - before[..., m:])


def _check(limit: float, dim: int) -> None:
    if not limit >= 0:
        raise ValueError(f"limit must not be negative, got {limit}")
    if dim < 2 or dim % 2:
        raise ValueError(f"a state has as many velocities as positions, got dim = {dim}")
