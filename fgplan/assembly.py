"""The density of all hypotheses at once, as numpy sees it: energy, gradient and Hessian.

The linear-Gaussian part is assembled once. What is left (interaction, contact, obstacles, limits,
the user's own factors) is shared by all hypotheses; it is evaluated for all starts and all time
steps in one call a term, and its curvature is kept in small blocks until a system is solved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from factors.pairwise import PredictedPairs, Together
from factors.residual import Expansion, Linear, Residual
from factors.unicycle import UnicycleMotion
from fgplan import keys
from fgplan.block_tridiagonal import Chains, System, solve_each
from fgplan.model import Model, Term
from fgplan.shear import Shear

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Expand = Callable[[Residual, list[Array]], Expansion]

CHUNK = 65536
"""Numbers in the Hessian blocks that are laid out at once: they should stay in the cache."""


class _Part(NamedTuple):
    """Where one block of an expansion belongs in the band: steps of the rows, whether the columns
    are of the next step, places in the band, places in the expansion, and which entries are on or
    below the diagonal (None: all)."""

    steps: slice
    next: bool
    into: tuple[slice, slice]
    out_of: tuple[slice, slice]
    mask: NDArray[np.bool_] | None


@dataclass(frozen=True, eq=False)
class _Wired:
    """A nonlinear term with the places of its variables in the state.

    `runs` are contiguous runs of the residual's support: (offset in time, slice of the state,
    slice of the expansion). A term that reaches further than the next time step is no part of
    the chain: its curvature is kept apart, on the places `far` of the flattened state. `band` says
    where its blocks are in the band of `Chains`. `held` are
    (which of the steps, mask (s, s)) where some of the support is known without error, None where
    all of it is.
    """

    residual: Residual
    slots: tuple[tuple[slice, slice], ...]
    first: slice
    runs: tuple[tuple[int, slice, slice], ...]
    band: tuple[_Part, ...] = ()
    far: Index | None = None
    held: tuple[tuple[int, NDArray[np.bool_] | None], ...] = ()

    def variables(self, X: Array) -> list[Array]:
        return [X[..., steps, columns] for steps, columns in self.slots]

    def steps(self, offset: int) -> slice:
        return _moved(self.first, offset)

    def hold(self, part: Array) -> None:
        """No curvature where the state is known without error."""
        for at, mask in self.held:
            part[:, at] = 0.0 if mask is None else np.where(mask, part[:, at], 0.0)  # not inf·0

    def add_gradient(self, part: Array, gradient: Array) -> None:
        for offset, columns, rows in self.runs:
            gradient[..., self.steps(offset), columns] += part[..., rows]

    def add_hessian(self, part: Array, diagonal: Array, upper: Array) -> None:
        """Add blocks (..., steps, s, s) into the chain."""
        for at_row, into_rows, rows in self.runs:
            for at_column, into_columns, columns in self.runs:
                block = part[..., rows, columns]
                if at_row == at_column:
                    diagonal[..., self.steps(at_row), into_rows, into_columns] += block
                elif at_row < at_column:
                    upper[..., self.steps(at_row), into_rows, into_columns] += block

    def add_lower(self, part: Array, chains: Chains) -> None:
        """The same into the band, of the diagonal blocks only what is on and below the diagonal."""
        for steps, off, (into_rows, into_columns), (rows, columns), mask in self.band:
            block = part[..., rows, columns]
            if mask is not None:
                block = np.where(mask, block, 0.0)
            blocks = chains.upper if off else chains.diagonal
            blocks[:, steps, into_rows, into_columns] += block


class Quadratic:
    """Expansion of B energies at states (B, S, D).

    Attributes:
        energy: Shape (B,).
        gradient: Shape (B, S, D).
    """

    def __init__(self, assembly: Assembly, X: Array, which: Index, expand: Expand) -> None:
        self._assembly, self._X, self._which = assembly, X, which
        d = X - assembly.reference[which]
        curve = assembly.times(d, which)
        self.linear_gradient = assembly.gradient[which] + curve
        self.linear_energy = assembly.constant[which] + _dot(self.linear_gradient - 0.5 * curve, d)
        self.energy = self.linear_energy.copy()
        self.gradient = self.linear_gradient.copy()
        self._parts: list[tuple[_Wired, Array]] = []
        self._far: list[tuple[Index, Array]] = []
        for wired in assembly.nonlinear:
            part = expand(wired.residual, wired.variables(X))
            self.energy += part.energy.sum(-1)
            wired.add_gradient(part.gradient, self.gradient)
            wired.hold(part.hessian)
            if wired.far is None:
                self._parts.append((wired, part.hessian))
            else:
                self._far.append((wired.far, part.hessian[:, 0]))
        for k, held in assembly.held:
            self.gradient[:, k, held] = 0.0

    def hessian(self, rows: Index) -> tuple[Array, Array]:
        """Blocks (k, k), shape (R, S, D, D), and (k, k + 1), shape (R, S − 1, D, D), of some of
        the B Hessians."""
        diagonal, upper = self._assembly.held_hessian(self._which[rows])
        for wired, part in self._parts:
            wired.add_hessian(part[rows], diagonal, upper)
        return diagonal, upper

    @cached_property
    def diagonal(self) -> Array:
        """Blocks (k, k) of all B Hessians, shape (B, S, D, D)."""
        return self.hessian(np.arange(len(self.energy)))[0]

    @cached_property
    def upper(self) -> Array:
        """Blocks (k, k + 1) of all B Hessians, shape (B, S − 1, D, D)."""
        return self.hessian(np.arange(len(self.energy)))[1]

    def newton(self) -> tuple[Array, NDArray[np.bool_]]:
        """Steps −H⁻¹ g of all B expansions, shape (B, S, D), zero where H is not positive definite,
        and where it is (B,)."""
        return self._solve(np.arange(len(self.energy)), self._parts)

    def flattened(self, rows: Index) -> tuple[Array, NDArray[np.bool_]]:
        """The same of some of them without what curves downwards, shape (R, S, D) and (R,): small
        blocks lose their negative eigenvalues, larger ones are Gauss–Newton's."""
        parts = []
        for wired, part in self._parts:
            if wired.residual.convex:
                parts.append((wired, part[rows]))
            elif part.shape[-1] == 2:
                parts.append((wired, _clamped(part[rows])))
            else:
                flat = wired.residual.gauss_newton(*wired.variables(self._X[rows])).hessian
                wired.hold(flat)
                parts.append((wired, flat))
        return self._solve(rows, parts)

    def _solve(
        self, rows: Index, parts: Sequence[tuple[_Wired, Array]]
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Newton steps of some expansions, whose curvature is given."""
        which, gradient = self._which[rows], self.gradient[rows]
        steps, definite = np.empty_like(gradient), np.empty(len(rows), dtype=bool)
        if not self._far:
            constant = self._assembly.chains
            for here in _chunks(len(rows), constant.data[0].size):
                chains = constant.take(self._assembly.row[which[here]])
                for wired, part in parts:
                    wired.add_lower(part[here], chains)
                steps[here], definite[here] = chains.solve(-gradient[here])
            return steps, definite
        for here in _chunks(len(rows), gradient[0].size * gradient.shape[-1]):
            links = tuple((places, part[rows[here]]) for places, part in self._far)
            blocks = self._assembly.held_hessian(which[here])
            for wired, part in parts:
                wired.add_hessian(part[here], *blocks)
            steps[here], definite[here] = solve_each(*blocks, links, -gradient[here])
        return steps, definite

    def systems(self, rows: Index) -> Iterator[tuple[int, System]]:
        """Each of some rows with its Hessian, laid out a few at a time."""
        for here in _chunks(len(rows), self.gradient[0].size * self.gradient.shape[-1]):
            chunk = rows[here]
            for b, diagonal, upper in zip(chunk.tolist(), *self.hessian(chunk), strict=True):
                yield b, System(diagonal, upper, tuple((i, part[b]) for i, part in self._far))


class Assembly:
    """Vectorised view of models that share their nonlinear terms (those of one `build`).

    Args:
        models: One per hypothesis.

    Attributes:
        pace: What a start took in the last iteration of a solver [s].

    Raises:
        ValueError: the models do not share their terms, a hypothesis's own term is not linear, or
            a user's factor is on a variable that does not exist.
    """

    def __init__(self, models: Sequence[Model]) -> None:
        self.models = tuple(models)
        first = self.models[0]
        if any(m.shared is not first.shared or m.columns != first.columns for m in self.models):
            raise ValueError("models of one assembly must come from one build")
        if not all(isinstance(term.residual, Linear) for m in self.models for term in m.own):
            raise ValueError("the terms that differ by hypothesis must be linear")
        self.pace = 0.0
        self.reference = np.stack([model.reference for model in self.models])
        _, S, D = self.reference.shape
        self.free = np.ones((S, D), dtype=bool)
        for name, k in first.fixed:
            self.free[k, first.columns[name]] = False
        self.order = _interleaved(first)
        curved = [term for term in first.shared if not isinstance(term.residual, Linear)]
        self.nonlinear = [_wire(term, first.columns, self.order) for term in _fused(curved)]
        self.nonlinear += [_wire_user(factor, first, self.order) for factor in first.extra]
        self._known = np.flatnonzero(~self.free.all(axis=1)).tolist()
        self.nonlinear = [self._held(wired) for wired in self.nonlinear]
        self.held = [(k, np.flatnonzero(~self.free[k])) for k in self._known]
        self._add_linear()

    def _held(self, wired: _Wired) -> _Wired:
        """With masks for what is known without error, so that it has no curvature."""
        first, held = wired.first, []
        steps = range(first.start, first.stop, first.step or 1)
        if wired.far is None:
            touched = {k - o for k in self._known for o, _, _ in wired.runs}
        else:
            touched = set(steps)
        for at, k in enumerate(steps):
            if k not in touched:
                continue
            if wired.far is not None:
                free = self.free.reshape(-1)[wired.far]
            else:
                free = np.concatenate([self.free[k + o, columns] for o, columns, _ in wired.runs])
            if not free.all():
                held.append((at, np.outer(free, free) if free.any() else None))
        return replace(wired, held=tuple(held)) if held else wired

    def wired(self, which: int) -> Iterator[tuple[_Wired, Term]]:
        """All terms of one hypothesis with their places in the state, then the user's factors."""
        model = self.models[which]
        for term in model.terms:
            yield _wire(term, model.columns, self.order), term
        for factor in model.extra:
            wired = _wire_user(factor, model, self.order)
            yield wired, Term("yours", wired.residual, (), range(1))

    def linear_terms(self, which: int) -> Iterator[tuple[_Wired, Linear]]:
        """The linear-Gaussian terms of one hypothesis, with their places in the state."""
        for wired, term in self.wired(which):
            if isinstance(term.residual, Linear):
                yield wired, term.residual

    def _add_linear(self) -> None:
        """The constant Hessian, and energy and gradient of the linear terms at the reference."""
        K, S, D = self.reference.shape
        # Plans that differ only in where they lead share one constant Hessian.
        alike = all(_same_curvature(model, self.models[0]) for model in self.models)
        self.row = np.zeros(K, dtype=np.intp) if alike else np.arange(K)
        self._diagonal = np.zeros((self.row[-1] + 1, S, D, D))
        self._upper = np.zeros((self.row[-1] + 1, S - 1, D, D))
        self.gradient, self.constant = np.zeros((K, S, D)), np.zeros(K)
        columns = self.models[0].columns
        for term in self.models[0].shared:
            if isinstance(term.residual, Linear):
                wired = _wire(term, columns, self.order)
                part = term.residual.gauss_newton(*wired.variables(self.reference))
                self.constant += part.energy.sum(-1)
                wired.add_gradient(part.gradient, self.gradient)
                wired.add_hessian(part.hessian[:1], self._diagonal, self._upper)
        for i, model in enumerate(self.models):
            row = self.row[i]
            for term in model.own:
                wired = _wire(term, columns, self.order)
                part = term.residual.gauss_newton(*wired.variables(model.reference))
                self.constant[i] += float(part.energy.sum())
                wired.add_gradient(part.gradient, self.gradient[i])
                if i == 0 or row > 0:
                    wired.add_hessian(part.hessian, self._diagonal[row], self._upper[row])
        self._sparse = [
            _sparse(*blocks) for blocks in zip(self._diagonal, self._upper, strict=True)
        ]
        self._held_diagonal, self._held_upper = self._diagonal.copy(), self._upper.copy()
        self.hold_fixed(self._held_diagonal, self._held_upper)

    @cached_property
    def linked(self) -> NDArray[np.bool_]:
        """Which coordinates may be linked to which of the next step by what is not far, (D, D)."""
        linked: NDArray[np.bool_] = np.any(self._upper, axis=(0, 1))
        for wired in self.nonlinear:
            for at_row, into_rows, _ in wired.runs:
                for at_column, into_columns, _ in wired.runs:
                    if wired.far is None and at_row < at_column:
                        linked[into_rows, into_columns] = True
        return linked

    @cached_property
    def chains(self) -> Chains:
        """The constant Hessians in a band that has room for all that is not far."""
        return Chains.of(self._held_diagonal, self._held_upper, self.order, self.linked)

    @cached_property
    def dimension(self) -> int:
        """Number of free scalar variables."""
        return int(self.free.sum())

    def energy(self, X: Array, which: Index) -> Array:
        """−log of the unnormalised density.

        Args:
            X: States, shape (..., S, D).
            which: Hypothesis of each, broadcasting against the leading axes of X.
        """
        which = np.broadcast_to(which, X.shape[:-2])
        with np.errstate(over="ignore", invalid="ignore"):  # inf and nan are checked by callers
            d = X - self.reference[which]
            linear = self.gradient[which] + 0.5 * self.times(d, which)
            return np.asarray(self.constant[which] + _dot(linear, d) + self.potentials(X))

    def expand(self, X: Array, which: Index) -> Quadratic:
        """Second-order expansion with the true Hessian; X has shape (B, S, D)."""
        return Quadratic(self, X, which, lambda residual, x: residual.expand(*x))

    def gauss_newton(self, X: Array, which: Index) -> Quadratic:
        """The same with the Gauss–Newton Hessian, which is positive semidefinite."""
        return Quadratic(self, X, which, lambda residual, x: residual.gauss_newton(*x))

    def along(
        self, q: Quadratic, X: Array, step: Array, which: Index
    ) -> Callable[[Array, Index], Array]:
        """Energies on the lines X + s·step, as a function of lengths s (L, R) and rows (R,) of the
        B lines, shape (L, R).

        The linear-Gaussian part is exactly quadratic on the line. With wheels the line is the
        curve on which `moved` goes.
        """
        if self.motion is not None:

            def along_the_curve(s: Array, rows: Index) -> Array:
                there = self.moved(X[rows], s[..., None, None] * step[rows])
                return self.energy(there, which[rows])

            return along_the_curve
        slope = _dot(q.linear_gradient, step)
        curvature = _dot(self.times(step, which), step)

        def energies(s: Array, rows: Index) -> Array:
            with np.errstate(over="ignore", invalid="ignore"):
                linear = q.linear_energy[rows] + s * slope[rows] + 0.5 * s**2 * curvature[rows]
                at = X[rows] + s[..., None, None] * step[rows]
                return np.asarray(linear + self.potentials(at))

        return energies

    @cached_property
    def motion(self) -> UnicycleMotion | None:
        """How a robot with wheels moves; None for one that moves linearly in its states."""
        residuals = (term.residual for term in self.models[0].shared)
        return next((r for r in residuals if isinstance(r, UnicycleMotion)), None)

    def shear(self, reference: Array) -> Shear | None:
        """Coordinates in which a robot with wheels moves linearly, around states (..., S, D); None
        where it does anyway."""
        if self.motion is None:
            return None
        return Shear(self.motion, self.models[0].columns["robot"], reference)

    def moved(self, X: Array, step: Array) -> Array:
        """X + step; a robot with wheels is moved along its curves, so that a step which keeps its
        motion to first order keeps it to any length."""
        shear = self.shear(X)
        return X + step if shear is None else shear.bend(X + step)

    def times(self, d: Array, which: Index) -> Array:
        """Constant Hessian times d, shape (..., S, D)."""
        columns = d.reshape(-1, d.shape[-2] * d.shape[-1]).T
        if len(self._sparse) == 1:
            product = self._sparse[0] @ columns
        else:
            product = np.empty_like(columns)
            row = np.broadcast_to(self.row[which], d.shape[:-2]).ravel()
            for i in np.unique(row):
                product[:, row == i] = self._sparse[i] @ columns[:, row == i]
        return np.ascontiguousarray(product.T).reshape(d.shape)

    def linear_hessian(self, which: Index) -> tuple[Array, Array]:
        """Copies of the constant Hessian blocks, one per hypothesis asked for."""
        rows = self.row[which]
        return self._diagonal[rows], self._upper[rows]

    def held_hessian(self, which: Index) -> tuple[Array, Array]:
        """The same with `hold_fixed` applied."""
        rows = self.row[which]
        return self._held_diagonal[rows], self._held_upper[rows]

    def hold_fixed(self, diagonal: Array, upper: Array) -> None:
        """A state known without error does not move: unit curvature, no link to others."""
        hold(self.free, diagonal, upper)

    def potentials(self, X: Array) -> Array:
        """Energy of what is not linear-Gaussian, never negative; X has shape (..., S, D)."""
        total = np.zeros(X.shape[:-2])
        for wired in self.nonlinear:
            total += wired.residual.energy(*wired.variables(X)).sum(-1)
        return total


def hold(free: NDArray[np.bool_], diagonal: Array, upper: Array) -> None:
    """Coordinates that are not free (S, D) get unit curvature and no link to others, in place.

    Args:
        free: Shape (S, D).
        diagonal: Blocks (B, S, D, D).
        upper: Blocks (B, S − 1, D, D).
    """
    for k in np.flatnonzero(~free.all(axis=1)):
        held = np.flatnonzero(~free[k])
        diagonal[:, k, held, :] = 0
        diagonal[:, k, :, held] = 0
        diagonal[:, k, held, held] = 1
        if k < upper.shape[1]:
            upper[:, k, held, :] = 0
        if k > 0:
            upper[:, k - 1, :, held] = 0


def _clamped(H: Array) -> Array:
    """Symmetric (..., 2, 2) blocks without their negative eigenvalues."""
    a, b, c = H[..., 0, 0], H[..., 1, 1], H[..., 0, 1]
    middle, half = 0.5 * (a + b), 0.5 * (a - b)
    radius = np.sqrt(half * half + c * c)
    high, low = np.maximum(middle + radius, 0.0), np.maximum(middle - radius, 0.0)
    # H = middle + radius·R with R² = 1, and so is the result.
    mean, scale = 0.5 * (high + low), 0.5 * (high - low) / np.maximum(radius, 1e-300)
    out = np.empty_like(H)
    out[..., 0, 0], out[..., 1, 1] = mean + scale * half, mean - scale * half
    out[..., 0, 1] = out[..., 1, 0] = scale * c
    return out


def _chunks(count: int, size: int) -> Iterator[slice]:
    """As many of `count` items of a size at once as `CHUNK` has room for."""
    some = max(1, CHUNK // size)
    for at in range(0, count, some):
        yield slice(at, at + some)


def _interleaved(model: Model) -> Index:
    """Place of each coordinate in the band: each of the people's positions beside its velocity,
    with which alone the prior links it in the next step."""
    order = np.arange(model.reference.shape[1])
    if "crowd" in model.columns:
        crowd = model.columns["crowd"]
        half = (crowd.stop - crowd.start) // 2
        order[crowd] = crowd.start + np.arange(2 * half).reshape(half, 2).T.ravel()
    return order


def _progressions(values: list[int]) -> Iterator[tuple[int, int]]:
    """Ranges of indices in which values grow by equal steps."""
    start = 0
    while start < len(values):
        end = start + 1
        step = values[end] - values[start] if end < len(values) else 0
        while step > 0 and end < len(values) and values[end] - values[end - 1] == step:
            end += 1
        yield start, end
        start = end


def _fused(terms: Sequence[Term]) -> Iterator[Term]:
    """The terms, those between the robot and the same held people as one: where people are is
    then looked at once."""
    alike: dict[tuple[int, range], list[tuple[Term, PredictedPairs]]] = {}
    for term in terms:
        if isinstance(term.residual, PredictedPairs):
            key = (id(term.residual.people), term.steps)
            alike.setdefault(key, []).append((term, term.residual))
        else:
            yield term
    for group in alike.values():
        term, pairs = group[0]
        potential = Together(tuple(own.potential for _, own in group))
        yield replace(term, residual=replace(pairs, potential=potential))


def _same_curvature(a: Model, b: Model) -> bool:
    # A waypoint without a time is on other steps in another hypothesis.
    return len(a.own) == len(b.own) and all(
        one.steps == other.steps
        and one.variables == other.variables
        and all(
            np.array_equal(x, y)
            for x, y in zip(one.residual.A, other.residual.A, strict=True)  # type: ignore[attr-defined]
        )
        for one, other in zip(a.own, b.own, strict=True)
    )


def _sparse(diagonal: Array, upper: Array) -> csr_array:
    """A chain, of which most blocks are nearly empty, as a sparse matrix."""
    S, D, _ = diagonal.shape
    first = D * np.arange(S)[:, None]
    a, b = np.nonzero(diagonal.any(axis=0))
    rows, columns, values = [first + a], [first + b], [diagonal[:, a, b]]
    a, b = np.nonzero(upper.any(axis=0))
    here, there = first[:-1] + a, first[1:] + b
    rows, columns = [*rows, here, there], [*columns, there, here]
    values += 2 * [upper[:, a, b]]
    data, row, column = (
        np.concatenate([part.ravel() for part in parts]) for parts in (values, rows, columns)
    )
    return csr_array((data, (row, column)), shape=(S * D, S * D))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("...sd,...sd->...", a, b))


def _wire(term: Term, columns: dict[str, slice], order: Index) -> _Wired:
    first = slice(term.steps.start, term.steps.stop, term.steps.step)
    slots = tuple((_moved(first, offset), columns[name]) for name, offset in term.variables)
    places = [(offset, columns[name]) for name, offset in term.variables]
    return _wired(term.residual, slots, first, places, order)


def _wired(
    residual: Residual,
    slots: tuple[tuple[slice, slice], ...],
    first: slice,
    places: Sequence[tuple[int, slice]],
    order: Index,
) -> _Wired:
    """With variables at (offset in time, slice of the state)."""
    runs, blocks = _layout(
        tuple((offset, c.start, c.stop) for offset, c in places),
        residual.support.tobytes(),
        order.tobytes(),
    )
    band = tuple(_Part(_moved(first, offset), *block) for offset, *block in blocks)
    return _Wired(residual, slots, first, runs, band=band)


def _moved(steps: slice, offset: int) -> slice:
    return slice(steps.start + offset, steps.stop + offset, steps.step)


_Run = tuple[int, slice, slice]


@lru_cache(maxsize=1024)
def _layout(
    places: tuple[tuple[int, int, int], ...], support: bytes, order: bytes
) -> tuple[tuple[_Run, ...], tuple[tuple[Any, ...], ...]]:
    """Contiguous runs of the support of variables at (offset in time, start, stop) of the state,
    and where the blocks of an expansion are in a band of that order: a `_Part`, with the offset
    in time for the steps."""
    used = np.frombuffer(support, dtype=np.intp)
    column = np.concatenate([np.arange(a, b) for _, a, b in places])[used]
    offset = np.concatenate([np.full(b - a, o) for o, a, b in places])[used]
    breaks = np.flatnonzero((np.diff(column) != 1) | (np.diff(offset) != 0)) + 1
    runs = tuple(
        (int(offset[a]), slice(int(column[a]), int(column[b - 1]) + 1), slice(a, b))
        for a, b in pairwise([0, *breaks.tolist(), len(column)])
    )
    split: list[_Run] = []
    for at, columns, rows in runs:
        where = np.frombuffer(order, dtype=np.intp)[columns]
        for a, b in _progressions(where.tolist()):
            step = int(where[a + 1] - where[a]) if b - a > 1 else 1
            places_in = slice(int(where[a]), int(where[b - 1]) + 1, step)
            split.append((at, places_in, slice(rows.start + a, rows.start + b)))
    blocks: list[tuple[Any, ...]] = []
    for at_row, into_rows, rows in split:
        for at_column, into_columns, columns in split:
            if at_row > at_column:
                continue
            below = np.ones((1, 1), dtype=bool)
            if at_row == at_column:
                i, j = (np.arange(s.start, s.stop, s.step) for s in (into_rows, into_columns))
                below = i[:, None] >= j
            if below.any():
                mask = None if below.all() else below
                into, out_of = (into_rows, into_columns), (rows, columns)
                blocks.append((at_row, at_row < at_column, into, out_of, mask))
    return runs, tuple(blocks)


class _UserFactor(Residual):
    """A user's GTSAM factor as a residual, through its own error and linearization."""

    def __init__(self, factor: gtsam.NonlinearFactor, dims: tuple[int, ...]) -> None:
        self._factor, self._dims = factor, dims

    @property
    def dims(self) -> tuple[int, ...]:
        return self._dims

    @property
    def rows(self) -> int:
        return int(self._factor.dim())

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        raise TypeError("a GTSAM factor gives its information matrix, not its Jacobians")

    def _each(self, x: tuple[Array, ...]) -> Iterator[gtsam.Values]:
        for point in zip(*(xi.reshape(-1, xi.shape[-1]) for xi in x), strict=True):
            values = gtsam.Values()
            for key, part in zip(self._factor.keys(), point, strict=True):
                values.insert(key, part)
            yield values

    def energy(self, *x: Array) -> Array:
        each = [self._factor.error(values) for values in self._each(x)]
        return np.array(each, dtype=float).reshape(x[0].shape[:-1])

    def gauss_newton(self, *x: Array) -> Expansion:
        size = sum(self._dims)
        batch = x[0].shape[:-1]
        augmented = np.array([self._information(values) for values in self._each(x)])
        augmented = augmented.reshape(*batch, size + 1, size + 1)
        return Expansion(
            self.energy(*x), -augmented[..., :size, size], augmented[..., :size, :size]
        )

    def _information(self, values: gtsam.Values) -> Array:
        linear = self._factor.linearize(values)
        if linear is None:  # the factor is not active here
            return np.zeros((sum(self._dims) + 1,) * 2)
        return np.asarray(linear.augmentedInformation())


def _wire_user(factor: gtsam.NonlinearFactor, model: Model, order: Index) -> _Wired:
    place = {key: (k, model.columns[name]) for (name, k), key in model.keys.items()}
    unknown = [keys.name(key) for key in factor.keys() if key not in place]
    if unknown:
        raise ValueError(
            f"a factor of yours is on {unknown}, which this density does not have; its variables "
            f"are {[v.name for v in model.variables]}, steps 0..{len(model.times) - 1}"
        )
    places = [place[key] for key in factor.keys()]
    steps = [k for k, _ in places]
    start = min(steps)
    slots = tuple((slice(k, k + 1), columns) for k, columns in places)
    dims = tuple(columns.stop - columns.start for _, columns in places)
    first, offsets = slice(start, start + 1), [(k - start, c) for k, c in places]
    wired = _wired(_UserFactor(factor, dims), slots, first, offsets, order)
    if max(steps) - start > 1:
        D = model.reference.shape[1]
        far = np.concatenate([k * D + np.arange(c.start, c.stop) for k, c in places])
        return replace(wired, band=(), far=far)
    return wired
