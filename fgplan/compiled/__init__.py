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

    def product(self, diagonal: Array, upper: Array) -> Product:
        own, links = np.argwhere(diagonal.any(axis=0)), np.argwhere(upper.any(axis=0))
        entries = diagonal[:, own[:, 0], own[:, 1]], upper[:, links[:, 0], links[:, 1]]

        def times(d: Array) -> Array:
            product = np.zeros_like(d)
            products.multiply(*entries, own, links, d, product)
            return product

        return times

    def systems(self, chains: Chains) -> Systems:
        constant, size = tiles.laid(chains.data), len(chains.order)
        # What is laid out is overwritten: one call at a time.
        room = tiles.room(at_once(constant[0].size), *chains.data.shape[1:])

        def steps(
            rows: Index, parts: Sequence[tuple[Wired, Array]], gradient: Array
        ) -> tuple[Array, Mask]:
            steps, definite = np.empty_like(gradient), np.empty(len(rows), dtype=bool)
            for here in chunks(len(rows), constant[0].size):
                H = room[: len(rows[here])]
                np.take(constant, rows[here], axis=0, out=H, mode="clip")
                for wired, part in parts:
                    first, stride = wired.first.start * size, (wired.first.step or 1) * size
                    tiles.add(H, part[here], first, stride, wired.places)
                tiles.solve(H, gradient[here], chains.order, steps[here], definite[here])
            return steps, definite

        return steps
