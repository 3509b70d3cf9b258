"""The product of a chain of blocks with vectors, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fgplan.compiled.kernel import INT, exact, packed, result

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@exact(packed(2), packed(2), packed(2, INT), packed(2, INT), packed(3), result(3))
def multiply(
    diagonal: Array, upper: Array, own: Index, links: Index, d: Array, product: Array
) -> None:
    """Add H d, of a chain of which most entries are zero.

    Args:
        diagonal: Entries `own` of the blocks (k, k), shape (S, m).
        upper: Entries `links` of the blocks (k, k + 1), shape (S − 1, m').
        own, links: Row and column of each, shapes (m, 2) and (m', 2).
        d: Shape (N, S, D).
        product: What it is added to, of the same shape.
    """
    for n in range(d.shape[0]):
        for k in range(d.shape[1]):
            for e in range(len(own)):
                product[n, k, own[e, 0]] += diagonal[k, e] * d[n, k, own[e, 1]]
        for k in range(d.shape[1] - 1):
            for e in range(len(links)):
                a, b = links[e]
                product[n, k, a] += upper[k, e] * d[n, k + 1, b]
                product[n, k + 1, b] += upper[k, e] * d[n, k, a]
