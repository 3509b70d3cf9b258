"""Newton steps of many chains, compiled: blocks are added into a band, which is then factorised.

A band is cut into tiles of as many columns as a vector register has numbers. A tile (PANEL, length)
holds each of its columns from the same row on, that of its first: whatever is taken from a column
is then at the same place in its tile, at a whole number of registers, and one load serves two
columns. The factorisation is L D Lᵀ, that needs no roots, a tile at a time: bands about 40 wide
take 1.6 times as long column by column, and three times as long by LAPACK's `dpbtrf`.
"""

from __future__ import annotations

from math import inf

import numpy as np
from numpy.typing import NDArray

from fgplan.compiled.kernel import (
    BOOL,
    INT,
    REGISTER,
    apart,
    exact,
    given,
    packed,
    reordered,
    result,
)

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]
Columns = tuple[Array, ...]
Factors = tuple[float, ...]

PANEL = REGISTER
"""Columns of a tile: what is unrolled here is written for as many."""


def shape(rows: int, width: int) -> tuple[int, int, int]:
    """Of the tiles of a lower band: tiles, columns, rows.

    Args:
        rows: Of the matrix.
        width: Of its lower band, the diagonal included.
    """
    whole = -(-(width - 1) // PANEL) * PANEL
    return -(-rows // PANEL), PANEL, PANEL + whole


def laid(bands: Array) -> Array:
    """Bands (K, rows, width) in tiles (K, *shape).

    Entry (row, column) of a band is at (column, row − column). What a matrix has too few rows for
    is that of an identity.
    """
    K, rows, width = bands.shape
    tiles = np.zeros((K, *shape(rows, width)))
    for q in range(PANEL):
        columns = bands[:, q::PANEL]
        tiles[:, : columns.shape[1], q, q : q + width] = columns
        tiles[:, columns.shape[1] :, q, q] = 1.0
    return tiles


@exact(result(4), packed(4), INT, INT, packed(1, INT))
def add(tiles: Array, part: Array, first: int, stride: int, places: Index) -> None:
    """Add symmetric blocks (B, steps, s, s) into tiles (B, *shape); `places` (s,) are the rows of
    the first block, those of the next one are `stride` further."""
    for b in range(part.shape[0]):
        for k in range(part.shape[1]):
            for r in range(len(places)):
                row = first + k * stride + places[r]
                for c in range(r + 1):
                    column = first + k * stride + places[c]
                    p = min(row, column) // PANEL
                    q, at = min(row, column) - p * PANEL, max(row, column) - p * PANEL
                    tiles[b, p, q, at] += part[b, k, r, c]


@apart()
def _less_one(column: Array, p: Array, f: float) -> None:
    """Take f times a column from another one; all (n,)."""
    for i in range(len(column)):
        column[i] -= f * p[i]


@apart()
def _less_two(one: Array, two: Array, p: Array, q: Array, f: Factors, g: Factors) -> None:
    """Take two columns, f and g times each, from two others; all (n,)."""
    f0, f1, g0, g1 = *f, *g
    for i in range(len(one)):
        a, b = p[i], q[i]
        one[i] -= f0 * a + f1 * b
        two[i] -= g0 * a + g1 * b


@apart()
def _less_all(column: Array, p: Columns, f: Factors) -> None:
    """Take PANEL columns, f times each, from another one; all (n,)."""
    p0, p1, p2, p3, p4, p5, p6, p7 = p
    f0, f1, f2, f3, f4, f5, f6, f7 = f
    for i in range(len(column)):
        near = f0 * p0[i] + f1 * p1[i] + f2 * p2[i] + f3 * p3[i]
        column[i] -= near + f4 * p4[i] + f5 * p5[i] + f6 * p6[i] + f7 * p7[i]


@apart()
def _less_all_twice(one: Array, two: Array, p: Columns, f: Factors, g: Factors) -> None:
    """Take PANEL columns, f and g times each, from two others; all (n,)."""
    p0, p1, p2, p3, p4, p5, p6, p7 = p
    f0, f1, f2, f3, f4, f5, f6, f7 = f
    g0, g1, g2, g3, g4, g5, g6, g7 = g
    for i in range(len(one)):
        a0, a1, a2, a3, a4, a5, a6, a7 = p0[i], p1[i], p2[i], p3[i], p4[i], p5[i], p6[i], p7[i]
        near = f0 * a0 + f1 * a1 + f2 * a2 + f3 * a3
        one[i] -= near + f4 * a4 + f5 * a5 + f6 * a6 + f7 * a7
        near = g0 * a0 + g1 * a1 + g2 * a2 + g3 * a3
        two[i] -= near + g4 * a4 + g5 * a5 + g6 * a6 + g7 * a7


@apart()
def _less_tile(theirs: Array, tile: Array, at: int) -> None:
    """What a tile takes from the one that begins at its row `at`, two columns at a time."""
    n = tile.shape[1] - at
    d0, d1, d2, d3 = tile[0, 0], tile[1, 1], tile[2, 2], tile[3, 3]
    d4, d5, d6, d7 = tile[4, 4], tile[5, 5], tile[6, 6], tile[7, 7]
    p0, p1, p2, p3 = tile[0, at:], tile[1, at:], tile[2, at:], tile[3, at:]
    p4, p5, p6, p7 = tile[4, at:], tile[5, at:], tile[6, at:], tile[7, at:]
    for q in range(0, PANEL, 2):
        r = q + 1
        f = p0[q] * d0, p1[q] * d1, p2[q] * d2, p3[q] * d3
        g = p0[r] * d0, p1[r] * d1, p2[r] * d2, p3[r] * d3
        f4 = p4[q] * d4, p5[q] * d5, p6[q] * d6, p7[q] * d7
        g4 = p4[r] * d4, p5[r] * d5, p6[r] * d6, p7[r] * d7
        p = p0, p1, p2, p3, p4, p5, p6, p7
        _less_all_twice(theirs[q, :n], theirs[r, :n], p, (*f, *f4), (*g, *g4))


@apart()
def _substitute(x: Array, tile: Array) -> None:
    """What the columns of a tile take from right-hand sides (length,)."""
    for q in range(PANEL):
        factor = x[q] * tile[q, q]
        for o in range(q + 1, PANEL):
            x[o] -= factor * tile[q, o]
    p = tile[0, PANEL:], tile[1, PANEL:], tile[2, PANEL:], tile[3, PANEL:]
    p4 = tile[4, PANEL:], tile[5, PANEL:], tile[6, PANEL:], tile[7, PANEL:]
    f = x[0] * tile[0, 0], x[1] * tile[1, 1], x[2] * tile[2, 2], x[3] * tile[3, 3]
    f4 = x[4] * tile[4, 4], x[5] * tile[5, 5], x[6] * tile[6, 6], x[7] * tile[7, 7]
    _less_all(x[PANEL:], (*p, *p4), (*f, *f4))


@apart()
def _dot(a: Array, b: Array) -> float:
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@apart()
def _factorise_tile(tile: Array) -> bool:
    """L D in place of the columns of a tile, D inverted; whether D is positive."""
    for q in range(0, PANEL, 2):
        one, two = tile[q], tile[q + 1]
        for r in range(0, q, 2):
            p, d = tile[r], tile[r, r]
            o, e = tile[r + 1], tile[r + 1, r + 1]
            f, g = (p[q] * d, o[q] * e), (p[q + 1] * d, o[q + 1] * e)
            _less_two(one, two, p, o, f, g)
        if not 0 < one[q] < inf:
            return False
        one[q] = 1 / one[q]
        _less_one(two, one, one[q + 1] * one[q])
        if not 0 < two[q + 1] < inf:
            return False
        two[q + 1] = 1 / two[q + 1]
    return True


@apart()
def _factorise(tiles: Array, x: Array) -> bool:
    """L D and D⁻¹ with L D Lᵀ = H in place of tiles, and x ← L⁻¹ x; whether H is positive
    definite."""
    count, _, length = tiles.shape
    for p in range(count):
        tile = tiles[p]
        if not _factorise_tile(tile):
            return False
        _substitute(x[PANEL * p : PANEL * p + length], tile)
        for ahead in range(1, min(length // PANEL, count - p)):
            _less_tile(tiles[p + ahead], tile, PANEL * ahead)
    return True


@apart()
def _back_substitute(tiles: Array, x: Array) -> None:
    """x ← L⁻ᵀ D⁻¹ x, with what `_factorise` leaves."""
    count, _, length = tiles.shape
    for p in range(count - 1, -1, -1):
        tile, own = tiles[p], x[PANEL * p : PANEL * p + length]
        for q in range(PANEL - 1, -1, -1):
            own[q] -= _dot(tile[q, PANEL:], own[PANEL:])
        for q in range(PANEL - 1, -1, -1):
            for o in range(q + 1, PANEL):
                own[q] -= tile[q, o] * own[o]
            own[q] *= tile[q, q]


@reordered(result(4), given(3), given(1, INT), result(3), result(1, BOOL))
def solve(tiles: Array, gradient: Array, order: Index, step: Array, definite: Mask) -> None:
    """Steps −H⁻¹ g of all chains, zero where H is not positive definite.

    Args:
        tiles: H, shape (B, *shape); overwritten.
        gradient: g, shape (B, S, D).
        order: Place of each coordinate within a time step, shape (D,).
        step: Is given the steps, shape (B, S, D).
        definite: Is told where H is positive definite, shape (B,).
    """
    count, _, length = tiles.shape[1:]
    size, x = len(order), np.empty(PANEL * (count - 1) + length)
    for b in range(len(tiles)):
        x[:] = 0.0
        for k in range(gradient.shape[1]):
            for c in range(size):
                x[k * size + order[c]] = -gradient[b, k, c]
        definite[b] = _factorise(tiles[b], x)
        if definite[b]:
            _back_substitute(tiles[b], x)
        else:
            x[:] = 0.0
        for k in range(gradient.shape[1]):
            for c in range(size):
                step[b, k, c] = x[k * size + order[c]]
