"""Newton steps by preconditioned conjugate gradients, compiled: products cost what pairs there are.

Without the pairs every body is a chain of its own, and those chains are what the system is
preconditioned by, each with what its pairs curve upwards. Where a direction is met along which the
energy curves downwards, the step so far is what is left (Steihaug), the first direction at least.

References:
    Steihaug, The conjugate gradient method and trust regions in large scale optimization, SIAM
    Journal on Numerical Analysis 20(3), 1983.
    Eisenstat, Efficient implementation of a class of preconditioned conjugate gradient methods,
    SIAM Journal on Scientific and Statistical Computing 2(1), 1981.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from fgplan.compiled.chains import (
    along,
    copy,
    dot,
    downwards,
    factorise,
    fill,
    keep,
    multiply,
    onto,
    softest,
    solve,
    widen,
)
from fgplan.compiled.kernel import BOOL, FLOAT, INT, REGISTER, packed, reordered, result, room
from fgplan.wiring import PERSON

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]


SLIGHT = 1e-9
"""A pair that curves by less than this share of a body's own position is as good as none."""


@reordered()
def _add_pairs(
    near: Index, blocks: Array, i: Index, j: Index, robot: Index, x: Array, u: Array, y: Array,
    v: Array,
) -> None:  # fmt: skip
    """Add what the pairs curve: to y (rows, n) of the people at x, to v (rows', 1) of the robot at
    u."""
    for entry in range(len(near)):
        k, p = near[entry, 0], near[entry, 1]
        xx, xy, yy = blocks[entry, 0], blocks[entry, 1], blocks[entry, 2]
        one, other, at = i[p] - 1, j[p] - 1, PERSON * k
        if one < 0:
            r = robot[k]
            dx, dy = u[r, 0] - x[at, other], u[r + 1, 0] - x[at + 2, other]
        else:
            dx, dy = x[at, one] - x[at, other], x[at + 2, one] - x[at + 2, other]
        gx, gy = xx * dx + xy * dy, xy * dx + yy * dy
        y[at, other] -= gx
        y[at + 2, other] -= gy
        if one < 0:
            v[r, 0] += gx
            v[r + 1, 0] += gy
        else:
            y[at, one] += gx
            y[at + 2, one] += gy


@reordered()
def _cushion(
    near: Index, blocks: Array, i: Index, j: Index, robot: Index, people: Array, own: Array
) -> None:
    """What each pair curves upwards, as if its bodies moved alone: xx, xy, yy of the people's
    positions, shape (S, 3, n), and added to the robot's own chain."""
    for k in range(people.shape[0]):
        fill(people[k], 0.0)
    for entry in range(len(near)):
        k, p = near[entry, 0], near[entry, 1]
        xx, xy, yy = blocks[entry, 0], blocks[entry, 1], blocks[entry, 2]
        middle, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
        radius = sqrt(half * half + xy * xy)
        high, low = max(middle + radius, 0.0), max(middle - radius, 0.0)
        mean, scale = 0.5 * (high + low), 0.5 * (high - low) / max(radius, 1e-300)
        a, b, d = mean + scale * half, scale * xy, mean - scale * half
        for body in (i[p] - 1, j[p] - 1):
            if body < 0:
                r = robot[k]
                own[r, 0, 0] += a
                own[r, 1, 0] += b
                own[r + 1, 0, 0] += d
            else:
                people[k, 0, body] += a
                people[k, 1, body] += b
                people[k, 2, body] += d


@reordered()
def _add(cushion: Array, M: Array) -> None:
    """Add a cushion (S, 3, n) to chains in a band."""
    for k in range(cushion.shape[0]):
        c = PERSON * k
        for q in range(cushion.shape[2]):
            M[c, 0, q] += cushion[k, 0, q]
            M[c, 2, q] += cushion[k, 1, q]
            M[c + 2, 0, q] += cushion[k, 2, q]


@reordered()
def _without(cushion: Array, s: Array, d: Array, y: Array) -> None:
    """y ← s − C d, with a cushion C (S, 3, n) and vectors (4 S, n)."""
    copy(s, y)
    for k in range(cushion.shape[0]):
        c = PERSON * k
        for q in range(cushion.shape[2]):
            y[c, q] -= cushion[k, 0, q] * d[c, q] + cushion[k, 1, q] * d[c + 2, q]
            y[c + 2, q] -= cushion[k, 1, q] * d[c, q] + cushion[k, 2, q] * d[c + 2, q]


@reordered()
def _near(blocks: Array, least: float, first: int, stride: int, near: Index, kept: Array) -> int:
    """The pairs that curve by more than the least: step and pair (·, 2), and their blocks (·, 3);
    how many."""
    count = 0
    for k in range(blocks.shape[0]):
        for p in range(blocks.shape[1]):
            xx, xy, yy = abs(blocks[k, p, 0]), abs(blocks[k, p, 1]), abs(blocks[k, p, 2])
            if xx > least or xy > least or yy > least:
                near[count, 0], near[count, 1] = first + k * stride, p
                for c in range(3):
                    kept[count, c] = blocks[k, p, c]
                count += 1
    return count


