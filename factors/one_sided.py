"""One-sided penalties on a scalar of the state, open or behind a gate, with their true Hessian."""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from factors.hinge import hinge_scale
from factors.residual import Array, Expansion, Residual


class Scalar(NamedTuple):
    """A function of a state: value (...), gradient (..., s) and Hessian (..., s, s) over the
    components of the residual's support."""

    value: Array
    gradient: Array
    hessian: Array


class OneSided(Residual):
    r"""e = scale · g · max(0, excess), with excess and gate g scalars of the state; g = 1 is open.

    Subclasses say what `excess` is, and `gate` where there is one. The energy ½e² has a continuous
    gradient; on the threshold the slope is the steep one, as for `factors.hinge.Hinge`.
    """

    @property
    @abstractmethod
    def scale(self) -> float:
        """√weight/sigma."""

    @abstractmethod
    def excess(self, *x: Array) -> Scalar:
        """How far the limit is exceeded, negative within it."""

    def gate(self, *x: Array) -> Scalar | None:
        """How much it counts there; None: always."""
        return None

    @property
    def rows(self) -> int:
        return 1

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        e, slope, _ = self._parts(*x)
        J = np.zeros((*e.shape, 1, sum(self.dims)))
        J[..., 0, self.support] = slope
        return e[..., None], tuple(np.split(J, np.cumsum(self.dims)[:-1], axis=-1))

    def expand(self, *x: Array) -> Expansion:
        e, slope, bend = self._parts(*x)
        hessian = slope[..., :, None] * slope[..., None, :] + e[..., None, None] * bend
        return Expansion(0.5 * e**2, e[..., None] * slope, hessian)

    def _parts(self, *x: Array) -> tuple[Array, Array, Array]:
        """e (...), its gradient (..., s) and its Hessian (..., s, s)."""
        over = self.excess(*x)
        on = self.scale * (over.value >= 0)
        h = on * over.value
        dh = on[..., None] * over.gradient
        ddh = on[..., None, None] * over.hessian
        g = self.gate(*x)
        if g is None:
            return h, dh, ddh
        cross = g.gradient[..., :, None] * dh[..., None, :]
        return (
            g.value * h,
            g.gradient * h[..., None] + g.value[..., None] * dh,
            g.hessian * h[..., None, None]
            + cross
            + np.swapaxes(cross, -1, -2)
            + g.value[..., None, None] * ddh,
        )


class OnPosition(OneSided):
    """One-sided in a position, the first two components of a state.

    Attributes:
        sigma: [m]; inf switches the penalty off.
        weight: Exponent of the potential.
        dim: Size of the state.
    """

    sigma: float
    weight: float
    dim: int

    def __post_init__(self) -> None:
        hinge_scale(self.sigma, self.weight)  # raises where they make no sense

    @property
    def dims(self) -> tuple[int, ...]:
        return (self.dim,)

    @property
    def support(self) -> NDArray[np.intp]:
        return np.arange(2)

    @property
    def scale(self) -> float:
        return hinge_scale(self.sigma, self.weight)


def directed(place: Array, direction: Array) -> tuple[Array, Array]:
    """A place and a direction of length 1, both (2,), or both (S, 2) where one of them is.

    Raises:
        ValueError: a direction is 0.
    """
    both = np.broadcast_arrays(np.asarray(place, dtype=float), np.asarray(direction, dtype=float))
    size = np.linalg.norm(both[1], axis=-1, keepdims=True)
    if not np.all(size > 0):
        raise ValueError(f"direction must not be 0, got {direction}")
    return both[0], both[1] / size


def affine(value: Array, gradient: Array) -> Scalar:
    """A scalar without curvature; the gradient (s,) or (..., s) holds everywhere."""
    slope = np.broadcast_to(gradient, (*value.shape, gradient.shape[-1]))
    return Scalar(value, slope, np.zeros((*slope.shape, slope.shape[-1])))
