"""Pairs of bodies, compiled: what `factors.pairwise` says, pair by pair instead of term by term.

A pair has an interaction, a contact or both, as one row of numbers, so that its distance is looked
at once. The numpy residuals are the definition; this is the same to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from factors.contact import Contact
from factors.hinge import hinge_scale
from factors.interaction import Interaction
from factors.pairwise import ByPair, CrowdPairs, PairPotential, PredictedPairs, Together
from factors.residual import Array, Expansion, Residual
from fgplan.compiled.kernel import BOOL, INT, apart, exact, given, packed, result
from fgplan.compiled.radial import NOTHING, energies, expansions, relative, total
from fgplan.model import Term

Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Pairs(Residual):
    """Potentials of pairs of bodies, the first m of which are variables.

    Variables: robot (positions first), and the crowd (positions, then anything) where people are
    variables.

    Args:
        sizes: Of the variables.
        positions: Where those of the m bodies are in them, shape (2m,).
        i, j: Bodies i < j of each pair, shape (P,).
        table: alpha, −1/(2 s²), weight, reach and scale of each pair, shape (S, 5, P), or
            (1, 5, P) where they are the same at all steps.
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
        batch = x[0].shape[:-1]
        parts = (part.reshape(*batch, *part.shape[2:]) for part in self._expanded(x, flat))
        return ByPair(*parts)

    def _expansion(self, x: tuple[Array, ...], flat: bool) -> Expansion:
        energy, gradient, blocks = self._expanded(x, flat)
        hessian = np.zeros((*gradient.shape, gradient.shape[-1]))
        _lay_out(self.i, self.j, blocks, hessian)
        batch = x[0].shape[:-1]
        parts = (part.reshape(*batch, *part.shape[2:]) for part in (energy, gradient, hessian))
        return Expansion(*parts)

    def _expanded(self, x: tuple[Array, ...], flat: bool) -> tuple[Array, Array, Array]:
        """Energy (N, S), gradient (N, S, s) and blocks (N, S, P, 3)."""
        robot, crowd = _variables(x)
        shape = robot.shape[:2]
        energy, gradient = np.empty(shape), np.zeros((*shape, len(self.positions)))
        blocks = np.empty((*shape, len(self.i), 3))
        bodies = robot, crowd, self.held, self.i, self.j, self.table
        _expand(*bodies, flat, energy, gradient, blocks)
        return energy, gradient, blocks


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
        kinds = [[one for one in group if isinstance(one[1], kind)] for kind in _NUMBERS]
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
        elif type(potential) in _NUMBERS:
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
    rows = [_NUMBERS[type(potential)] for potential in potentials]
    values = [of(potential) for (of, _), potential in zip(rows, potentials, strict=True)]
    steps = max(len(value) if value.ndim == 3 else 1 for value in values)
    table = np.tile(np.array(NOTHING)[:, None], (steps, 1, len(every)))
    for code, value, (_, numbers) in zip(codes, values, rows, strict=True):
        table[:, numbers, np.searchsorted(every, code)] = value
    held = np.ascontiguousarray(held, dtype=float)
    return Pairs(first.dims, first.support, *np.divmod(every, many), table, held)


def _of_interaction(potential: Interaction) -> Array:
    exponent = -0.5 / (potential.h_c**2 + potential.variance)
    return _numbers(potential.alpha, exponent, potential.weight)


def _of_contact(potential: Contact) -> Array:
    return _numbers(potential.reach, hinge_scale(potential.sigma, potential.weight))


def _numbers(*each: Any) -> Array:
    """Of each pair (P,), or of each step and pair (S, P), as part of a table."""
    return np.stack(np.broadcast_arrays(*(np.atleast_1d(one) for one in each)), axis=-2)


_NUMBERS: dict[type, tuple[Callable[[Any], Array], slice]] = {
    Interaction: (_of_interaction, slice(0, 3)),
    Contact: (_of_contact, slice(3, 5)),
}
"""Kinds of potentials, and where their numbers are in a table."""


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


