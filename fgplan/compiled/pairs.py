"""Pairs of bodies, compiled: what `factors.pairwise` says, pair by pair instead of term by term.

A pair has an interaction, a contact or both, as one row of numbers, so that its distance is looked
at once. The numpy residuals are the definition; this is the same to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from math import exp, log1p, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from factors.contact import Contact
from factors.hinge import TINY, hinge_scale
from factors.interaction import Interaction
from factors.pairwise import ByPair, CrowdPairs, PairPotential, PredictedPairs, Together
from factors.residual import Array, Expansion, Residual
from fgplan.compiled.kernel import BOOL, INT, exact, given, result
from fgplan.model import Term

Index = NDArray[np.intp]

NOWHERE = -40.0
"""Below this exponent an interaction is nothing beside the rounding of a sum."""
FAINT = 1e-3
"""Below this −log(1 − u) is five terms of its series to rounding, in a third of the time."""
LEAST = 1e-16
"""1 − u is not taken to be less in a slope: at contact with alpha = 1 the limit is infinite."""
NOTHING = (0.0, 0.0, 0.0, -1.0, 0.0)
"""A row without interaction (alpha = 0) and without contact (a reach that no distance is below)."""


@dataclass(frozen=True, eq=False)
class Pairs(Residual):
    """Potentials of pairs of bodies, the first m of which are variables.

    Variables: robot (positions first), and the crowd (positions, then anything) where people are
    variables.

    Args:
        sizes: Of the variables.
        positions: Where those of the m bodies are in them, shape (2m,).
        i, j: Bodies i < j of each pair, shape (P,).
        table: alpha, −1/(2 s²), weight, reach and scale of each pair, shape (S, P, 5), or
            (1, P, 5) where they are the same at all steps.
        held: Where the bodies after the first m are, shape (S, h, 2) or (1, h, 2) [m].
    """

    sizes: tuple[int, ...]
    positions: Index
    i: Index
    j: Index
    table: Array
    held: Array

    @property
    def dims(self) -> tuple[int, ...]:
        return self.sizes

    @property
    def rows(self) -> int:
        return len(self.i)

    @property
    def support(self) -> Index:
        return self.positions

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        raise TypeError("linearize the potentials one by one: their sum is no square")

    def energy(self, *x: Array) -> Array:
        robot, crowd = _variables(x)
        energy = np.zeros(robot.shape[:2])
        bodies = len(self.positions) // 2
        _energy(robot, crowd, self.held, bodies, self.i, self.j, self.table, energy)
        return energy.reshape(x[0].shape[:-1])

    def expand(self, *x: Array) -> Expansion:
        return self._expansion(x, flat=False)

    def gauss_newton(self, *x: Array) -> Expansion:
        return self._expansion(x, flat=True)

    def by_pair(self, *x: Array, flat: bool = False) -> ByPair:
        """The expansion with its Hessian pair by pair; with `flat`, Gauss–Newton's."""
        robot, crowd = _variables(x)
        shape, size = robot.shape[:2], len(self.positions)
        energy, gradient = np.zeros(shape), np.zeros((*shape, size))
        blocks = np.zeros((*shape, len(self.i), 3))
        bodies = robot, crowd, self.held, self.i, self.j, self.table
        _expand_by_pair(*bodies, flat, energy, gradient, blocks)
        batch = x[0].shape[:-1]
        return ByPair(
            *(part.reshape(*batch, *part.shape[2:]) for part in (energy, gradient, blocks))
        )

    def _expansion(self, x: tuple[Array, ...], flat: bool) -> Expansion:
        robot, crowd = _variables(x)
        shape, size = robot.shape[:2], len(self.positions)
        sums = Expansion(np.zeros(shape), np.zeros((*shape, size)), np.zeros((*shape, size, size)))
        _expand(robot, crowd, self.held, self.i, self.j, self.table, flat, *sums)
        batch = x[0].shape[:-1]
        return Expansion(*(part.reshape(*batch, *part.shape[2:]) for part in sums))


def fused(terms: Sequence[Term]) -> Iterator[Term]:
    """The terms, with potentials of pairs of the same bodies as one, compiled; what has no
    compiled form is left as it is."""
    groups: dict[tuple[object, ...], list[tuple[Term, PairPotential]]] = {}
    for term in terms:
        bodies, potentials = _bodies(term.residual), _simple(term.residual)
        if bodies is None or potentials is None:
            yield term
            continue
        group = groups.setdefault((bodies, term.variables, term.steps), [])
        group += [(term, potential) for potential in potentials]
    for group in groups.values():
        kinds = [[one for one in group if isinstance(one[1], kind)] for kind in _COLUMNS]
        for together in zip_longest(*kinds):
            parts = [one for one in together if one is not None]
            pairs = _pairs([term.residual for term, _ in parts], [one for _, one in parts])
            yield replace(parts[0][0], residual=pairs)


