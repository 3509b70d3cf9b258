"""ψ_int: what it is worth for two bodies to keep apart."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from factors.pairwise import PairPotential
from factors.radial import Radial
from factors.residual import Array, positive


@dataclass(frozen=True, eq=False)
class Interaction(PairPotential):
    r"""ψ(Δ) = (1 − alpha exp(−‖Δ‖²/(2 h_c²)))^weight.

    As a whitened error it is √(−2 log ψ), which is smooth away from contact and has the right
    energy everywhere, so that Gauss–Newton solvers may use it; its true Hessian is indefinite.

    Args:
        alpha: Strength in [0, 1]; 1 makes contact impossible (ψ = 0, energy inf).
        h_c: Length [m].
        weight: Exponent of the potential, dt/t_ref.
        variance: Of the separation, isotropic [m²], added to h_c²: the uncertainty of a
            prediction. Broadcasts against the pairs (..., P); a leading step axis is sliced by
            `at`.

    Raises:
        ValueError: alpha outside [0, 1], h_c or weight not positive, a negative variance.

    Reference:
        Trautman and Krause, IROS 2010, eq. 5; in nats it is at most −log(1 − alpha).
    """

    alpha: float = 0.99
    h_c: float = 0.36
    weight: float = 1.0
    variance: Array | float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.alpha <= 1:
            raise ValueError(f"alpha must lie in [0, 1], got {self.alpha}")
        positive(h_c=self.h_c, weight=self.weight)
        if not np.all(np.asarray(self.variance) >= 0):
            raise ValueError("variance must not be negative")

    def at(self, step: int) -> Self:
        stepped = isinstance(self.variance, np.ndarray) and self.variance.ndim > 1
        return replace(self, variance=self.variance[step]) if stepped else self  # type: ignore[index]

    @cached_property
    def _s2(self) -> Array:
        return np.asarray(self.h_c**2 + self.variance)

    @cached_property
    def _exponent(self) -> Array:
        return -0.5 / self._s2

    @cached_property
    def _b_scale(self) -> Array:
        return np.asarray(-1.0 / self._s2)

    @cached_property
    def _slope_scale(self) -> Array:
        return -self.weight / self._s2

    def energy(self, d2: Array) -> Array:
        return self._energy(self._presence(d2))

    def linearize(self, d2: Array) -> tuple[Array, Array]:
        u = self._presence(d2)
        # e = √(2 weight u) s with s = √(−log(1 − u)/u), s → 1: no 0/0 where u underflows.
        small = u < 1e-8
        safe = np.where(small, 0.5, u)
        with np.errstate(divide="ignore"):
            s = np.where(small, 1 + 0.25 * u, np.sqrt(-np.log1p(-safe) / safe))
        root = np.sqrt(2 * self.weight * self.alpha) * np.exp((-0.25 / self._s2) * d2)
        # At contact with alpha = 1, s is inf and the slope, in the limit, too; 0 keeps NaN away.
        c = -0.5 * root / (np.maximum(1 - u, _TINY) * s * self._s2)
        return root * s, c

    def expand(self, d2: Array) -> Radial:
        u = self._presence(d2)
        energy = self._energy(u)
        rest = 1 - u
        if self.alpha > 1 - _TINY:
            np.maximum(rest, _TINY, out=rest)
        np.divide(1.0, rest, out=rest)
        u *= rest
        slope = u * self._slope_scale
        rest *= slope
        rest *= self._b_scale
        return Radial(energy, slope, slope, rest)

    def _energy(self, u: Array) -> Array:
        if self.alpha > 1 - _TINY:  # at contact: energy inf, as it should be
            with np.errstate(divide="ignore"):
                return np.asarray(-self.weight * np.log1p(-u))
        energy = np.log1p(np.negative(u))
        energy *= -self.weight
        return np.asarray(energy)

    def _presence(self, d2: Array) -> Array:
        """u = alpha exp(−d²/(2 s²)), between 0 and alpha."""
        u = np.multiply(self._exponent, d2)
        u = np.exp(u, out=u) if u.ndim else np.exp(u)
        u *= self.alpha
        return np.asarray(u)


_TINY = 1e-16
