"""A region to be in at a time between two states: deadlines and time windows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from factors.gp_prior import GPPrior
from factors.hinge import hinge_scale
from factors.one_sided import OneSided, Scalar
from factors.residual import Array
from factors.shape import Shape


@dataclass(frozen=True, eq=False)
class Arrival(OneSided):
    r"""e = max(0, d(p(τ)) + margin)/sigma, p(τ) = position of Λ(τ) x_k + Ψ(τ) x_{k+1}.

    The place between the two states is their mean under white noise on acceleration. It is one
    event, so it carries no exponent of the time step.

    Args:
        shape: The region.
        dt: Time between the two states [s].
        tau: Time of the event after the first one, 0 ≤ tau ≤ dt [s].
        margin: How deep inside to be [m].
        sigma: [m]; inf switches the penalty off.

    Raises:
        ValueError: sigma or dt is not positive, or tau lies outside the interval.

    Reference:
        Barfoot, Tong, Särkkä, RSS 2014, section III-D, for Λ and Ψ.
    """

    shape: Shape
    dt: float
    tau: float
    margin: float = 0.0
    sigma: float = 0.1

    def __post_init__(self) -> None:
        hinge_scale(self.sigma)
        _ = self._weights

    @property
    def dims(self) -> tuple[int, ...]:
        return (4, 4)

    @property
    def scale(self) -> float:
        return hinge_scale(self.sigma)

    @cached_property
    def _weights(self) -> Array:
        """Of both states in the position, shape (2, 8)."""
        Lambda, Psi = GPPrior(self.dt, np.eye(2)).interpolate(self.tau)
        return np.hstack([Lambda[:2], Psi[:2]])

    def excess(self, *x: Array) -> Scalar:
        W = self._weights
        d, gradient, hessian = self.shape.expand(np.concatenate(x, axis=-1) @ W.T)
        return Scalar(d + self.margin, gradient @ W, W.T @ hessian @ W)