def _bodies(residual: Residual) -> tuple[object, ...] | None:
    """Alike for residuals of the same bodies; None where these have no compiled form."""
    if isinstance(residual, CrowdPairs) and residual.space == 2:
        return residual.dims
    if isinstance(residual, PredictedPairs) and residual.people.shape[-1] == 2:
        return (*residual.dims, id(residual.people))
    return None


def _simple(residual: Residual) -> list[PairPotential] | None:
    """The potentials of a residual one by one; None where one of them has no compiled form."""
    todo: list[Any] = [getattr(residual, "potential", None)]
    found: list[PairPotential] = []
    while todo:
        potential = todo.pop(0)
        if isinstance(potential, Together):
            todo += potential.potentials
        elif type(potential) in _COLUMNS:
            found.append(potential)
        else:
            return None
    return found


def _pairs(residuals: Sequence[Any], potentials: Sequence[Any]) -> Pairs:
    """At most one potential of a kind, on residuals of the same bodies."""
    first = residuals[0]
    if isinstance(first, CrowdPairs):
        held = np.zeros((1, 0, 2))
        indices = [residual.index for residual in residuals]
    else:
        held = first.people.reshape(-1, *first.people.shape[-2:])
        person = 1 + np.arange(held.shape[1])
        indices = [(np.zeros_like(person), person)] * len(residuals)
    many = 1 + max(int(j.max(initial=0)) for _, j in indices)
    codes = [i * many + j for i, j in indices]
    every = np.unique(np.concatenate(codes))
    rows = [_COLUMNS[type(potential)] for potential in potentials]
    values = [of(potential) for (of, _), potential in zip(rows, potentials, strict=True)]
    steps = max(len(value) if value.ndim == 3 else 1 for value in values)
    table = np.tile(np.array(NOTHING), (steps, len(every), 1))
    for code, value, (_, columns) in zip(codes, values, rows, strict=True):
        table[:, np.searchsorted(every, code), columns] = value
    held = np.ascontiguousarray(held, dtype=float)
    return Pairs(first.dims, first.support, *np.divmod(every, many), table, held)


def _of_interaction(potential: Interaction) -> Array:
    exponent = -0.5 / (potential.h_c**2 + potential.variance)
    return np.stack(np.broadcast_arrays(potential.alpha, exponent, potential.weight), axis=-1)


def _of_contact(potential: Contact) -> Array:
    scale = hinge_scale(potential.sigma, potential.weight)
    return np.stack(np.broadcast_arrays(potential.reach, scale), axis=-1)


_COLUMNS: dict[type, tuple[Callable[[Any], Array], slice]] = {
    Interaction: (_of_interaction, slice(0, 3)),
    Contact: (_of_contact, slice(3, 5)),
}
"""Kinds of potentials, and where they are in a row."""


def _variables(x: tuple[Array, ...]) -> tuple[Array, Array]:
    """Robot and crowd as arrays (N, S, dims); no crowd is one without coordinates."""
    robot, *crowd = (part.reshape(-1, *part.shape[-2:]) for part in x)
    return robot, crowd[0] if crowd else robot[..., :0]


@exact()
def _place(bodies: Array, robot: Array, crowd: Array, held: Array) -> None:
    """Positions (h + m, 2) of all bodies."""
    people = len(bodies) - 1 - len(held)
    for c in range(2):
        bodies[0, c] = robot[c]
        for n in range(people):
            bodies[1 + n, c] = crowd[2 * n + c]
        for n in range(len(held)):
            bodies[1 + people + n, c] = held[n, c]


@exact()
def _presence_energy(u: float) -> float:
    """−log(1 − u)."""
    if u < FAINT:
        return u * (1 + u * (1 / 2 + u * (1 / 3 + u * (1 / 4 + u / 5))))
    return -log1p(-u)


_STATES = (given(3), given(3), given(3))
_TABLE = (given(1, INT), given(1, INT), given(3))


@exact(*_STATES, INT, *_TABLE, result(2))
def _energy(
    robot: Array, crowd: Array, held: Array, m: int, i: Index, j: Index, table: Array, energy: Array
) -> None:
    bodies = np.empty((m + held.shape[1], 2))
    for n in range(robot.shape[0]):
        for k in range(robot.shape[1]):
            _place(bodies, robot[n, k], crowd[n, k], held[min(k, len(held) - 1)])
            row, total = table[min(k, len(table) - 1)], 0.0
            for p in range(len(i)):
                x, y = bodies[i[p], 0] - bodies[j[p], 0], bodies[i[p], 1] - bodies[j[p], 1]
                d2 = x * x + y * y
                alpha, exponent, weight, reach, scale = row[p]
                if alpha > 0 and exponent * d2 > NOWHERE:
                    total += weight * _presence_energy(alpha * exp(exponent * d2))
                if reach > 0 and not d2 + TINY**2 > reach * reach:
                    total += 0.5 * (scale * (reach - sqrt(d2 + TINY**2))) ** 2
            energy[n, k] = total


