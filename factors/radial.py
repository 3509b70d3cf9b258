"""Energies of a length: what pairs of bodies and limits on a norm have in common.

An energy of ‖Δ‖² has the gradient slope·Δ and the Hessian a·I + b·ΔΔᵀ: three numbers, whatever the
dimension of Δ. Vectors are kept as one array per component here, which numpy adds and multiplies
several times faster than arrays with a short last axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from factors.residual import Array, Expansion


class Radial(NamedTuple):
    """Expansion of energies of a length: energy, gradient slope·Δ, Hessian a·I + b·ΔΔᵀ, all of one
    shape (...)."""

    energy: Array
    slope: Array
    a: Array | float
    b: Array

    def plus(self, other: Radial) -> Radial:
        """Of the sum of two energies of one length."""
        return Radial(
            self.energy + other.energy,
            self.slope + other.slope,
            self.a + other.a,
            self.b + other.b,
        )

    def of(self, delta: Sequence[Array]) -> Expansion:
        """The expansion in Δ, given by its components, each of shape (...)."""
        m, shape = len(delta), self.energy.shape
        gradient, hessian = np.empty((*shape, m)), np.empty((*shape, m, m))
        for r in range(m):
            np.multiply(self.slope, delta[r], out=gradient[..., r])
            weighted = self.b * delta[r]
            np.multiply(weighted, delta[r], out=hessian[..., r, r])
            hessian[..., r, r] += self.a
            for c in range(r):
                np.multiply(weighted, delta[c], out=hessian[..., r, c])
                hessian[..., c, r] = hessian[..., r, c]
        return Expansion(self.energy, gradient, hessian)


def components(v: Array) -> list[Array]:
    """The components of vectors (..., m), each of shape (...)."""
    return [v[..., c] for c in range(v.shape[-1])]


def square(delta: Sequence[Array]) -> Array:
    """‖Δ‖², shape (...)."""
    total = delta[0] * delta[0]
    for d in delta[1:]:
        total += d * d
    return np.asarray(total)
