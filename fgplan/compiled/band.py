"""Newton steps of many chains, compiled: blocks are added into a band, which is then factorised.

The band is that of `fgplan.block_tridiagonal.Chains`: entry (row, column) is at (column, row −
column). Its Cholesky factor is found a panel of columns at a time, as in LAPACK's `dpbtrf`, which
takes 1.7 times as long where a band is 40 to 60 wide.
"""

from __future__ import annotations

from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray

from fgplan.compiled.kernel import BOOL, INT, exact, given, reordered, result

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]

PANEL = 8
"""Columns of a panel: `_less_panel` is written for as many."""
HALF = 4


@exact(result(3), given(4), INT, INT, given(1, INT))
def add(band: Array, part: Array, first: int, stride: int, places: Index) -> None:
    """Add symmetric blocks (B, steps, s, s) into bands (B, rows, width); `places` (s,) are the rows
    of the first block, those of the next one are `stride` further."""
    for b in range(part.shape[0]):
        for k in range(part.shape[1]):
            for r in range(len(places)):
                row = first + k * stride + places[r]
                for c in range(r + 1):
                    column = first + k * stride + places[c]
                    band[b, min(row, column), abs(row - column)] += part[b, k, r, c]


@exact(given(2), given(2), given(2, INT), given(2, INT), given(3), result(3))
def multiply(
    diagonal: Array, upper: Array, own: Index, links: Index, d: Array, product: Array
) -> None:
    """Add H d, of a chain of which most entries are zero.

    Args:
        diagonal: Entries `own` of the blocks (k, k), shape (S, m).
        upper: Entries `links` of the blocks (k, k + 1), shape (S − 1, m').
        own, links: Row and column of each, shapes (m, 2) and (m', 2).
        d: Shape (N, S, D).
        product: What it is added to, of the same shape.
    """
    for n in range(d.shape[0]):
        for k in range(d.shape[1]):
            for e in range(len(own)):
                product[n, k, own[e, 0]] += diagonal[k, e] * d[n, k, own[e, 1]]
        for k in range(d.shape[1] - 1):
            for e in range(len(links)):
                a, b = links[e]
                product[n, k, a] += upper[k, e] * d[n, k + 1, b]
                product[n, k + 1, b] += upper[k, e] * d[n, k, a]


@reordered()
def _less_half(columns: Array, panel: Array) -> None:
    """What the first half of a panel takes from the columns of its second half."""
    width = columns.shape[1]
    for t in range(len(columns)):
        s, column = HALF + t, columns[t]
        f0, f1, f2, f3 = panel[0, s], panel[1, s], panel[2, s], panel[3, s]
        p0, p1, p2, p3 = panel[0, s:], panel[1, s:], panel[2, s:], panel[3, s:]
        for o in range(width):
            column[o] -= f0 * p0[o] + f1 * p1[o] + f2 * p2[o] + f3 * p3[o]


@reordered()
def _less_panel(columns: Array, panel: Array) -> None:
    """What a panel takes from the columns after it."""
    width = columns.shape[1]
    for t in range(len(columns)):
        s = PANEL + t
        column = columns[t, : min(width, width + PANEL - 1 - s)]
        f0, f1, f2, f3 = panel[0, s], panel[1, s], panel[2, s], panel[3, s]
        f4, f5, f6, f7 = panel[4, s], panel[5, s], panel[6, s], panel[7, s]
        p0, p1, p2, p3 = panel[0, s:], panel[1, s:], panel[2, s:], panel[3, s:]
        p4, p5, p6, p7 = panel[4, s:], panel[5, s:], panel[6, s:], panel[7, s:]
        for o in range(len(column)):
            near = f0 * p0[o] + f1 * p1[o] + f2 * p2[o] + f3 * p3[o]
            column[o] -= near + f4 * p4[o] + f5 * p5[o] + f6 * p6[o] + f7 * p7[o]


@reordered()
def _back_substitute(L: Array, x: Array) -> None:
    """x ← L⁻ᵀ x, with the L of `_factorise`."""
    rows, width = L.shape
    for r in range(rows - 1, -1, -1):
        column, rest, total = L[r], x[r:], 0.0
        for o in range(1, min(width, rows - r)):
            total += column[o] * rest[o]
        x[r] = (x[r] - total) * column[0]


@reordered()
def _factorise(A: Array, x: Array, panel: Array) -> bool:
    """L with L Lᵀ = H in place, its diagonal inverted, and x ← L⁻¹ x; whether H is positive
    definite.

    The panel (PANEL, width + PANEL) is zero where no column of it has entries: row q holds column
    q, from its place q on.
    """
    rows, width = A.shape
    for first in range(0, rows, PANEL):
        last = min(first + PANEL, rows)
        for q in range(last - first):
            if q == HALF:
                _less_half(A[first + HALF : last], panel)
            column = A[first + q]
            for r in range(q - q % HALF, q):
                factor, other = panel[r, q], panel[r, q:]
                for o in range(width):
                    column[o] -= factor * other[o]
            if not 0 < column[0] < inf:
                return False
            inverse, own = 1 / sqrt(column[0]), panel[q, q:]
            for o in range(width):
                column[o] *= inverse
                own[o] = column[o]
            column[0] = inverse  # all that is asked of the diagonal from here on
            x[first + q] *= inverse
            known, rest = x[first + q], x[first + q :]
            for o in range(1, min(width, rows - first - q)):
                rest[o] -= known * column[o]
        _less_panel(A[last : last - 1 + width], panel)
    return True


@reordered(result(3), given(3), given(1, INT), result(3), result(1, BOOL))
def solve(band: Array, gradient: Array, order: Index, step: Array, definite: Mask) -> None:
    """Steps −H⁻¹ g of all chains, zero where H is not positive definite.

    Args:
        band: H, shape (B, rows, width); overwritten.
        gradient: g, shape (B, S, D).
        order: Place of each coordinate within a time step, shape (D,).
        step: Is given the steps, shape (B, S, D).
        definite: Is told where H is positive definite, shape (B,).
    """
    B, rows, width = band.shape
    size = len(order)
    panel, x = np.zeros((PANEL, width + PANEL)), np.empty(rows)
    for b in range(B):
        for k in range(gradient.shape[1]):
            for c in range(size):
                x[k * size + order[c]] = -gradient[b, k, c]
        definite[b] = _factorise(band[b], x, panel)
        if definite[b]:
            _back_substitute(band[b], x)
        else:
            x[:] = 0.0
        for k in range(gradient.shape[1]):
            for c in range(size):
                step[b, k, c] = x[k * size + order[c]]
