"""Few entries are the same chain as blocks that are laid out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgplan.assembly import Assembly
from fgplan.backend import Numpy, fastest
from fgplan.entries import Entries, Piece
from tests.scenes import assembled, dense, random_scene, short


def pieces(rng: np.random.Generator, chains: int, steps: int, size: int, count: int):
    for _ in range(count):
        ahead = bool(rng.integers(2))
        first, k = int(rng.integers(steps - ahead)), int(rng.integers(chains))
        which = slice(None) if rng.integers(2) else slice(k, k + 1)
        codes = rng.permutation(size * size)[: rng.integers(size * size + 1)]
        values = rng.normal(size=len(codes))
        yield which, Piece(ahead, slice(first, steps - ahead, 2), *np.divmod(codes, size), values)


@given(st.integers(1, 3), st.integers(2, 5), st.integers(1, 4), st.integers(0, 6), st.integers(0))
def test_entries_are_the_sum_of_their_pieces(chains, steps, size, count, seed):
    known = list(pieces(np.random.default_rng(seed), chains, steps, size, count))
    expected = [np.zeros((chains, steps - ahead, size, size)) for ahead in (0, 1)]
    for which, piece in known:
        expected[piece.ahead][which, piece.steps, piece.rows, piece.columns] += piece.values
    entries = Entries.of((chains, steps, size), known)
    which = np.arange(chains)[::-1]
    every = np.indices((size, size))
    for places, laid, blocks in zip(
        (entries.own, entries.ahead), entries.blocks(which), expected, strict=True
    ):
        np.testing.assert_array_equal(laid, blocks[which])
        np.testing.assert_array_equal(places.at(*every), blocks)
        assert places.mask.sum() == len(places.places)
        assert not np.any(blocks[:, :, ~places.mask])


@pytest.mark.parametrize(
    "backend", [fastest(), Numpy()], ids=lambda backend: type(backend).__name__
)
def test_products_are_those_of_the_laid_out_chain(backend):
    assembly = Assembly(assembled(random_scene(3, 4, density=short()))[0].models, backend)
    which = np.arange(len(assembly.models))
    d = np.random.default_rng(0).normal(size=(len(which), *assembly.free.shape))
    for k, product in enumerate(assembly.times(d, which)):
        H = dense(*(part[0] for part in assembly.linear_hessian(which[k : k + 1])))
        np.testing.assert_allclose(product.ravel(), H @ d[k].ravel(), rtol=1e-9, atol=1e-6)