@reordered()
def _conjugate(
    cushion: Array, H_own: Array, pairs: Index, curves: Array, i: Index, j: Index, robot: Index,
    free_own: Array, M: Array, M_own: Array, r: Array, r_own: Array, forcing: float, most: int,
    x: Array, x_own: Array,
) -> tuple[bool, int]:  # fmt: skip
    """Steps x, x_own, which are 0, from what is left of the gradient, r and r_own, and factors of
    the preconditioner; whether no direction curved downwards, and how many were tried.

    Chains without their cushion are not multiplied: M z = r, and so M d follows by recurrence
    (Eisenstat)."""
    z, d, s, y = room(r.shape), room(r.shape), room(r.shape), room(r.shape)
    z_own, d_own, y_own = room(r_own.shape), room(r_own.shape), room(r_own.shape)
    copy(r, z)
    copy(r_own, z_own)
    solve(M, z)
    solve(M_own, z_own)
    keep(z_own, free_own)
    copy(z, d)
    copy(z_own, d_own)
    copy(r, s)
    rz = dot(r, z) + dot(r_own, z_own)
    enough, products = min(forcing, sqrt(rz)) ** 2 * rz, 0
    if not rz < np.inf:
        return False, 0
    while products < most and rz > enough:
        products += 1
        _without(cushion, s, d, y)
        multiply(H_own, d_own, y_own)
        _add_pairs(pairs, curves, i, j, robot, d, d_own, y, y_own)
        keep(y_own, free_own)
        curvature = dot(d, y) + dot(d_own, y_own)
        if not curvature > 0:
            if products == 1:
                copy(d, x)
                copy(d_own, x_own)
            return False, products
        share = rz / curvature
        along(x, share, d)
        along(x_own, share, d_own)
        along(r, -share, y)
        along(r_own, -share, y_own)
        copy(r, z)
        copy(r_own, z_own)
        solve(M, z)
        solve(M_own, z_own)
        keep(z_own, free_own)
        after = dot(r, z) + dot(r_own, z_own)
        onto(d, after / rz, z)
        onto(s, after / rz, r)
        onto(d_own, after / rz, z_own)
        rz = after
    return True, products


_CHAINS = (packed(4), packed(1, INT), packed(4), packed(4))
_PAIRS = (packed(4), INT, INT, packed(1, INT), packed(1, INT), packed(1, INT))


@reordered(
    *_CHAINS, *_PAIRS, packed(2), FLOAT, INT, result(3), result(3), result(1, BOOL), result(1, INT)
)
def newton(
    people: Array,
    row: Index,
    own: Array,
    cushion: Array,
    blocks: Array,
    first: int,
    stride: int,
    i: Index,
    j: Index,
    robot: Index,
    free_own: Array,
    forcing: float,
    most: int,
    step: Array,
    step_own: Array,
    definite: Mask,
    products: Index,
) -> None:
    """Steps −H⁻¹ g of B systems.

    Args:
        people: Chains of n people without pairs, shape (K, 4S, BAND, n).
        row: Which of them each system has, shape (B,).
        own: Chain of all that is not people, shape (B, rows, width, 1).
        cushion: The same without what curves downwards.
        blocks: Of the pairs (xx, xy, yy), shape (B, steps, P, 3).
        first, stride: Time steps of these.
        i, j: Bodies of each pair, the robot being 0, shape (P,).
        robot: Row of the robot's position in its chain at each time step, shape (S,).
        free_own: 1 where a coordinate of that chain may move, else 0, shape (rows, 1); people may.
        forcing: The residual of a step is at most this share of the gradient, and its square root
            where that is less, in the norm of the preconditioner.
        most: Products at most.
        step, step_own: g (B, 4S, n) and (B, rows, 1); overwritten with the steps.
        definite: Is told where no direction curved downwards, shape (B,).
        products: Is told how many products it took, shape (B,).
    """
    B, S, P = blocks.shape[0], blocks.shape[1], blocks.shape[2]
    rows, width, n = people.shape[1], people.shape[2], people.shape[3]
    near, kept = np.empty((S * P, 2), np.intp), np.empty((S * P, 3))
    lanes = -(-n // REGISTER) * REGISTER
    M, shared = room((rows, width, lanes)), room((rows // PERSON, 3, lanes))
    x, r = room((rows, lanes)), room((rows, lanes))
    M_own, x_own, r_own = room(own.shape[1:]), room(step_own.shape[1:]), room(step_own.shape[1:])
    for b in range(B):
        least = SLIGHT * softest(people[row[b]])
        count = _near(blocks[b], least, first, stride, near, kept)
        pairs, curves = near[:count], kept[:count]
        widen(cushion[b], M_own)
        widen(people[row[b]], M)
        _cushion(pairs, curves, i, j, robot, shared, M_own)
        _add(shared, M)
        downwards(step[b], r)
        downwards(step_own[b], r_own)
        fill(x, 0.0)
        fill(x_own, 0.0)
        definite[b], products[b] = False, 0
        if factorise(M) and factorise(M_own):
            definite[b], products[b] = _conjugate(
                shared, own[b], pairs, curves, i, j, robot, free_own,
                M, M_own, r, r_own, forcing, most, x, x_own,
            )  # fmt: skip
        copy(x, step[b])
        copy(x_own, step_own[b])
