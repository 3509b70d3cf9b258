"""The density of all hypotheses at once, as numpy sees it: energy, gradient and Hessian.

The linear-Gaussian part is assembled once. What is left (interaction, contact, obstacles, limits)
is shared by all hypotheses and is evaluated for all starts and all time steps in one call a term.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.residual import Expansion, Linear, Residual
from fgplan import keys
from fgplan.model import Model, Term

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class Quadratic(NamedTuple):
    """Expansion of B energies: (B,), (B, S, D), (B, S, D, D) and (B, S − 1, D, D)."""

    energy: Array
    gradient: Array
    diagonal: Array
    upper: Array


class NotAChain(ValueError):
    """A user's factor connects time steps that are not neighbours."""


@dataclass(frozen=True, eq=False)
class _Wired:
    """A term with the places of its variables in the state.

    `runs` are contiguous runs of the residual's support: (offset in time, slice of the state,
    slice of the expansion).
    """

    residual: Residual
    slots: tuple[tuple[slice, slice], ...]
    first: slice
    runs: tuple[tuple[int, slice, slice], ...]

    def variables(self, X: Array) -> list[Array]:
        return [X[..., steps, columns] for steps, columns in self.slots]


class Assembly:
    """Vectorised view of models that share their nonlinear terms (those of one `build`).

    Args:
        models: One per hypothesis.

    Raises:
        ValueError: the models do not share their terms, or a hypothesis's own term is not linear.
    """

    def __init__(self, models: Sequence[Model]) -> None:
        self.models = tuple(models)
        first = self.models[0]
        if any(m.shared is not first.shared or m.columns != first.columns for m in self.models):
            raise ValueError("models of one assembly must come from one build")
        if not all(isinstance(term.residual, Linear) for m in self.models for term in m.own):
            raise ValueError("the terms that differ by hypothesis must be linear")
        self.reference = np.stack([model.reference for model in self.models])
        S, D = first.reference.shape
        self._nonlinear = [
            _wire(term, first.columns)
            for term in first.shared
            if not isinstance(term.residual, Linear)
        ]
        K = len(self.models)
        # Plans that differ only in where they lead share one constant Hessian.
        alike = all(_same_curvature(model, first) for model in self.models)
        self._row = np.zeros(K, dtype=np.intp) if alike else np.arange(K)
        self._diagonal = np.zeros((self._row[-1] + 1, S, D, D))
        self._upper = np.zeros((self._row[-1] + 1, S - 1, D, D))
        self._gradient = np.zeros((K, S, D))
        self._constant = np.zeros(K)
        for i, model in enumerate(self.models):
            for term in model.terms:
                if isinstance(term.residual, Linear):
                    self._add_linear(i, model, term)
        self._extra = [_ExtraFactor(factor, first) for factor in first.extra]
        self.free = np.ones((S, D), dtype=bool)
        for name, k in first.fixed:
            self.free[k, first.columns[name]] = False

    @property
    def dimension(self) -> int:
        """Number of free scalar variables."""
        return int(self.free.sum())

    def energy(self, X: Array, which: Index) -> Array:
        """−log of the unnormalised density.

        Args:
            X: States, shape (..., S, D).
            which: Hypothesis of each, broadcasting against the leading axes of X.
        """
        with np.errstate(over="ignore", invalid="ignore"):  # inf and nan are checked by callers
            d = X - self.reference[which]
            curve = self._times(d, which)
            energy = self._constant[which] + _dot(self._gradient[which] + 0.5 * curve, d)
            for wired in self._nonlinear:
                energy = energy + wired.residual.energy(*wired.variables(X)).sum(-1)
            for factor in self._extra:
                energy = energy + factor.energy(X)
        return np.asarray(energy)

    def expand(self, X: Array, which: Index) -> Quadratic:
        """Second-order expansion with the true Hessian; X has shape (B, S, D)."""
        return self._expand(X, which, lambda residual, x: residual.expand(*x))

    def gauss_newton(self, X: Array, which: Index) -> Quadratic:
        """The same with the Gauss–Newton Hessian, which is positive semidefinite."""
        return self._expand(X, which, lambda residual, x: residual.gauss_newton(*x))

    def _expand(
        self, X: Array, which: Index, expansion: Callable[[Residual, list[Array]], Expansion]
    ) -> Quadratic:
        B = len(X)
        d = X - self.reference[which]
        curve = self._times(d, which)
        gradient = self._gradient[which] + curve
        energy = self._constant[which] + _dot(gradient - 0.5 * curve, d)
        rows = self._row[which]
        diagonal, upper = self._diagonal[rows], self._upper[rows]
        for wired in self._nonlinear:
            part = expansion(wired.residual, wired.variables(X))
            energy = energy + part.energy.sum(-1)
            _scatter(wired, part, gradient, diagonal, upper)
        for factor in self._extra:
            for b in range(B):
                energy[b] += factor.add(X[b], gradient[b], diagonal[b], upper[b])
        self._hold_fixed(gradient, diagonal, upper)
        return Quadratic(energy, gradient, diagonal, upper)

    def _hold_fixed(self, gradient: Array, diagonal: Array, upper: Array) -> None:
        """A state known without error does not move: zero gradient, unit curvature."""
        steps = np.flatnonzero(~self.free.all(axis=1))
        for k in steps:
            held = np.flatnonzero(~self.free[k])
            gradient[:, k, held] = 0
            diagonal[:, k, held, :] = 0
            diagonal[:, k, :, held] = 0
            diagonal[:, k, held, held] = 1
            if k < upper.shape[1]:
                upper[:, k, held, :] = 0
            if k > 0:
                upper[:, k - 1, :, held] = 0

    def _times(self, d: Array, which: Index) -> Array:
        """Constant Hessian times d, shape (..., S, D)."""
        rows = self._row[which] if len(self._diagonal) > 1 else 0
        diagonal, upper = self._diagonal[rows], self._upper[rows]
        out = np.matmul(diagonal, d[..., None])[..., 0]
        out[..., :-1, :] += np.matmul(upper, d[..., 1:, :, None])[..., 0]
        out[..., 1:, :] += np.matmul(np.swapaxes(upper, -1, -2), d[..., :-1, :, None])[..., 0]
        return np.asarray(out)

    def _add_linear(self, i: int, model: Model, term: Term) -> None:
        """Add a linear term's gradient at the reference, and its constant Hessian."""
        wired = _wire(term, model.columns)
        part = term.residual.gauss_newton(*wired.variables(model.reference))
        self._constant[i] += float(part.energy.sum())
        row = self._row[i]
        if i == 0 or row > 0:
            _scatter(wired, part, self._gradient[i], self._diagonal[row], self._upper[row])
        else:
            for offset, columns, rows in wired.runs:
                steps = slice(wired.first.start + offset, wired.first.stop + offset)
                self._gradient[i, steps, columns] += part.gradient[..., rows]


