"""Potentials of many distances at once, compiled: whole registers of pairs are taken together.

A row of numbers a pair is one of a table (5, P): alpha, −1/(2 s²), weight, reach and scale. What is
rare, presences that are not small and contacts, is gone through pair by pair.
"""

from __future__ import annotations

from math import exp, log1p, sqrt

import numpy as np
from numpy.typing import NDArray

from factors.hinge import TINY
from fgplan.compiled.kernel import apart, exact

Array = NDArray[np.float64]
Index = NDArray[np.intp]

NOWHERE = 40.0
"""Beyond this negative exponent an interaction is nothing beside the rounding of a sum."""
FAINT = 1e-3
"""Below this −log(1 − u) is five terms of its series to rounding."""
LEAST = 1e-16
"""1 − u is not taken to be less in a slope: at contact with alpha = 1 the limit is infinite."""
NOTHING = (0.0, -1.0, 0.0, -1.0, 0.0)
"""A row without interaction (alpha = 0, and an exponent with which infinity is far) and without
contact (a reach that no distance is below)."""


@apart()
def relative(bodies: Array, i: Index, j: Index, delta: Array, squared: Array) -> None:
    """Differences (2, P) of the positions (·, 2) of two bodies each, and their squared lengths."""
    for p in range(len(i)):
        delta[0, p] = bodies[i[p], 0] - bodies[j[p], 0]
        delta[1, p] = bodies[i[p], 1] - bodies[j[p], 1]
    _square(delta, squared)


@exact()
def _square(delta: Array, squared: Array) -> None:
    """Rounded as numpy does: near contact 1 − u has few digits."""
    for p in range(len(squared)):
        squared[p] = delta[0, p] * delta[0, p] + delta[1, p] * delta[1, p]


@apart()
def _decay(z: float) -> float:
    """e^−z for 0 ≤ z ≤ 40 to 2e-14: its series at z/64, squared six times. A call of the library
    would be made number by number."""
    y = z * (-1 / 64)
    e = 1 + y / 9 * (1 + y / 10 * (1 + y / 11 * (1 + y / 12 * (1 + y / 13 * (1 + y / 14)))))
    e = 1 + y / 4 * (1 + y / 5 * (1 + y / 6 * (1 + y / 7 * (1 + y / 8 * e))))
    e = 1 + y * (1 + y / 2 * (1 + y / 3 * e))
    e *= e
    e *= e
    e *= e
    e *= e
    e *= e
    return e * e


@apart()
def _faint(squared: Array, table: Array, presence: Array, energy: Array) -> None:
    """u = alpha·e^(−d²/(2 s²)), and −weight·log(1 − u) as long as u is faint."""
    for p in range(len(squared)):
        z = -table[1, p] * squared[p]
        u = table[0, p] * _decay(z) if not z >= NOWHERE else 0.0  # NaN stays NaN
        series = u * (1 + u * (1 / 2 + u * (1 / 3 + u * (1 / 4 + u / 5))))
        presence[p], energy[p] = u, table[2, p] * series


@exact()
def _interactions(squared: Array, table: Array, presence: Array, energy: Array) -> None:
    """Presence u, and the energy of the interaction."""
    _faint(squared, table, presence, energy)
    for p in range(len(squared)):
        if presence[p] >= FAINT:  # 1 − u may be small: now every digit counts
            presence[p] = table[0, p] * exp(table[1, p] * squared[p])
            energy[p] = -table[2, p] * log1p(-presence[p])


@exact()
def energies(squared: Array, table: Array, presence: Array, energy: Array) -> None:
    """Energies of P pairs [nats], interaction and contact, and their presence u.

    Args:
        squared: Squared distances, shape (P,) [m²].
        table: Shape (5, P).
        presence, energy: Are written, shape (P,).
    """
    _interactions(squared, table, presence, energy)
    for p in range(len(squared)):
        d2, reach = squared[p] + TINY**2, table[3, p]
        if reach > 0 and not d2 > reach * reach:
            energy[p] += 0.5 * (table[4, p] * (reach - sqrt(d2))) ** 2


@apart()
def _slopes(table: Array, presence: Array, slope: Array, a: Array, b: Array) -> None:
    for p in range(len(presence)):
        rest = max(1 - presence[p], LEAST)
        slope[p] = a[p] = 2 * table[1, p] * table[2, p] * presence[p] / rest
        b[p] = 2 * table[1, p] * slope[p] / rest


@apart()
def _flat_slopes(
    table: Array, presence: Array, energy: Array, slope: Array, a: Array, b: Array
) -> None:
    """∂e/∂Δ = c·Δ with e = √(2 energy), so that c = slope/e."""
    for p in range(len(presence)):
        rest = max(1 - presence[p], LEAST)
        slope[p] = 2 * table[1, p] * table[2, p] * presence[p] / rest
        a[p], b[p] = 0.0, slope[p] ** 2 / (2 * energy[p]) if energy[p] != 0 else 0.0


@exact()
def expansions(
    squared: Array, table: Array, flat: bool, presence: Array, energy: Array, slope: Array,
    a: Array, b: Array,
) -> None:  # fmt: skip
    """Energy, slope, a and b of `factors.radial.Radial` of P pairs, interaction and contact.

    Args:
        squared: Squared distances, shape (P,) [m²].
        table: Shape (5, P).
        flat: Whether the curvature is Gauss–Newton's.
        presence, energy, slope, a, b: Are written, shape (P,).
    """
    _interactions(squared, table, presence, energy)
    if flat:
        _flat_slopes(table, presence, energy, slope, a, b)
    else:
        _slopes(table, presence, slope, a, b)
    for p in range(len(squared)):
        d2, reach, scale = squared[p] + TINY**2, table[3, p], table[4, p]
        if reach > 0 and not d2 > reach * reach:
            d = sqrt(d2)
            e = scale * (reach - d)
            own = -scale * e / d
            energy[p] += 0.5 * e * e
            slope[p] += own
            if not flat:
                a[p] += own
                b[p] += (scale * scale - own) / d2
            elif e > 0:
                b[p] += scale * scale / d2


@apart()
def total(each: Array) -> float:
    """Sum of the numbers, in any order."""
    sum_of = 0.0
    for p in range(len(each)):
        sum_of += each[p]
    return sum_of
