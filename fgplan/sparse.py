"""A density of many people, pair by pair: what a Newton step costs grows with the pairs.

People are linked to others by pairs alone: apart from them each is a chain of its own, and so is
the robot with its plans. A Hessian is never laid out: a pair keeps its block of 2 × 2, and systems
are solved by conjugate gradients, preconditioned by the chains (`fgplan.compiled.conjugate`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from factors.pairwise import PairTerm
from fgplan.assembly import Assembly, Quadratic, clamped, hold
from fgplan.backend import Pairwise
from fgplan.block_tridiagonal import Chains
from fgplan.entries import Places
from fgplan.wiring import BAND, PERSON, Wired, wire

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]

FEWEST = 12
"""People from whom on systems are solved so: with fewer, factorising was measured to be as fast."""
FORCING = 0.3
"""Accuracy of a step far from an optimum; near it the square root of its own length is less, so
that the error of the next one is that of this one to the power of 3/2."""
MOST = 200
"""Products with a Hessian in a step, at most."""
PROBING, PROBES = 1e-3, 40
"""The same for a direction that is drawn, to see whether the energy curves downwards anywhere."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the parts of a density are, for n people, S steps, and R coordinates of a step beside
    theirs.

    Args:
        solver: The kernels.
        pairs, term: Of all pairs among which people are variables.
        others: The other nonlinear terms, none of which is on people, by their places in the state
            and in a chain of R coordinates.
        person: Columns of each person's x, vx, y, vy, shape (n, 4).
        rest: Columns of the others, shape (R,).
        people: Constant Hessians of people, shape (K, 4S, BAND, n).
        chains: Constant Hessians of the others.
        robot: Row of the robot's position at each step in its chain, shape (S,).
        free_rest: 1 where a coordinate of the others may move, else 0, shape (RS, 1).
    """

    solver: Pairwise
    pairs: Wired
    term: PairTerm
    others: tuple[tuple[Wired, Wired], ...]
    person: Index
    rest: Index
    people: Array
    chains: Chains
    robot: Index
    free_rest: Array

    @classmethod
    def of(cls, assembly: Assembly) -> Layout | None:
        """Of an assembly; None where it is not of this kind, or too small."""
        first, solver = assembly.models[0], assembly.backend.pairwise
        crowd, robot = first.columns.get("crowd"), first.columns.get("robot")
        if solver is None or crowd is None or robot is None or first.extra:
            return None
        n, (S, D) = (crowd.stop - crowd.start) // PERSON, assembly.free.shape
        each = list(zip(assembly.terms, assembly.nonlinear, strict=True))
        on_people = [wired for term, wired in each if "crowd" in dict(term.variables)]
        rest_of = [(term, wired) for term, wired in each if wired not in on_people]
        if n < FEWEST or len(on_people) != 1:
            return None
        pairs = on_people[0]
        if not isinstance(pairs.residual, PairTerm):
            return None
        person = crowd.start + np.arange(crowd.stop - crowd.start).reshape(2, n, 2)
        person = person.transpose(1, 2, 0).reshape(n, PERSON)
        rest = np.setdiff1d(np.arange(D), person)
        own, ahead = assembly.entries.own, assembly.entries.ahead
        # A person who is known without error would have to be held.
        if not (assembly.free[:, person].all() and _apart(own.mask, ahead.mask, person, rest)):
            return None
        place = {int(column): at for at, column in enumerate(rest)}
        columns = {
            name: slice(place[c.start], place[c.start] + c.stop - c.start)
            for name, c in first.columns.items()
            if name != "crowd"
        }
        order = np.arange(len(rest))
        others = [
            (wired, replace(wire(term, columns, order), held=wired.held)) for term, wired in rest_of
        ]
        chain = own.at(rest[:, None], rest), ahead.at(rest[:, None], rest)
        free = assembly.free[:, rest]
        hold(free, *chain)
        return cls(
            solver,
            pairs,
            pairs.residual,
            tuple(others),
            person,
            rest,
            _bands(own, ahead, person),
            Chains.of(*chain),
            len(rest) * np.arange(S) + place[robot.start],
            free.astype(float).reshape(-1, 1),
        )


class Sparse(Quadratic):
    """Expansion of B energies at states (B, S, D), pair by pair."""

    def __init__(
        self, assembly: Assembly, layout: Layout, X: Array, which: Index, flat: bool = False
    ) -> None:
        self._layout = layout
        kind = "gauss_newton" if flat else "expand"
        small = [wired for wired, _ in layout.others]
        super().__init__(assembly, X, which, lambda r, x: getattr(r, kind)(*x), small)
        pairs = layout.pairs
        with np.errstate(over="ignore", invalid="ignore"):
            part = layout.term.by_pair(*pairs.variables(X), flat=flat)
        self.energy += np.add.reduce(part.energy, axis=-1)
        pairs.add_gradient(part.gradient, self.gradient)
        self._blocks = part.blocks
        self._hold()

    def take(self, rows: Index) -> Sparse:
        some = super().take(rows)
        assert isinstance(some, Sparse)
        some._blocks = self._blocks[rows]
        return some

    def put(self, rows: Index, other: Quadratic) -> None:
        super().put(rows, other)
        assert isinstance(other, Sparse)
        self._blocks[rows] = other._blocks

    def hessian(self, rows: Index) -> tuple[Array, Array]:
        raise TypeError("pairs are not laid out: expand the assembly itself for blocks")

    def newton(self) -> tuple[Array, Mask, Mask]:
        """As in `Quadratic`, but where the energy is seen to curve downwards a step is what was
        found before, and still of use."""
        steps, definite, products = self._solved(self.gradient, self.which, FORCING, MOST)
        return steps, definite, definite | (products > 0)  # at an optimum none is needed

    def confirmed(self, rows: Index) -> Mask:
        """No drawn direction leads to one that curves downwards. A saddle on which robot and
        people are symmetric has no gradient across, so no step ever looks there."""
        drawn = np.random.default_rng(0).standard_normal(self.gradient.shape[1:])
        drawn = np.where(self._assembly.free, drawn, 0.0)
        some = self.take(rows)
        aside = np.broadcast_to(drawn, some.gradient.shape)
        return some._solved(aside, some.which, PROBING, PROBES)[1]

    def _solved(
        self, gradient: Array, which: Index, forcing: float, most: int
    ) -> tuple[Array, Mask, Index]:
        """Steps (B, S, D), where no direction curved downwards (B,), and how many were tried."""
        layout = self._layout
        B, S, _ = gradient.shape
        n, R, row = len(layout.person), len(layout.rest), self._assembly.row[which]
        own = layout.chains.take(row)
        parts = [
            (there, wired, part)
            for (there, wired), (_, part) in zip(layout.others, self._parts, strict=True)
        ]
        for _, wired, part in parts:
            if wired.residual.convex:
                wired.add_lower(part, own)
        cushion = Chains(own.data.copy(), own.order)
        for there, wired, part in parts:
            if not wired.residual.convex:
                wired.add_lower(part, own)
                wired.add_lower(self._upwards(there, part), cushion)
        step = gradient[:, :, layout.person.T].reshape(B, S * PERSON, n)
        step_rest = gradient[:, :, layout.rest].reshape(B, S * R, 1)
        definite, products = np.empty(B, dtype=bool), np.empty(B, dtype=np.intp)
        first = layout.pairs.first
        layout.solver(
            layout.people,
            row,
            own.data[..., None],
            cushion.data[..., None],
            self._blocks,
            first.start,
            first.step or 1,
            layout.term.i,
            layout.term.j,
            layout.robot,
            layout.free_rest,
            forcing,
            most,
            step,
            step_rest,
            definite,
            products,
        )
        steps = np.empty_like(gradient)
        steps[:, :, layout.person.T] = step.reshape(B, S, PERSON, n)
        steps[:, :, layout.rest] = step_rest.reshape(B, S, R)
        return steps, definite, products

    def _upwards(self, wired: Wired, part: Array) -> Array:
        """Curvature (B, steps, s, s) of a term without what curves downwards."""
        if part.shape[-1] == 2:
            return clamped(part)
        flat = wired.residual.gauss_newton(*wired.variables(self.states)).hessian
        wired.hold(flat)
        return flat

    def flattened(self, rows: Index) -> tuple[Array, Mask]:
        states, which = self.states[rows], self.which[rows]
        steps, _, found = Sparse(self._assembly, self._layout, states, which, True).newton()
        return steps, found


def _apart(linked: Mask, on: Mask, person: Index, rest: Index) -> bool:
    """Whether people are linked neither to each other nor to the rest, within a time step and to
    the next, nor over time but along an axis."""
    allowed = np.zeros_like(linked)
    allowed[rest[:, None], rest] = True
    later = allowed.copy()
    for columns in person:
        allowed[columns[:, None], columns] = True
        for axis in columns.reshape(2, 2):
            later[axis[:, None], axis] = True
    return not (linked & ~allowed).any() and not (on & ~later).any()


def _bands(own: Places, ahead: Places, person: Index) -> Array:
    """Chains of people in a band each, shape (K, 4S, BAND, n)."""
    K, S = own.values.shape[:2]
    bands = np.zeros((K, S, PERSON, BAND, len(person)))
    for a in range(PERSON):
        for b in range(PERSON):
            row, column = person[:, a], person[:, b]
            if b <= a:
                bands[:, :, b, a - b] = own.at(row, column)
            if PERSON + b - a < BAND:
                bands[:, :-1, a, PERSON + b - a] = ahead.at(row, column)
    return bands.reshape(K, S * PERSON, BAND, len(person))
