"""The constant part of a Hessian: chains of blocks of which nearly every entry is zero."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]


class Piece(NamedTuple):
    """Entries that are the same at some steps: added to blocks (k, k), or with `ahead` to blocks
    (k, k + 1), at `rows` and `columns`, no two at the same place."""

    ahead: bool
    steps: slice
    rows: Index
    columns: Index
    values: Array


@dataclass(frozen=True, eq=False)
class Places:
    """What K chains have at some places of their blocks, 0 everywhere else.

    Args:
        places: Row and column, shape (m, 2), contiguous, in this order.
        values: Shape (K, S, m), contiguous.
        size: D, of a block.
    """

    places: Index
    values: Array
    size: int

    @classmethod
    def of(
        cls, chains: int, steps: int, size: int, pieces: Iterable[tuple[slice, Piece]]
    ) -> Places:
        """The sum of pieces, each of some of the chains."""
        known = list(pieces)
        codes = [size * piece.rows + piece.columns for _, piece in known]
        none = np.zeros(0, dtype=np.intp)
        every, which = np.unique(np.concatenate([none, *codes]), return_inverse=True)
        values, first = np.zeros((chains, steps, len(every))), 0
        for (some, piece), code in zip(known, codes, strict=True):
            values[some, piece.steps, which[first : first + len(code)]] += piece.values
            first += len(code)
        return cls(np.stack(np.divmod(every, size), axis=1), values, size)

    @property
    def mask(self) -> Mask:
        """Where they are, shape (D, D)."""
        mask = np.zeros((self.size, self.size), dtype=bool)
        mask[*self.places.T] = True
        return mask

    @cached_property
    def _number(self) -> Index:
        number = np.full((self.size, self.size), len(self.places))
        number[*self.places.T] = np.arange(len(self.places))
        return number

    def at(self, rows: Index, columns: Index) -> Array:
        """What is at some places, shape (K, S, ...)."""
        some = np.append(self.values, np.zeros((*self.values.shape[:2], 1)), axis=2)
        return np.asarray(some[:, :, self._number[rows, columns]])

    def blocks(self, which: Index) -> Array:
        """Blocks of some of the chains, laid out, shape (B, S, D, D)."""
        laid = np.zeros((len(which), self.values.shape[1], self.size, self.size))
        laid[:, :, *self.places.T] = self.values[which]
        return laid


@dataclass(frozen=True, eq=False)
class Entries:
    """K chains of S symmetric blocks (k, k), with blocks (k, k + 1) between them."""

    own: Places
    ahead: Places

    @classmethod
    def of(cls, shape: tuple[int, int, int], pieces: Iterable[tuple[slice, Piece]]) -> Entries:
        """The sum of pieces, each of some of K chains; `shape` is K, S and D."""
        chains, steps, size = shape
        every = list(pieces)
        own, ahead = ([each for each in every if each[1].ahead == so] for so in (False, True))
        return cls(Places.of(chains, steps, size, own), Places.of(chains, steps - 1, size, ahead))

    def blocks(self, which: Index) -> tuple[Array, Array]:
        """Blocks (k, k) and (k, k + 1) of some chains, laid out."""
        return self.own.blocks(which), self.ahead.blocks(which)
