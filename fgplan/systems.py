"""Newton steps of many chains that share a constant part, by LAPACK."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fgplan.block_tridiagonal import Chains, chunks
from fgplan.wiring import Wired

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]


class Systems(Protocol):
    """Newton steps −H⁻¹ g of B systems."""

    def __call__(
        self, rows: Index, parts: Sequence[tuple[Wired, Array]], gradient: Array, /
    ) -> tuple[Array, Mask]:
        """Solve them.

        Args:
            rows: Which constant part each Hessian has, shape (B,).
            parts: The other parts of the Hessians: terms with their blocks (B, steps, s, s).
            gradient: g, shape (B, S, D).

        Returns:
            The steps (B, S, D), zero where H is not positive definite, and where it is (B,).
        """
        ...


def banded(chains: Chains) -> Systems:
    """By banded factorisation, for chains of any width.

    Args:
        chains: The constant parts of the Hessians.
    """

    def steps(
        rows: Index, parts: Sequence[tuple[Wired, Array]], gradient: Array
    ) -> tuple[Array, Mask]:
        steps, definite = np.empty_like(gradient), np.empty(len(rows), dtype=bool)
        for here in chunks(len(rows), chains.data[0].size):
            band = chains.take(rows[here])
            for wired, part in parts:
                wired.add_lower(part[here], band)
            steps[here], definite[here] = band.solve(-gradient[here])
        return steps, definite

    return steps
