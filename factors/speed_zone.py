"""A region in which to go slowly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.hinge import hinge_scale, linearize_norm
from factors.one_sided import OneSided, Scalar
from factors.residual import Array
from factors.shape import Shape


@dataclass(frozen=True, eq=False)
class SpeedZone(OneSided):
    r"""e = √weight · g(d(p)) · max(0, ‖v‖ − limit)/sigma, d the signed distance to a region.

    The gate g = 1/(1 + exp(d/blend)) goes from 1 inside to 0 outside: the robot is slow when it
    comes in.

    Args:
        shape: The region.
        limit: Highest speed in it without penalty [m/s].
        blend: Width of the rim over which it begins [m].
        sigma: [m/s]; inf switches the penalty off.
        weight: Exponent of the potential, dt/t_ref.

    Raises:
        ValueError: limit or weight is negative, or sigma or blend is not positive.
    """

    shape: Shape
    limit: float
    blend: float = 0.2
    sigma: float = 0.05
    weight: float = 1.0

    def __post_init__(self) -> None:
        hinge_scale(self.sigma, self.weight)
        if not self.limit >= 0:
            raise ValueError(f"limit must not be negative, got {self.limit}")
        if not self.blend > 0:
            raise ValueError(f"blend must be positive, got {self.blend}")

    @property
    def dims(self) -> tuple[int, ...]:
        return (4,)

    @property
    def scale(self) -> float:
        return hinge_scale(self.sigma, self.weight)

    def excess(self, *x: Array) -> Scalar:
        speed, u = linearize_norm(x[0][..., 2:])
        bend = (np.eye(2) - u[..., :, None] * u[..., None, :]) / speed[..., None, None]
        return Scalar(speed - self.limit, *_placed(u, bend, 2))

    def gate(self, *x: Array) -> Scalar:
        d, slope, bend = self.shape.expand(x[0][..., :2])
        g = 1 / (1 + np.exp(np.clip(d / self.blend, -700, 700)))
        first = -g * (1 - g) / self.blend
        second = g * (1 - g) * (1 - 2 * g) / self.blend**2
        outer = slope[..., :, None] * slope[..., None, :]
        bend = second[..., None, None] * outer + first[..., None, None] * bend
        return Scalar(g, *_placed(first[..., None] * slope, bend, 0))


def _placed(gradient: Array, hessian: Array, at: int) -> tuple[Array, Array]:
    """Derivatives in two components of a state of four, as those of all four."""
    whole = np.zeros((*gradient.shape[:-1], 4))
    whole[..., at : at + 2] = gradient
    square = np.zeros((*whole.shape, 4))
    square[..., at : at + 2, at : at + 2] = hessian
    return whole, square
