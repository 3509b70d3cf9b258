"""What computes the terms of a density and its linear systems: numpy, or compiled kernels.

The first is the definition. Everything else of an assembly is the same for both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from factors.pairwise import PredictedPairs, Together
from fgplan.block_tridiagonal import Chains
from fgplan.entries import Entries
from fgplan.model import Term
from fgplan.systems import Systems, banded

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]
Product = Callable[[Array], Array]


class Pairwise(Protocol):
    """Newton steps of densities in which people are linked by pairs alone: see
    `fgplan.compiled.conjugate.newton`."""

    def __call__(
        self,
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
        /,
    ) -> None: ...


class Backend(Protocol):
    """What takes time."""

    @property
    def pairwise(self) -> Pairwise | None:
        """How systems are solved pair by pair; None where they are factorised whatever their
        size."""
        ...

    def fused(self, terms: Sequence[Term]) -> Iterator[Term]:
        """The same density in terms that are faster to evaluate."""
        ...

    def product(self, entries: Entries, row: int) -> Product:
        """From vectors (N, S, D) to their products with one of the chains."""
        ...

    def systems(self, chains: Chains) -> Systems:
        """What solves systems of which a part is constant.

        Args:
            chains: The constant parts of the Hessians.
        """
        ...


class Numpy:
    """numpy and LAPACK."""

    pairwise: Pairwise | None = None

    def fused(self, terms: Sequence[Term]) -> Iterator[Term]:
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

    def product(self, entries: Entries, row: int) -> Product:
        matrix = _sparse(entries, row)

        def times(d: Array) -> Array:
            product = matrix @ d.reshape(len(d), -1).T
            return np.ascontiguousarray(product.T).reshape(d.shape)

        return times

    def systems(self, chains: Chains) -> Systems:
        return banded(chains)


@lru_cache(maxsize=1)
def fastest() -> Backend:
    """Compiled kernels where there is a numba that works (`pip install -e '.[fast]'`), else
    numpy."""
    try:
        from fgplan.compiled import Compiled  # importing numba takes as long as half of fgplan
    except ImportError:  # there is none, or not for this numpy
        return Numpy()
    return Compiled()


def _sparse(entries: Entries, row: int) -> csr_array:
    """One of the chains as a sparse matrix."""
    own, ahead = entries.own, entries.ahead
    S, D = own.values.shape[1], own.size
    first = D * np.arange(S)[:, None]
    a, b = own.places.T
    rows, columns, values = [first + a], [first + b], [own.values[row]]
    a, b = ahead.places.T
    here, there = first[:-1] + a, first[1:] + b
    rows, columns = [*rows, here, there], [*columns, there, here]
    values += 2 * [ahead.values[row]]
    data, i, j = (
        np.concatenate([part.ravel() for part in parts]) for parts in (values, rows, columns)
    )
    return csr_array((data, (i, j)), shape=(S * D, S * D))
