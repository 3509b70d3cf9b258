"""Compiled kernels for what takes most of the time: pairs of bodies, and banded systems.

It needs numba, which compiles at the first plan of a machine and keeps the result; only
`fgplan.backend` imports it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from fgplan.block_tridiagonal import Chains, chunks
from fgplan.compiled import band, conjugate, limits, pairs
from fgplan.model import Term
from fgplan.wiring import Wired

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]
Product = Callable[[Array], Array]


WIDEST = 120
"""Width of a band up to which the kernel was measured to be faster than LAPACK, whose blocks fit a
smaller part of the cache."""


class Compiled:
    """The `fgplan.backend.Backend` of compiled kernels."""

    pairwise = staticmethod(conjugate.newton)

    def fused(self, terms: Sequence[Term]) -> Iterator[Term]:
        return pairs.fused(list(limits.fused(terms)))

    def product(self, diagonal: Array, upper: Array) -> Product:
        own, links = np.argwhere(diagonal.any(axis=0)), np.argwhere(upper.any(axis=0))
        entries = diagonal[:, own[:, 0], own[:, 1]], upper[:, links[:, 0], links[:, 1]]

        def times(d: Array) -> Array:
            product = np.zeros_like(d)
            band.multiply(*entries, own, links, d, product)
            return product

        return times

    def steps(
        self, chains: Chains, rows: Index, parts: Sequence[tuple[Wired, Array]], gradient: Array
    ) -> tuple[Array, Mask]:
        steps, definite = np.empty_like(gradient), np.empty(len(rows), dtype=bool)
        size = len(chains.order)
        for here in chunks(len(rows), chains.data[0].size):
            systems = chains.data[rows[here]]
            for wired, part in parts:
                first, stride = wired.first.start * size, (wired.first.step or 1) * size
                band.add(systems, part[here], first, stride, wired.places)
            if systems.shape[-1] <= WIDEST:
                band.solve(systems, gradient[here], chains.order, steps[here], definite[here])
            else:
                wide = Chains(systems, chains.order)
                steps[here], definite[here] = wide.solve(-gradient[here])
        return steps, definite
