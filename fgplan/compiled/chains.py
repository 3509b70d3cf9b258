"""Many chains in a band, one beside the other, compiled: factors, products and vectors.

A band (rows, width, n) holds of n symmetric matrices the diagonal and what is below it; entry
(c, o, q) is that of chain q at row c + o and column c. A vector has shape (rows, n).
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from fgplan.compiled.kernel import reordered

Array = NDArray[np.float64]


@reordered()
def widen(chains: Array, wide: Array) -> None:
    """Copy n chains in a band (rows, width, n) to where there is room for more: those are
    identities, so that no loop over chains has a rest."""
    rows, width, n = chains.shape
    for c in range(rows):
        for o in range(width):
            for q in range(n):
                wide[c, o, q] = chains[c, o, q]
            for q in range(n, wide.shape[2]):
                wide[c, o, q] = 1.0 if o == 0 else 0.0


@reordered()
def softest(chains: Array) -> float:
    """What a position is held by at least."""
    least = np.inf
    for c in range(0, chains.shape[0], 2):
        for q in range(chains.shape[2]):
            least = min(least, chains[c, 0, q])
    return least


@reordered()
def factorise(A: Array) -> bool:
    """L with L Lᵀ = H of n chains in a band (rows, width, n), in place, its diagonal inverted."""
    rows, width, n = A.shape
    for c in range(rows):
        least = np.inf
        for q in range(n):
            least = min(least, A[c, 0, q])
        if not least > 0:
            return False
        for q in range(n):
            A[c, 0, q] = 1 / sqrt(A[c, 0, q])
        for o in range(1, width):
            for q in range(n):
                A[c, o, q] *= A[c, 0, q]
        for o in range(1, min(width, rows - c)):
            for e in range(o, width):
                for q in range(n):
                    A[c + o, e - o, q] -= A[c, o, q] * A[c, e, q]
    return True


@reordered()
def solve(L: Array, x: Array) -> None:
    """x ← (L Lᵀ)⁻¹ x, with the L of `factorise`; x has shape (rows, n)."""
    rows, width, n = L.shape
    for c in range(rows):
        for q in range(n):
            x[c, q] *= L[c, 0, q]
        for o in range(1, min(width, rows - c)):
            for q in range(n):
                x[c + o, q] -= L[c, o, q] * x[c, q]
    for c in range(rows - 1, -1, -1):
        for o in range(1, min(width, rows - c)):
            for q in range(n):
                x[c, q] -= L[c, o, q] * x[c + o, q]
        for q in range(n):
            x[c, q] *= L[c, 0, q]


@reordered()
def multiply(H: Array, x: Array, y: Array) -> None:
    """y ← H x of n chains in a band (rows, width, n)."""
    rows, width, n = H.shape
    for c in range(rows):
        for q in range(n):
            y[c, q] = H[c, 0, q] * x[c, q]
    for c in range(rows):
        for o in range(1, min(width, rows - c)):
            for q in range(n):
                y[c + o, q] += H[c, o, q] * x[c, q]
                y[c, q] += H[c, o, q] * x[c + o, q]


@reordered()
def fill(x: Array, value: float) -> None:
    for r in range(x.shape[0]):
        for q in range(x.shape[1]):
            x[r, q] = value


@reordered()
def copy(x: Array, y: Array) -> None:
    """y ← x, as many columns as y has. Slices say the same, and take seconds to compile."""
    for r in range(y.shape[0]):
        for q in range(y.shape[1]):
            y[r, q] = x[r, q]


@reordered()
def downwards(g: Array, r: Array) -> None:
    """r ← −g, and 0 in columns that g does not have."""
    for c in range(r.shape[0]):
        for q in range(g.shape[1]):
            r[c, q] = -g[c, q]
        for q in range(g.shape[1], r.shape[1]):
            r[c, q] = 0.0


@reordered()
def dot(a: Array, b: Array) -> float:
    total = 0.0
    for r in range(a.shape[0]):
        for q in range(a.shape[1]):
            total += a[r, q] * b[r, q]
    return total


@reordered()
def along(x: Array, share: float, d: Array) -> None:
    """x ← x + share d."""
    for r in range(x.shape[0]):
        for q in range(x.shape[1]):
            x[r, q] += share * d[r, q]


@reordered()
def onto(d: Array, share: float, z: Array) -> None:
    """d ← z + share d."""
    for r in range(d.shape[0]):
        for q in range(d.shape[1]):
            d[r, q] = z[r, q] + share * d[r, q]


@reordered()
def keep(x: Array, free: Array) -> None:
    """x ← x where it is free, else 0."""
    for r in range(x.shape[0]):
        for q in range(x.shape[1]):
            x[r, q] *= free[r, q]
