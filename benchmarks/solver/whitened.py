"""L-BFGS in coordinates in which the linear-Gaussian part of the density is white."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky_banded, lapack
from scipy.optimize import minimize

from fgplan.assembly import Assembly
from fgplan.block_tridiagonal import Chains

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Whitening:
    """x = reference + L⁻ᵀ y, with L Lᵀ the constant Hessian of one hypothesis.

    Args:
        assembly: The density.
        which: The hypothesis.
    """

    assembly: Assembly
    which: int

    def __post_init__(self) -> None:
        chain = Chains.of(*self.assembly.held_hessian(np.array([self.which])))
        object.__setattr__(self, "_L", cholesky_banded(chain.data[0].T, lower=True))

    def state(self, y: Array) -> Array:
        """The state (S, D) at y (S·D,)."""
        reference = self.assembly.reference[self.which]
        return reference + self._backward(y, "T").reshape(reference.shape)

    def coordinates(self, state: Array) -> Array:
        """y of a state: Lᵀ (x − reference)."""
        d = (state - self.assembly.reference[self.which]).ravel()
        L, y = self._L, np.zeros_like(d)  # type: ignore[attr-defined]
        for below in range(len(L)):
            y[: len(d) - below] += L[below, : len(d) - below] * d[below:]
        return y

    def gradient(self, gradient: Array) -> Array:
        """L⁻¹ g of a gradient (S, D) in x."""
        return self._backward(gradient.ravel(), "N")

    def _backward(self, b: Array, transposed: str) -> Array:
        solution, info = lapack.dtbtrs(self._L, b[:, None], uplo="L", trans=transposed)  # type: ignore[attr-defined]
        assert info == 0
        return solution[:, 0]


def minimise(assembly: Assembly, start: Array, which: int, most: int = 1000) -> tuple[Array, int]:
    """A local optimum (S, D) from a start, and the number of evaluations.

    Args:
        assembly: The density.
        start: Shape (S, D).
        which: The hypothesis.
        most: Iterations at most.
    """
    white, index = Whitening(assembly, which), np.array([which])

    def energy(y: Array) -> tuple[float, Array]:
        q = assembly.expand(white.state(y)[None], index)
        return float(q.energy[0]), white.gradient(q.gradient[0])

    options = {"maxiter": most, "maxfun": 2 * most, "ftol": 1e-12, "gtol": 1e-4, "maxcor": 20}
    found = minimize(energy, white.coordinates(start), jac=True, method="L-BFGS-B", options=options)
    return white.state(found.x), int(found.nfev)
