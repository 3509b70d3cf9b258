"""Symmetric positive definite block-tridiagonal systems: a chain of time steps.

Small blocks go to LAPACK's banded Cholesky in one call, larger ones block by block: a band as
wide as two blocks would spend half its work on zeros.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack

Array = NDArray[np.float64]

BAND_LIMIT = 12
"""Largest block size for which the banded factorisation was measured to be faster."""


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
        diagonal: Blocks (k, k), symmetric, shape (S, D, D).
        upper: Blocks (k, k + 1), shape (S − 1, D, D).
        links: Symmetric parts (m, m) on places (m,) of the flattened state.
    """

    diagonal: Array
    upper: Array
    links: tuple[tuple[NDArray[np.intp], Array], ...] = ()

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


def factorize(
    diagonal: Array, upper: Array, links: tuple[tuple[NDArray[np.intp], Array], ...] = ()
) -> Factor | None:
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


def _factorize_dense(
    diagonal: Array, upper: Array, links: tuple[tuple[NDArray[np.intp], Array], ...]
) -> Factor | None:
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


def _factorize_band(diagonal: Array, upper: Array) -> Factor | None:
    S, D, _ = diagonal.shape
    band = np.zeros((2 * D) * S * D)
    into_diagonal, from_diagonal, into_upper, from_upper = _band_index(S, D)
    band[into_diagonal] = diagonal.reshape(-1)[from_diagonal]
    band[into_upper] = upper.reshape(-1)[from_upper]
    factor, info = lapack.dpbtrf(band.reshape(2 * D, S * D, order="F"), lower=1)
    return _Band(factor) if info == 0 and np.isfinite(factor[0].sum()) else None


@lru_cache(maxsize=64)
def _band_index(S: int, D: int) -> tuple[NDArray[np.intp], ...]:
    """Where each lower-triangular entry goes in LAPACK's band (Fortran order)."""
    k, a, b = np.meshgrid(np.arange(S), np.arange(D), np.arange(D), indexing="ij")
    lower = a >= b
    into_diagonal = ((a - b) + 2 * D * (k * D + b))[lower]
    from_diagonal = (k * D * D + a * D + b)[lower]
    k, a, b = np.meshgrid(np.arange(S - 1), np.arange(D), np.arange(D), indexing="ij")
    # Block (k, k + 1) at (a, b) is the entry of row (k + 1) D + b below column k D + a.
    into_upper = ((D + b - a) + 2 * D * (k * D + a)).reshape(-1)
    from_upper = (k * D * D + a * D + b).reshape(-1)
    return into_diagonal, from_diagonal, into_upper, from_upper
