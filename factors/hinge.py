"""One-sided penalties on a distance or a speed, with their true curvature."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from factors.radial import Radial
from factors.residual import Array, Expansion

# Smooths the norm at the origin [m, or m/s]. A micrometre keeps every number finite where two
# positions coincide and changes a distance of half a metre by less than 1e-12.
TINY = 1e-6


@dataclass(frozen=True, eq=False)
class Hinge:
    r"""e = scale · max(0, ±(d − threshold)) of a scalar d(p), e.g. a distance or a speed.

    The energy is ½e², so its gradient is continuous across the threshold.

    Args:
        threshold: Where the penalty starts; a number, or an array that broadcasts against d.
        scale: √weight/sigma: sigma in the unit of d, weight the exponent dt/t_ref. 0 switches
            the hinge off.
        side: "above" penalises d > threshold (a limit), "below" d < threshold (a clearance).
    """

    threshold: float | Array
    scale: float
    side: Literal["above", "below"]

    def error(self, d: Array) -> Array:
        """e, the shape of d."""
        e = d - self.threshold
        e *= self._slope
        return np.asarray(np.maximum(e, 0.0))

    def linearize(self, d: Array, gradient: Array) -> tuple[Array, Array]:
        """e (...) and de/dp (..., m), from d (...) and its gradient (..., m)."""
        excess = self._slope * (d - self.threshold)
        # On the threshold the slope is the steep one, as in GPMP2: a solver sees what is coming.
        slope = np.where(excess >= 0, self._slope, 0.0)
        return np.maximum(0.0, excess), slope[..., None] * gradient

    def gauss_newton(self, d: Array, gradient: Array) -> Expansion:
        """½e² with its gradient (..., m) and de deᵀ (..., m, m), without the curvature of d."""
        e, de = self.linearize(d, gradient)
        return Expansion(0.5 * e**2, e[..., None] * de, de[..., :, None] * de[..., None, :])

    def expand(self, d: Array, gradient: Array, hessian: Array) -> Expansion:
        """½e² with its gradient (..., m) and true Hessian (..., m, m) in p."""
        flat = self.gauss_newton(d, gradient)
        # e is 0 wherever the hinge is off, so no mask is needed for the curvature of d.
        curvature = (self._slope * self.error(d))[..., None, None] * hessian
        return flat._replace(hessian=flat.hessian + curvature)

    def energy_of(self, d2: Array) -> Array:
        """½e² of a length √(d2 + TINY²), shape (...)."""
        d = np.asarray(d2 + TINY**2)  # an array also where it is one number: it is written to
        e = self.error(np.sqrt(d, out=d))
        e *= e
        e *= 0.5
        return e

    def radial(self, d2: Array) -> Radial:
        """½e² of a length d = √(d2 + TINY²), with its true curvature, as an energy of d2 (...)."""
        inverse = np.asarray(d2 + TINY**2)
        d = np.sqrt(inverse)
        np.divide(1.0, d, out=inverse)
        e = np.asarray(d - self.threshold)
        e *= self._slope
        second = np.where(e >= 0, self.scale**2, 0.0)
        np.maximum(e, 0.0, out=e)
        slope = e * inverse
        slope *= self._slope
        second -= slope
        second *= inverse
        second *= inverse
        e *= e
        e *= 0.5
        return Radial(e, slope, slope, second)

    @cached_property
    def _slope(self) -> float:
        return self.scale if self.side == "above" else -self.scale


def hinge_scale(sigma: float, weight: float = 1.0) -> float:
    """√weight/sigma, the factor that whitens a hinge whose energy carries the exponent weight.

    Raises:
        ValueError: sigma is not positive (inf is allowed and switches the hinge off), or weight
            is negative or not finite.
    """
    if not sigma > 0:
        raise ValueError(f"sigma must be positive, got {sigma}")
    if not 0 <= weight < np.inf:
        raise ValueError(f"weight must be a number that is not negative, got {weight}")
    return float(np.sqrt(weight) / sigma)


def norm(v: Array) -> Array:
    r"""√(‖v‖² + TINY²), shape (...): the length of v (..., m), smooth at v = 0."""
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", v, v) + TINY**2))


def linearize_norm(v: Array) -> tuple[Array, Array]:
    """`norm` and its gradient v/‖v‖, shape (..., m); zero at v = 0."""
    length = norm(v)
    return length, v / length[..., None]