@exact()
def _radial(d2: float, row: Array, flat: bool) -> tuple[float, float, float, float]:
    """Energy, slope, a and b of `factors.radial.Radial`, of both potentials; with `flat`, the
    Gauss–Newton curvature."""
    alpha, exponent, weight, reach, scale = row[0], row[1], row[2], row[3], row[4]
    energy = slope = a = b = 0.0
    if alpha > 0 and exponent * d2 > NOWHERE:
        u = alpha * exp(exponent * d2)
        energy = weight * _presence_energy(u)
        rest = 1 - u
        if rest < LEAST:
            rest = LEAST
        slope = 2 * exponent * weight * u / rest
        if flat:
            # ∂e/∂Δ = c·Δ with e = √(2 energy), so that c = slope/e.
            b = slope**2 / (2 * energy) if energy != 0 else 0.0
        else:
            a = slope
            b = 2 * exponent * slope / rest
    if reach > 0 and not d2 + TINY**2 > reach * reach:
        d = sqrt(d2 + TINY**2)
        e = scale * (reach - d)
        own = -scale * e / d
        energy += 0.5 * e * e
        slope += own
        if not flat:
            a += own
            b += (scale * scale - own) / (d * d)
        elif e > 0:
            b += (scale / d) ** 2
    return energy, slope, a, b


@exact()
def _add(H: Array, r: int, c: int, xx: float, xy: float, yy: float) -> None:
    H[r, c] += xx
    H[r, c + 1] += xy
    H[r + 1, c] += xy
    H[r + 1, c + 1] += yy


@exact(*_STATES, *_TABLE, BOOL, result(2), result(3), result(4))
def _expand(
    robot: Array,
    crowd: Array,
    held: Array,
    i: Index,
    j: Index,
    table: Array,
    flat: bool,
    energy: Array,
    gradient: Array,
    hessian: Array,
) -> None:
    m = gradient.shape[2] // 2
    bodies = np.empty((m + held.shape[1], 2))
    for n in range(robot.shape[0]):
        for k in range(robot.shape[1]):
            _place(bodies, robot[n, k], crowd[n, k], held[min(k, len(held) - 1)])
            row, g, H = table[min(k, len(table) - 1)], gradient[n, k], hessian[n, k]
            for p in range(len(i)):
                one, other = i[p], j[p]
                x, y = bodies[one, 0] - bodies[other, 0], bodies[one, 1] - bodies[other, 1]
                e, slope, a, b = _radial(x * x + y * y, row[p], flat)
                energy[n, k] += e
                xx, xy, yy = a + b * x * x, b * x * y, a + b * y * y
                r, c = 2 * one, 2 * other
                g[r] += slope * x
                g[r + 1] += slope * y
                _add(H, r, r, xx, xy, yy)
                if other < m:
                    g[c] -= slope * x
                    g[c + 1] -= slope * y
                    _add(H, c, c, xx, xy, yy)
                    _add(H, r, c, -xx, -xy, -yy)
                    _add(H, c, r, -xx, -xy, -yy)


@exact(*_STATES, *_TABLE, BOOL, result(2), result(3), result(4))
def _expand_by_pair(
    robot: Array,
    crowd: Array,
    held: Array,
    i: Index,
    j: Index,
    table: Array,
    flat: bool,
    energy: Array,
    gradient: Array,
    blocks: Array,
) -> None:
    m = gradient.shape[2] // 2
    bodies = np.empty((m + held.shape[1], 2))
    for n in range(robot.shape[0]):
        for k in range(robot.shape[1]):
            _place(bodies, robot[n, k], crowd[n, k], held[min(k, len(held) - 1)])
            row, g, h = table[min(k, len(table) - 1)], gradient[n, k], blocks[n, k]
            for p in range(len(i)):
                one, other = i[p], j[p]
                x, y = bodies[one, 0] - bodies[other, 0], bodies[one, 1] - bodies[other, 1]
                e, slope, a, b = _radial(x * x + y * y, row[p], flat)
                energy[n, k] += e
                h[p, 0], h[p, 1], h[p, 2] = a + b * x * x, b * x * y, a + b * y * y
                g[2 * one] += slope * x
                g[2 * one + 1] += slope * y
                if other < m:
                    g[2 * other] -= slope * x
                    g[2 * other + 1] -= slope * y
