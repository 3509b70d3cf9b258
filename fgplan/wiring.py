"""Where each term of a density has its variables in the state, and its curvature in the band."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.residual import Expansion, Residual
from fgplan import keys
from fgplan.block_tridiagonal import Chains
from fgplan.entries import Piece
from fgplan.model import Model, Term

Array = NDArray[np.float64]
Index = NDArray[np.intp]


PERSON, BAND = 4, 6
"""Coordinates of a person, and width of the band of a chain of x, vx, y, vy."""


class Part(NamedTuple):
    """Where one block of an expansion belongs in the band: steps of the rows, whether the columns
    are of the next step, places in the band, places in the expansion, and which entries are on or
    below the diagonal (None: all)."""

    steps: slice
    next: bool
    into: tuple[slice, slice]
    out_of: tuple[slice, slice]
    mask: NDArray[np.bool_] | None


@dataclass(frozen=True, eq=False)
class Wired:
    """A nonlinear term with the places of its variables in the state.

    `runs` are contiguous runs of the residual's support: (offset in time, slice of the state,
    slice of the expansion). A term that reaches further than the next time step is no part of
    the chain: its curvature is kept apart, on the places `far` of the flattened state. `band` says
    where its blocks are in the band of `Chains`; `places` (s,) says the same of each component, in
    rows of the band from the first of the step on. `held` are
    (which of the steps, mask (s, s)) where some of the support is known without error, None where
    all of it is.
    """

    residual: Residual
    slots: tuple[tuple[slice, slice], ...]
    first: slice
    runs: tuple[tuple[int, slice, slice], ...]
    places: Index
    band: tuple[Part, ...] = ()
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

    def constant(self, block: Array) -> Iterator[Piece]:
        """The same block (s, s) at all its steps; most of a crowd's is zero."""
        for at_row, into_rows, rows in self.runs:
            for at_column, into_columns, columns in self.runs:
                if at_row > at_column:
                    continue
                part = block[rows, columns]
                r, c = np.nonzero(part)
                ahead, steps = at_row < at_column, self.steps(at_row)
                yield Piece(ahead, steps, into_rows.start + r, into_columns.start + c, part[r, c])

    def add_lower(self, part: Array, chains: Chains) -> None:
        """The same into the band, of the diagonal blocks only what is on and below the diagonal."""
        for steps, off, (into_rows, into_columns), (rows, columns), mask in self.band:
            block = part[..., rows, columns]
            if mask is not None:
                block = np.where(mask, block, 0.0)
            blocks = chains.upper if off else chains.diagonal
            blocks[:, steps, into_rows, into_columns] += block


def interleaved(model: Model) -> Index:
    """Place of each coordinate in the band: each position beside its velocity, with which alone the
    prior links it in the next step, and the robot's velocities, which its limits link, side by
    side."""
    order = np.arange(model.reference.shape[1])
    robot = model.columns.get("robot")
    if robot is not None and robot.stop - robot.start == 4:
        order[robot] = robot.start + np.array([0, 3, 1, 2])
    if "crowd" in model.columns:
        crowd = model.columns["crowd"]
        half = (crowd.stop - crowd.start) // 2
        order[crowd] = crowd.start + np.arange(2 * half).reshape(half, 2).T.ravel()
    return order


def wire(term: Term, columns: dict[str, slice], order: Index) -> Wired:
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
) -> Wired:
    """With variables at (offset in time, slice of the state)."""
    runs, blocks, rows = _layout(
        tuple((offset, c.start, c.stop) for offset, c in places),
        residual.support.tobytes(),
        order.tobytes(),
    )
    band = tuple(Part(_moved(first, offset), *block) for offset, *block in blocks)
    return Wired(residual, slots, first, runs, rows, band)


def _moved(steps: slice, offset: int) -> slice:
    return slice(steps.start + offset, steps.stop + offset, steps.step)


_Run = tuple[int, slice, slice]


@lru_cache(maxsize=1024)
def _layout(
    places: tuple[tuple[int, int, int], ...], support: bytes, order: bytes
) -> tuple[tuple[_Run, ...], tuple[tuple[Any, ...], ...], Index]:
    """Contiguous runs of the support of variables at (offset in time, start, stop) of the state;
    where the blocks of an expansion are in a band of that order: a `Part`, with the offset in time
    for the steps; and `Wired.places`."""
    used, place = (np.frombuffer(these, dtype=np.intp) for these in (support, order))
    column = np.concatenate([np.arange(a, b) for _, a, b in places])[used]
    offset = np.concatenate([np.full(b - a, o) for o, a, b in places])[used]
    breaks = np.flatnonzero((np.diff(column) != 1) | (np.diff(offset) != 0)) + 1
    runs = tuple(
        (int(offset[a]), slice(int(column[a]), int(column[b - 1]) + 1), slice(a, b))
        for a, b in pairwise([0, *breaks.tolist(), len(column)])
    )
    split: list[_Run] = []
    for at, columns, rows in runs:
        where = place[columns]
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
    return runs, tuple(blocks), offset * len(place) + place[column]


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


def wire_user(factor: gtsam.NonlinearFactor, model: Model, order: Index) -> Wired:
    place = {key: (k, model.columns[name]) for (name, k), key in model.keys.items()}
    unknown = [keys.name(key) for key in factor.keys() if key not in place]
    if unknown:
        raise ValueError(
            f"a factor of yours is on {unknown}, which this density does not have; its variables "
            f"are {[v.name for v in model.variables]}, steps 0..{len(model.times) - 1}"
        )
    if isinstance(factor, gtsam.NoiseModelFactor) and factor.noiseModel().isConstrained():
        on = [keys.name(key) for key in factor.keys()]
        raise ValueError(
            f"a factor of yours on {on} is a hard constraint, which is no density: give it a small "
            "sigma instead of 0"
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