def _same_curvature(a: Model, b: Model) -> bool:
    return all(
        np.array_equal(x, y)
        for one, other in zip(a.own, b.own, strict=True)
        for x, y in zip(one.residual.A, other.residual.A, strict=True)  # type: ignore[attr-defined]
    )


def _wire(term: Term, columns: dict[str, slice]) -> _Wired:
    first = slice(term.steps.start, term.steps.stop)
    slots, column, offset_of = [], [], []
    for name, offset in term.variables:
        slots.append((slice(first.start + offset, first.stop + offset), columns[name]))
        size = columns[name].stop - columns[name].start
        column.append(np.arange(columns[name].start, columns[name].stop))
        offset_of.append(np.full(size, offset))
    support = term.residual.support
    places = np.concatenate(column)[support]
    offsets = np.concatenate(offset_of)[support]
    breaks = np.flatnonzero((np.diff(places) != 1) | (np.diff(offsets) != 0)) + 1
    edges = [0, *breaks.tolist(), len(places)]
    runs = tuple(
        (int(offsets[a]), slice(int(places[a]), int(places[b - 1]) + 1), slice(a, b))
        for a, b in pairwise(edges)
    )
    return _Wired(term.residual, tuple(slots), first, runs)


def _scatter(
    wired: _Wired, part: Expansion, gradient: Array, diagonal: Array, upper: Array
) -> None:
    """Add an expansion (..., steps, s) into the chain (..., S, D)."""
    start, stop = wired.first.start, wired.first.stop
    for at_row, into_rows, rows in wired.runs:
        gradient[..., start + at_row : stop + at_row, into_rows] += part.gradient[..., rows]
        for at_column, into_columns, cols in wired.runs:
            block = part.hessian[..., rows, cols]
            if at_row == at_column:
                steps = slice(start + at_row, stop + at_row)
                diagonal[..., steps, into_rows, into_columns] += block
            elif at_row < at_column:
                steps = slice(start + at_row, stop + at_row)
                upper[..., steps, into_rows, into_columns] += block


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("...sd,...sd->...", a, b))


class _ExtraFactor:
    """A user's GTSAM factor, through its own error and linearization."""

    def __init__(self, factor: gtsam.NonlinearFactor, model: Model) -> None:
        self._factor = factor
        place = {key: (k, model.columns[name]) for (name, k), key in model.keys.items()}
        unknown = [key for key in factor.keys() if key not in place]
        if unknown:
            raise ValueError(
                f"a factor of yours is on {[keys.name(k) for k in unknown]}, which this density "
                f"does not have; its variables are {[v.name for v in model.variables]}, "
                f"steps 0..{len(model.times) - 1}"
            )
        self._place = {key: place[key] for key in factor.keys()}
        steps = [k for k, _ in self._place.values()]
        if max(steps) - min(steps) > 1:
            raise NotAChain(f"a factor of yours connects the steps {sorted(set(steps))}")

    def _values(self, X: Array) -> gtsam.Values:
        values = gtsam.Values()
        for key, (k, columns) in self._place.items():
            values.insert(key, X[k, columns])
        return values

    def energy(self, X: Array) -> Array:
        """Energies of states (..., S, D)."""
        flat = X.reshape(-1, *X.shape[-2:])
        each = [self._factor.error(self._values(x)) for x in flat]
        return np.asarray(each).reshape(X.shape[:-2])

    def add(self, X: Array, gradient: Array, diagonal: Array, upper: Array) -> float:
        """Add the linearization at one state (S, D); the energy is returned."""
        values = self._values(X)
        linear = self._factor.linearize(values)
        if linear is not None:  # None: the factor is not active here
            augmented = linear.augmentedInformation()
            ends, edges = 0, []
            for key in linear.keys():
                k, columns = self._place[key]
                size = columns.stop - columns.start
                edges.append((k, columns, slice(ends, ends + size)))
                ends += size
            for k, columns, rows in edges:
                gradient[k, columns] -= augmented[rows, -1]
                for j, others, cols in edges:
                    if j == k:
                        diagonal[k, columns, others] += augmented[rows, cols]
                    elif j == k + 1:
                        upper[k, columns, others] += augmented[rows, cols]
        return float(self._factor.error(values))