_STATES = (given(3), given(3), given(3))
_TABLE = (packed(1, INT), packed(1, INT), packed(3))


@exact(*_STATES, INT, *_TABLE, result(2))
def _energy(
    robot: Array, crowd: Array, held: Array, m: int, i: Index, j: Index, table: Array, energy: Array
) -> None:
    bodies, delta = np.empty((m + held.shape[1], 2)), np.empty((2, len(i)))
    squared, presence, each = np.empty(len(i)), np.empty(len(i)), np.empty(len(i))
    for n in range(robot.shape[0]):
        for k in range(robot.shape[1]):
            _place(bodies, robot[n, k], crowd[n, k], held[min(k, len(held) - 1)])
            relative(bodies, i, j, delta, squared)
            energies(squared, table[min(k, len(table) - 1)], presence, each)
            energy[n, k] = total(each)


@exact()
def _add(H: Array, r: int, c: int, xx: float, xy: float, yy: float) -> None:
    H[r, c] += xx
    H[r, c + 1] += xy
    H[r + 1, c] += xy
    H[r + 1, c + 1] += yy


@apart()
def _spread(i: Index, j: Index, m: int, delta: Array, slope: Array, gradient: Array) -> None:
    """Add the gradients of pairs to those of the first m bodies."""
    for p in range(len(i)):
        gx, gy = slope[p] * delta[0, p], slope[p] * delta[1, p]
        gradient[2 * i[p]] += gx
        gradient[2 * i[p] + 1] += gy
        if j[p] < m:
            gradient[2 * j[p]] -= gx
            gradient[2 * j[p] + 1] -= gy


@apart()
def _curve(delta: Array, a: Array, b: Array, blocks: Array) -> None:
    """Hessians a + b Δ Δᵀ of pairs as xx, xy, yy, shape (P, 3)."""
    for p in range(len(a)):
        x, y = delta[0, p], delta[1, p]
        blocks[p, 0], blocks[p, 1], blocks[p, 2] = (
            a[p] + b[p] * x * x,
            b[p] * x * y,
            a[p] + b[p] * y * y,
        )


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
    blocks: Array,
) -> None:
    m = gradient.shape[2] // 2
    bodies, delta = np.empty((m + held.shape[1], 2)), np.empty((2, len(i)))
    squared, presence, each = np.empty(len(i)), np.empty(len(i)), np.empty(len(i))
    slope, a, b = np.empty(len(i)), np.empty(len(i)), np.empty(len(i))
    for n in range(robot.shape[0]):
        for k in range(robot.shape[1]):
            _place(bodies, robot[n, k], crowd[n, k], held[min(k, len(held) - 1)])
            relative(bodies, i, j, delta, squared)
            rows = table[min(k, len(table) - 1)]
            expansions(squared, rows, flat, presence, each, slope, a, b)
            energy[n, k] = total(each)
            _spread(i, j, m, delta, slope, gradient[n, k])
            _curve(delta, a, b, blocks[n, k])


@exact(packed(1, INT), packed(1, INT), packed(4), result(4))
def _lay_out(i: Index, j: Index, blocks: Array, hessian: Array) -> None:
    """Add the blocks of pairs to the Hessians of the first bodies."""
    m = hessian.shape[2] // 2
    for n in range(hessian.shape[0]):
        for k in range(hessian.shape[1]):
            H = hessian[n, k]
            for p in range(len(i)):
                r, c = 2 * i[p], 2 * j[p]
                xx, xy, yy = blocks[n, k, p]
                _add(H, r, r, xx, xy, yy)
                if j[p] < m:
                    _add(H, c, c, xx, xy, yy)
                    _add(H, r, c, -xx, -xy, -yy)
                    _add(H, c, r, -xx, -xy, -yy)
