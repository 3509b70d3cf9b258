"""The density of all hypotheses at once, as numpy sees it: energy, gradient and Hessian.

The linear-Gaussian part is assembled once. What is left (interaction, contact, obstacles, limits,
the user's own factors) is shared by all hypotheses; it is evaluated for all starts and all time
steps in one call a term, and its curvature is kept in small blocks until a system is solved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from factors.residual import Expansion, Linear, Residual
from factors.unicycle import UnicycleMotion
from fgplan.backend import Backend, fastest
from fgplan.block_tridiagonal import Chains, System, chunks, solve_each
from fgplan.entries import Entries, Piece
from fgplan.model import Model, Term
from fgplan.shear import Shear
from fgplan.systems import Systems
from fgplan.wiring import Wired, interleaved, wire, wire_user

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Expand = Callable[[Residual, list[Array]], Expansion]


_BY_ROW = ("linear_gradient", "linear_energy", "energy", "gradient", "states", "which")
"""What a `Quadratic` holds one of for each expansion, beside its parts."""


class Quadratic:
    """Expansion of B energies at states (B, S, D).

    Attributes:
        states: Where, shape (B, S, D).
        which: Hypothesis of each, shape (B,).
        energy: Shape (B,).
        gradient: Shape (B, S, D).
    """

    def __init__(
        self,
        assembly: Assembly,
        X: Array,
        which: Index,
        expand: Expand,
        nonlinear: Sequence[Wired] | None = None,
    ) -> None:
        self._assembly, self.states, self.which = assembly, X, which
        d = X - assembly.reference[which]
        curve = assembly.times(d, which)
        self.linear_gradient = assembly.gradient[which] + curve
        self.linear_energy = assembly.constant[which] + _dot(self.linear_gradient - 0.5 * curve, d)
        self.energy = self.linear_energy.copy()
        self.gradient = self.linear_gradient.copy()
        self._parts: list[tuple[Wired, Array]] = []
        self._far: list[tuple[Index, Array]] = []
        for wired in assembly.nonlinear if nonlinear is None else nonlinear:
            with np.errstate(over="ignore", invalid="ignore"):  # as in `Assembly.energy`
                part = expand(wired.residual, wired.variables(X))
            self.energy += np.add.reduce(part.energy, axis=-1)
            wired.add_gradient(part.gradient, self.gradient)
            wired.hold(part.hessian)
            if wired.far is None:
                self._parts.append((wired, part.hessian))
            else:
                self._far.append((wired.far, part.hessian[:, 0]))
        self._hold()

    def _hold(self) -> None:
        """What is known without error has no slope."""
        for k, held in self._assembly.held:
            self.gradient[:, k, held] = 0.0

    def take(self, rows: Index) -> Quadratic:
        """The expansions in some rows."""
        some = copy(self)
        for laid_out in ("diagonal", "upper"):
            some.__dict__.pop(laid_out, None)
        for name in _BY_ROW:
            setattr(some, name, getattr(self, name)[rows])
        some._parts = [(wired, part[rows]) for wired, part in self._parts]
        some._far = [(places, part[rows]) for places, part in self._far]
        return some

    def put(self, rows: Index, other: Quadratic) -> None:
        """Other expansions in place of those in some rows."""
        for name in _BY_ROW:
            getattr(self, name)[rows] = getattr(other, name)
        for mine, theirs in ((self._parts, other._parts), (self._far, other._far)):
            for (_, part), (_, new) in zip(mine, theirs, strict=True):
                part[rows] = new

    def hessian(self, rows: Index) -> tuple[Array, Array]:
        """Blocks (k, k), shape (R, S, D, D), and (k, k + 1), shape (R, S − 1, D, D), of some of
        the B Hessians."""
        diagonal, upper = self._assembly.held_hessian(self.which[rows])
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

    def newton(self) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """Steps −H⁻¹ g of all B expansions, shape (B, S, D), zero where H is not positive definite,
        where it is (B,), and which steps are of use (B,)."""
        steps, definite = self._solve(self.which, self.gradient, self._parts)
        return steps, definite, definite

    def confirmed(self, rows: Index) -> NDArray[np.bool_]:
        """Whether some of those where H was found positive definite are known to be, shape (R,)."""
        return np.ones(len(rows), dtype=bool)

    def flattened(self, rows: Index) -> tuple[Array, NDArray[np.bool_]]:
        """The same of some of them without what curves downwards, shape (R, S, D) and (R,): small
        blocks lose their negative eigenvalues, larger ones are Gauss–Newton's."""
        parts = []
        for wired, part in self._parts:
            if wired.residual.convex:
                parts.append((wired, part[rows]))
            elif part.shape[-1] == 2:
                parts.append((wired, clamped(part[rows])))
            else:
                flat = wired.residual.gauss_newton(*wired.variables(self.states[rows])).hessian
                wired.hold(flat)
                parts.append((wired, flat))
        return self._solve(self.which[rows], self.gradient[rows], parts, rows)

    def _solve(
        self,
        which: Index,
        gradient: Array,
        parts: Sequence[tuple[Wired, Array]],
        rows: Index | slice = slice(None),
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Newton steps of the expansions in some rows, with their hypotheses, gradients and
        curvature."""
        assembly = self._assembly
        if not self._far:
            return assembly.systems(assembly.row[which], parts, gradient)
        steps, definite = np.empty_like(gradient), np.empty(len(which), dtype=bool)
        far = [(places, part[rows]) for places, part in self._far]
        for here in chunks(len(which), gradient[0].size * gradient.shape[-1]):
            links = tuple((places, part[here]) for places, part in far)
            blocks = assembly.held_hessian(which[here])
            for wired, part in parts:
                wired.add_hessian(part[here], *blocks)
            steps[here], definite[here] = solve_each(*blocks, links, -gradient[here])
        return steps, definite

    def systems(self, rows: Index) -> Iterator[tuple[int, System]]:
        """Each of some rows with its Hessian, laid out a few at a time."""
        for here in chunks(len(rows), self.gradient[0].size * self.gradient.shape[-1]):
            chunk = rows[here]
            for b, diagonal, upper in zip(chunk.tolist(), *self.hessian(chunk), strict=True):
                yield b, System(diagonal, upper, tuple((i, part[b]) for i, part in self._far))


class Assembly:
    """Vectorised view of models that share their nonlinear terms (those of one `build`).

    Args:
        models: One per hypothesis.
        backend: What its terms and systems are computed with; by default the fastest there is.

    Attributes:
        pace: What a start took in the last iteration of a solver [s].
        entries: The constant part of the Hessians, of which `row` says whose each is.

    Raises:
        ValueError: the models do not share their terms, a hypothesis's own term is not linear, or
            a user's factor is on a variable that does not exist.
    """

    def __init__(self, models: Sequence[Model], backend: Backend | None = None) -> None:
        self.models = tuple(models)
        self.backend = fastest() if backend is None else backend
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
        self.order = interleaved(first)
        curved = [term for term in first.shared if not isinstance(term.residual, Linear)]
        self.terms = tuple(self.backend.fused(curved))
        self.nonlinear = [wire(term, first.columns, self.order) for term in self.terms]
        self.nonlinear += [wire_user(factor, first, self.order) for factor in first.extra]
        self._known = np.flatnonzero(~self.free.all(axis=1)).tolist()
        self.nonlinear = [self._held(wired) for wired in self.nonlinear]
        self.held = [(k, np.flatnonzero(~self.free[k])) for k in self._known]
        self._add_linear()

    def _held(self, wired: Wired) -> Wired:
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

    def wired(self, which: int) -> Iterator[tuple[Wired, Term]]:
        """All terms of one hypothesis with their places in the state, then the user's factors."""
        model = self.models[which]
        for term in model.terms:
            yield wire(term, model.columns, self.order), term
        for factor in model.extra:
            wired = wire_user(factor, model, self.order)
            yield wired, Term("yours", wired.residual, (), range(1))

    def linear_terms(self, which: int) -> Iterator[tuple[Wired, Linear]]:
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
        self.gradient, self.constant = np.zeros((K, S, D)), np.zeros(K)
        pieces: list[tuple[slice, Piece]] = []
        columns = self.models[0].columns
        for term in self.models[0].shared:
            if isinstance(term.residual, Linear):
                wired = wire(term, columns, self.order)
                part = term.residual.gauss_newton(*wired.variables(self.reference))
                self.constant += part.energy.sum(-1)
                wired.add_gradient(part.gradient, self.gradient)
                block = term.residual.information
                pieces += [(slice(None), piece) for piece in wired.constant(block)]
        for i, model in enumerate(self.models):
            row = self.row[i]
            for term in model.own:
                assert isinstance(term.residual, Linear)  # or there is no assembly
                wired = wire(term, columns, self.order)
                part = term.residual.gauss_newton(*wired.variables(model.reference))
                self.constant[i] += float(part.energy.sum())
                wired.add_gradient(part.gradient, self.gradient[i])
                if i == 0 or row > 0:
                    block = term.residual.information
                    pieces += [(slice(row, row + 1), piece) for piece in wired.constant(block)]
        self.entries = Entries.of((self.row[-1] + 1, S, D), pieces)
        chains = range(len(self.entries.own.values))
        self._products = [self.backend.product(self.entries, row) for row in chains]

    @cached_property
    def linked(self) -> NDArray[np.bool_]:
        """Which coordinates may be linked to which of the next step by what is not far, (D, D)."""
        linked = self.entries.ahead.mask
        for wired in self.nonlinear:
            for at_row, into_rows, _ in wired.runs:
                for at_column, into_columns, _ in wired.runs:
                    if wired.far is None and at_row < at_column:
                        linked[into_rows, into_columns] = True
        return linked

    @cached_property
    def chains(self) -> Chains:
        """The constant Hessians in a band that has room for all that is not far."""
        held = self.held_hessian(np.unique(self.row, return_index=True)[1])
        return Chains.of(*held, self.order, self.linked)

    @cached_property
    def systems(self) -> Systems:
        """What solves for steps."""
        return self.backend.systems(self.chains)

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
        self, q: Quadratic, ahead: Quadratic, step: Array, rows: Index
    ) -> Callable[[Array, Index], Array]:
        """Energies on R lines, as a function of lengths s (L, N) and of which lines (N,), shape
        (L, N).

        The linear-Gaussian part is exactly quadratic on a line. With wheels the line is the
        curve on which `moved` goes.

        Args:
            q: B expansions.
            ahead: Those at the ends of R full steps.
            step: The steps of the B, shape (B, S, D).
            rows: Which of the B the lines are of, shape (R,).
        """
        if self.motion is not None:

            def along_the_curve(s: Array, some: Index) -> Array:
                d, which = step[rows[some]], q.which[rows[some]]
                there = self.moved(q.states[rows[some]], s[..., None, None] * d)
                return self.energy(there, which)

            return along_the_curve

        def energies(s: Array, some: Index) -> Array:
            start = rows[some]
            d, before = step[start], q.linear_gradient[start]
            slope = _dot(before, d)
            curvature = _dot(ahead.linear_gradient[some] - before, d)
            with np.errstate(over="ignore", invalid="ignore"):
                linear = q.linear_energy[start] + s * slope + 0.5 * s**2 * curvature
                at = q.states[start] + s[..., None, None] * d
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
        flat = d.reshape(-1, *d.shape[-2:])
        if len(self._products) == 1:
            return self._products[0](flat).reshape(d.shape)
        product = np.empty_like(flat)
        rows = np.broadcast_to(self.row[which], d.shape[:-2]).ravel()
        for i in np.unique(rows):
            product[rows == i] = self._products[i](flat[rows == i])
        return product.reshape(d.shape)

    def linear_hessian(self, which: Index) -> tuple[Array, Array]:
        """The constant Hessian blocks, laid out, one per hypothesis asked for."""
        return self.entries.blocks(self.row[which])

    def held_hessian(self, which: Index) -> tuple[Array, Array]:
        """The same with `hold_fixed` applied."""
        diagonal, upper = self.linear_hessian(which)
        self.hold_fixed(diagonal, upper)
        return diagonal, upper

    def hold_fixed(self, diagonal: Array, upper: Array) -> None:
        """A state known without error does not move: unit curvature, no link to others."""
        hold(self.free, diagonal, upper)

    def potentials(self, X: Array) -> Array:
        """Energy of what is not linear-Gaussian, never negative; X has shape (..., S, D)."""
        total = np.zeros(X.shape[:-2])
        for wired in self.nonlinear:
            total += np.add.reduce(wired.residual.energy(*wired.variables(X)), axis=-1)
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


def clamped(H: Array) -> Array:
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


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("...sd,...sd->...", a, b))
