"""Compiled kernels for what takes most of the time: pairs of bodies, and banded systems.

It needs numba, which compiles at the first plan of a machine and keeps the result; only
`fgplan.backend` imports it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from fgplan.block_tridiagonal import Chains, at_once, chunks
from fgplan.compiled import conjugate, limits, pairs, products, tiles
from fgplan.compiled.kernel import room
from fgplan.entries import Entries
from fgplan.model import Term
from fgplan.systems import Systems
from fgplan.wiring import Wired

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]
Product = Callable[[Array], Array]


class Compiled:
    """The `fgplan.backend.Backend` of compiled kernels."""

    pairwise = staticmethod(conjugate.newton)

    def fused(self, terms: Sequence[Term]) -> Iterator[Term]:
        return pairs.fused(list(limits.fused(terms)))

    def product(self, entries: Entries, row: int) -> Product:
        own, ahead = entries.own, entries.ahead
        chain = own.values[row], ahead.values[row], own.places, ahead.places

        def times(d: Array) -> Array:
            product = np.zeros(d.shape)
            products.multiply(*chain, np.ascontiguousarray(d), product)
            return product

        return times

    def systems(self, chains: Chains) -> Systems:
        constant, size = tiles.laid(chains.data), len(chains.order)
        # What is laid out is overwritten: one call at a time.
        work = room((at_once(constant[0].size), *constant.shape[1:]))

        def steps(
            rows: Index, parts: Sequence[tuple[Wired, Array]], gradient: Array
        ) -> tuple[Array, Mask]:
            steps, definite = np.empty_like(gradient), np.empty(len(rows), dtype=bool)
            for here in chunks(len(rows), constant[0].size):
                H = work[: len(rows[here])]
                np.take(constant, rows[here], axis=0, out=H, mode="clip")
                for wired, part in parts:
                    first, stride = wired.first.start * size, (wired.first.step or 1) * size
                    tiles.add(H, np.ascontiguousarray(part[here]), first, stride, wired.places)
                tiles.solve(H, gradient[here], chains.order, steps[here], definite[here])
            return steps, definite

        return steps
