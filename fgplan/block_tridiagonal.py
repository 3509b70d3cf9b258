"""Symmetric positive definite block-tridiagonal systems: a chain of time steps.

Small blocks go to LAPACK's banded Cholesky in one call, and so do those of many starts; larger
ones go block by block where nothing is known of them: a band as wide as two blocks would spend
half its work on zeros.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Links = tuple[tuple[NDArray[np.intp], Array], ...]

BAND_LIMIT = 12
"""Largest block size for which the banded factorisation was measured to be faster."""


CHUNK = 65536
"""Numbers in the systems that are laid out at once: they should stay in the cache."""


class Factor(Protocol):
    """A Cholesky factorisation."""

    def solve(self, rhs: Array) -> Array:
        """x with H x = rhs; both (S, D)."""
        ...

    def forward(self, rhs: Array) -> Array:
        """L⁻¹ b with H = L Lᵀ; shape (N, S, D)."""
        ...

    def backward(self, rhs: Array) -> Array:
        """L⁻ᵀ z: a draw of N(0, H⁻¹) where z is one of N(0, I); shape (N, S, D)."""
        ...

    @property
    def log_determinant(self) -> float:
        """log det H."""
        ...


class System(NamedTuple):
    """A symmetric matrix H: a chain, and links between steps that are not neighbours.

    Args:
        diagonal: Blocks (k, k), symmetric, shape (S, D, D), or (B, S, D, D) of many.
        upper: Blocks (k, k + 1), shape (S − 1, D, D), or (B, S − 1, D, D).
        links: Symmetric parts (m, m), or (B, m, m), on places (m,) of the flattened state.
    """

    diagonal: Array
    upper: Array
    links: Links = ()

    def times(self, d: Array) -> Array:
        """H d, shape (N, S, D)."""
        columns = np.ascontiguousarray(np.moveaxis(d, 0, -1))
        product = np.matmul(self.diagonal, columns)
        product[:-1] += np.matmul(self.upper, columns[1:])
        product[1:] += np.matmul(np.swapaxes(self.upper, -1, -2), columns[:-1])
        out = np.ascontiguousarray(np.moveaxis(product, -1, 0))
        flat = out.reshape(len(d), -1)
        for places, part in self.links:
            flat[:, places] += d.reshape(len(d), -1)[:, places] @ part
        return out

    def mixed(self, other: System, share: float) -> System:
        """(1 − share) of this and share of another one with the same links."""
        links = tuple(
            (places, (1 - share) * a + share * b)
            for (places, a), (_, b) in zip(self.links, other.links, strict=True)
        )
        return System(
            (1 - share) * self.diagonal + share * other.diagonal,
            (1 - share) * self.upper + share * other.upper,
            links,
        )


def at_once(size: int) -> int:
    """How many systems of so many numbers `CHUNK` has room for, at least one."""
    return max(1, CHUNK // size)


def chunks(count: int, size: int) -> Iterator[slice]:
    """As many of `count` systems of so many numbers at once as there is room for."""
    some = at_once(size)
    for at in range(0, count, some):
        yield slice(at, at + some)


def factorize(diagonal: Array, upper: Array, links: Links = ()) -> Factor | None:
    """Factorise H, given as the parts of a `System`; None where it is not positive definite.

    With links the system is solved as a dense one.
    """
    if links:
        return _factorize_dense(diagonal, upper, links)
    if diagonal.shape[-1] <= BAND_LIMIT:
        return _factorize_band(diagonal, upper)
    return _factorize_blocks(diagonal, upper)


class _Band:
    def __init__(self, factor: Array) -> None:
        self._factor = factor

    def solve(self, rhs: Array) -> Array:
        x, _ = lapack.dpbtrs(self._factor, rhs.reshape(-1), lower=1)
        return np.asarray(x).reshape(rhs.shape)

    def forward(self, rhs: Array) -> Array:
        return self._triangular(rhs, "N")

    def backward(self, rhs: Array) -> Array:
        return self._triangular(rhs, "T")

    def _triangular(self, rhs: Array, trans: str) -> Array:
        x, _ = lapack.dtbtrs(self._factor, rhs.reshape(len(rhs), -1).T, uplo="L", trans=trans)
        return np.ascontiguousarray(x.T).reshape(rhs.shape)

    @property
    def log_determinant(self) -> float:
        return float(2 * np.log(self._factor[0]).sum())


class _Blocks:
    def __init__(self, factors: list[Array], links: list[Array]) -> None:
        self._factors, self._links = factors, links

    def solve(self, rhs: Array) -> Array:
        y: list[Array] = []
        for k, L in enumerate(self._factors):
            b = rhs[k] - self._links[k - 1].T @ y[k - 1] if k else rhs[k]
            y.append(blas.dtrsv(L, b, lower=1))
        x = np.empty_like(rhs)
        for k in range(len(y) - 1, -1, -1):
            b = y[k] - self._links[k] @ x[k + 1] if k + 1 < len(y) else y[k]
            x[k] = blas.dtrsv(self._factors[k], b, lower=1, trans=1)
        return x

    def forward(self, rhs: Array) -> Array:
        y = np.empty((rhs.shape[1], rhs.shape[2], len(rhs)))
        for k, L in enumerate(self._factors):
            b = rhs[:, k].T - self._links[k - 1].T @ y[k - 1] if k else rhs[:, k].T
            y[k] = blas.dtrsm(1.0, L, b, lower=1)
        return np.ascontiguousarray(np.moveaxis(y, -1, 0))

    def backward(self, rhs: Array) -> Array:
        x = np.empty((rhs.shape[1], rhs.shape[2], len(rhs)))
        for k in range(len(x) - 1, -1, -1):
            b = rhs[:, k].T - self._links[k] @ x[k + 1] if k + 1 < len(x) else rhs[:, k].T
            x[k] = blas.dtrsm(1.0, self._factors[k], b, lower=1, trans_a=1)
        return np.ascontiguousarray(np.moveaxis(x, -1, 0))

    @property
    def log_determinant(self) -> float:
        return float(2 * sum(np.log(np.diagonal(L)).sum() for L in self._factors))


class _Dense:
    def __init__(self, factor: Array) -> None:
        self._factor = factor

    def solve(self, rhs: Array) -> Array:
        x, _ = lapack.dpotrs(self._factor, rhs.reshape(-1), lower=1)
        return np.asarray(x).reshape(rhs.shape)

    def forward(self, rhs: Array) -> Array:
        return self._triangular(rhs, 0)

    def backward(self, rhs: Array) -> Array:
        return self._triangular(rhs, 1)

    def _triangular(self, rhs: Array, trans: int) -> Array:
        flat = rhs.reshape(len(rhs), -1).T
        x = blas.dtrsm(1.0, self._factor, flat, lower=1, trans_a=trans)
        return np.ascontiguousarray(x.T).reshape(rhs.shape)

    @property
    def log_determinant(self) -> float:
        return float(2 * np.log(np.diagonal(self._factor)).sum())


def _factorize_dense(diagonal: Array, upper: Array, links: Links) -> Factor | None:
    S, D, _ = diagonal.shape
    H = np.zeros((S, D, S, D))
    k = np.arange(S)
    H[k, :, k, :] = diagonal
    H[k[1:], :, k[:-1], :] = np.swapaxes(upper, -1, -2)  # only the lower triangle is read
    flat = H.reshape(S * D, S * D)
    for places, part in links:
        np.add.at(flat, (places[:, None], places), part)
    factor, info = lapack.dpotrf(flat, lower=1)
    return _Dense(factor) if info == 0 and np.isfinite(np.diagonal(factor).sum()) else None


def _factorize_blocks(diagonal: Array, upper: Array) -> Factor | None:
    factors, links = [], []
    # A symmetric block in C order is, transposed, the same block in Fortran order, as LAPACK
    # wants it.
    blocks = np.swapaxes(diagonal, -1, -2)
    S = blocks[0]
    for k in range(len(blocks)):
        L, info = lapack.dpotrf(S, lower=1, clean=0)
        if info != 0:
            return None
        factors.append(L)
        if k + 1 < len(blocks):
            C = blas.dtrsm(1.0, L, upper[k], lower=1)
            links.append(C)
            S = blas.dsyrk(-1.0, C, beta=1.0, c=blocks[k + 1], trans=1, lower=1)
    # A NaN raises no flag in LAPACK, but it spreads down the chain to the last block.
    return _Blocks(factors, links) if np.isfinite(np.diagonal(factors[-1]).sum()) else None


class Chains:
    """B chains of blocks, one after the other in LAPACK's lower band, with no link between.

    The band is as narrow as the order of the coordinates within a step allows: where a coordinate
    is linked to few of the next step, and those are near it in that order, hardly wider than one
    block. Entry (a, b) of block (k, k) is at row a − b of column kD + b, and entry (a, b) of block
    (k, k + 1), transposed, at row D + b − a of column kD + a: in memory, both are at a distance
    that is linear in k, a and b, so that blocks are views of the band.

    Args:
        data: Columns of the band, shape (B, S·D, W), contiguous.
        order: Place of each coordinate within a step, shape (D,).

    Attributes:
        diagonal: Blocks (k, k) in that order, shape (B, S, D, D): only what is on and below the
            diagonal may be written, the rest shares its memory with other entries.
        upper: Blocks (k, k + 1), shape (B, S − 1, D, D): only what the band is wide enough for.
    """

    def __init__(self, data: Array, order: Index) -> None:
        self.data, self.order = data, order
        (B, size, width), D = data.shape, len(order)
        S, item = size // D, data.itemsize
        chain, step, across = data.strides[0], width * D * item, (width - 1) * item
        self.diagonal = np.ndarray((B, S, D, D), float, data, 0, (chain, step, item, across))
        shape, offset = (B, S - 1, D, D), D * item if S > 1 else 0
        self.upper = np.ndarray(shape, float, data, offset, (chain, step, across, item))

    @classmethod
    def of(
        cls,
        diagonal: Array,
        upper: Array,
        order: Index | None = None,
        linked: NDArray[np.bool_] | None = None,
    ) -> Chains:
        """From blocks (B, S, D, D) and (B, S − 1, D, D).

        Args:
            diagonal, upper: As in `System`.
            order: Place of each coordinate within a step, shape (D,); as they come by default.
            linked: Which coordinates may be linked to which of the next step, shape (D, D), now or
                by what is added later; all by default.
        """
        B, S, D, _ = diagonal.shape
        place = np.arange(D) if order is None else order
        every = np.ones((D, D), dtype=bool) if linked is None else linked
        a, b = np.nonzero(every)
        reach = int((D + place[b] - place[a]).max(initial=D))
        chains = cls(np.zeros((B, S * D, 1 + reach)), place)
        chains.upper[..., place[a], place[b]] = upper[..., a, b]
        at = np.argsort(place)
        used: NDArray[np.bool_] = np.any(diagonal, axis=(0, 1))
        a, b = np.nonzero(np.tril(used[np.ix_(at, at)]))
        chains.diagonal[..., a, b] = diagonal[..., at[a], at[b]]
        return chains

    def take(self, rows: NDArray[np.intp]) -> Chains:
        """Copies of some of the chains."""
        return Chains(self.data[rows], self.order)

    def factorize(self) -> tuple[Array, NDArray[np.bool_]]:
        """Cholesky factors, in place, in the form `_Band` takes (W, B·S·D), and which chains are
        positive definite (B,); the others' factors are the identity."""
        B, size, width = self.data.shape
        band = self.data.reshape(B * size, width).T
        definite = np.ones(B, dtype=bool)
        if not np.isfinite(self.data.sum()):  # a NaN would spread from chain to chain
            definite = np.isfinite(self.data.sum(axis=(1, 2)))
            for b in np.flatnonzero(~definite).tolist():
                self._forget(b)
        at = 0
        while at < B:
            # A failure leaves the chains before it factorised and those after it as they were.
            _, info = lapack.dpbtrf(band[:, at * size :], lower=1, overwrite_ab=1)
            if info == 0:
                break
            at += (info - 1) // size
            definite[at] = False
            self._forget(at)
            at += 1
        return band, definite

    def _forget(self, b: int) -> None:
        self.data[b, :, 0], self.data[b, :, 1:] = 1.0, 0.0

    def solve(self, rhs: Array) -> tuple[Array, NDArray[np.bool_]]:
        """x_b with H_b x_b = rhs_b, shape (B, S, D), zero where H_b is not positive definite, and
        where it is (B,). The band is overwritten."""
        band, definite = self.factorize()
        natural = bool((self.order[1:] > self.order[:-1]).all())
        ordered = rhs if natural else rhs[..., np.argsort(self.order)]
        x, _ = lapack.dpbtrs(band, ordered.reshape(-1), lower=1)
        x = np.asarray(x).reshape(rhs.shape)
        x = x if natural else x[..., self.order]
        if not definite.all():
            x[~definite] = 0.0
        return x, definite


def _factorize_band(diagonal: Array, upper: Array) -> Factor | None:
    factor, definite = Chains.of(diagonal[None], upper[None]).factorize()
    return _Band(factor) if definite[0] and np.isfinite(factor[0].sum()) else None


def solve_each(
    diagonal: Array, upper: Array, links: Links, rhs: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """The same as `Chains.solve` for blocks of any size and with links.

    Args:
        diagonal: Blocks (k, k), shape (B, S, D, D).
        upper: Blocks (k, k + 1), shape (B, S − 1, D, D).
        links: As in `System`, with parts (B, m, m).
        rhs: Shape (B, S, D).
    """
    x, definite = np.zeros_like(rhs), np.zeros(len(rhs), dtype=bool)
    for b in range(len(rhs)):
        own = tuple((places, part[b]) for places, part in links)
        factor = factorize(diagonal[b], upper[b], own)
        if factor is not None:
            x[b], definite[b] = factor.solve(rhs[b]), True
    return x, definite
