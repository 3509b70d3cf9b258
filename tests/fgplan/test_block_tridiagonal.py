"""Chains of blocks against dense numpy, in the band and block by block."""

from __future__ import annotations

import numpy as np
import pytest

from fgplan.block_tridiagonal import BAND_LIMIT, Chains, factorize, solve_each
from tests.scenes import dense

SIZES = [(1, 1), (1, 2), (4, 1), (4, 13), (4, 40), (BAND_LIMIT, 7), (BAND_LIMIT + 1, 7), (24, 30),
         (60, 1), (60, 40)]  # fmt: skip


def chain(S: int, D: int, seed: int, condition: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """A random positive definite chain: the Gramian of a bidiagonal one."""
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(S, D, D)), rng.normal(size=(S, D, D))
    diagonal = A @ np.swapaxes(A, 1, 2) + condition * np.eye(D)
    diagonal[1:] += B[1:] @ np.swapaxes(B[1:], 1, 2)
    upper = A[:-1] @ np.swapaxes(B[1:], 1, 2)
    return diagonal, upper


@pytest.mark.parametrize(("D", "S"), SIZES)
def test_solution_equals_dense_solve(D, S):
    diagonal, upper = chain(S, D, seed=D + S)
    rhs = np.random.default_rng(1).normal(size=(S, D))
    factor = factorize(diagonal, upper)
    assert factor is not None
    expected = np.linalg.solve(dense(diagonal, upper), rhs.ravel()).reshape(S, D)
    np.testing.assert_allclose(factor.solve(rhs), expected, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize(("D", "S"), SIZES)
def test_log_determinant_equals_dense_one(D, S):
    diagonal, upper = chain(S, D, seed=2 * D + S)
    factor = factorize(diagonal, upper)
    assert factor is not None
    sign, expected = np.linalg.slogdet(dense(diagonal, upper))
    assert sign == 1
    assert factor.log_determinant == pytest.approx(expected, rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("seed", range(30))
def test_random_sizes_equal_dense_numpy(seed):
    rng = np.random.default_rng(seed)
    D, S = int(rng.integers(1, 61)), int(rng.integers(1, 41))
    if D * S > 800:  # dense numpy is the slow one here
        S = max(1, 800 // D)
    diagonal, upper = chain(S, D, seed)
    factor, H = factorize(diagonal, upper), dense(diagonal, upper)
    assert factor is not None
    rhs = rng.normal(size=(S, D))
    np.testing.assert_allclose(H @ factor.solve(rhs).ravel(), rhs.ravel(), atol=1e-9)
    assert factor.log_determinant == pytest.approx(np.linalg.slogdet(H)[1], rel=1e-10, abs=1e-9)


@pytest.mark.parametrize(("D", "S"), SIZES)
@pytest.mark.parametrize("where", ["first", "last"])
def test_indefinite_chain_has_no_factor(D, S, where):
    """Shifted by a little more than its smallest eigenvalue, and by a little less."""
    diagonal, upper = chain(S, D, seed=3 * D + S)
    smallest = np.linalg.eigvalsh(dense(diagonal, upper))[0]
    shift = np.eye(D)
    assert factorize(diagonal - 1.01 * smallest * shift, upper) is None
    assert factorize(diagonal - 0.99 * smallest * shift, upper) is not None
    block = 0 if where == "first" else -1
    diagonal[block, -1, -1] = -1.0
    assert factorize(diagonal, upper) is None


@pytest.mark.parametrize("D", [4, BAND_LIMIT + 1])
def test_zero_matrix_has_no_factor(D):
    assert factorize(np.zeros((3, D, D)), np.zeros((2, D, D))) is None


@pytest.mark.parametrize("D", [4, BAND_LIMIT + 1])
@pytest.mark.parametrize("place", ["diagonal", "upper"])
def test_matrix_with_nan_has_no_factor(D, place):
    diagonal, upper = chain(4, D, seed=0)
    (diagonal if place == "diagonal" else upper)[1, 0, 0] = np.nan
    assert factorize(diagonal, upper) is None


@pytest.mark.parametrize("D", [4, BAND_LIMIT + 1])
def test_factorisation_leaves_its_input_alone(D):
    diagonal, upper = chain(5, D, seed=4)
    before = diagonal.copy(), upper.copy()
    factor = factorize(diagonal, upper)
    assert factor is not None
    rhs = np.ones((5, D))
    factor.solve(rhs)
    np.testing.assert_array_equal(diagonal, before[0])
    np.testing.assert_array_equal(upper, before[1])
    np.testing.assert_array_equal(rhs, 1.0)


def test_strided_blocks_give_the_same_numbers():
    diagonal, upper = chain(6, 5, seed=5)
    wide = np.zeros((6, 2, 5, 5))
    wide[:, 1] = diagonal
    one, other = factorize(diagonal, upper), factorize(wide[:, 1], np.asfortranarray(upper))
    assert one is not None
    assert other is not None
    rhs = np.random.default_rng(2).normal(size=(6, 5))
    np.testing.assert_allclose(one.solve(rhs), other.solve(rhs), rtol=1e-12)


@pytest.mark.parametrize(
    ("D", "S", "B"), [(1, 4, 3), (3, 1, 2), (4, 25, 12), (5, 7, 4), (12, 3, 5)]
)
def test_many_chains_in_one_band_equal_dense_solves(D, S, B):
    rng = np.random.default_rng(D + S)
    chains = [chain(S, D, seed) for seed in range(B)]
    diagonal, upper = (np.stack(parts) for parts in zip(*chains, strict=True))
    # The first, the last and, where there are more, two neighbours have no Cholesky factor.
    broken = sorted({0, B // 2, B // 2 + 1, B - 1} & set(range(B)))[: B - 1]
    for b in broken:
        diagonal[b, rng.integers(S)] -= 1e3 * np.eye(D)
    rhs = rng.normal(size=(B, S, D))
    x, definite = Chains.of(diagonal, upper).solve(rhs)
    one_by_one = solve_each(diagonal, upper, (), rhs)
    np.testing.assert_array_equal(definite, [b not in broken for b in range(B)])
    np.testing.assert_array_equal(definite, one_by_one[1])
    for b in range(B):
        H = dense(diagonal[b], upper[b])
        expected = np.linalg.solve(H, rhs[b].ravel()) if definite[b] else np.zeros(S * D)
        np.testing.assert_allclose(x[b].ravel(), expected, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(x, one_by_one[0], rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_chain_without_numbers_leaves_the_others_alone(bad):
    chains = [chain(6, 4, seed) for seed in range(3)]
    diagonal, upper = (np.stack(parts) for parts in zip(*chains, strict=True))
    rhs = np.random.default_rng(0).normal(size=(3, 6, 4))
    expected, _ = Chains.of(diagonal, upper).solve(rhs)
    diagonal[1, 2, 0, 0] = bad
    x, definite = Chains.of(diagonal, upper).solve(rhs)
    np.testing.assert_array_equal(definite, [True, False, True])
    np.testing.assert_array_equal(x[[0, 2]], expected[[0, 2]])


def test_an_order_that_brings_links_together_narrows_the_band_and_changes_no_number():
    m, S, B = 5, 6, 2  # positions, then velocities, each linked to its own in the next step
    rng = np.random.default_rng(3)
    linked = np.kron(np.ones((2, 2)), np.eye(m)).astype(bool)
    diagonal, upper = np.zeros((B, S, 2 * m, 2 * m)), np.zeros((B, S - 1, 2 * m, 2 * m))
    upper[:] = 0.1 * rng.normal(size=upper.shape) * linked
    diagonal[:] = rng.normal(size=diagonal.shape)
    diagonal = diagonal @ np.swapaxes(diagonal, -1, -2) + 2 * np.eye(2 * m)
    order = np.arange(2 * m).reshape(m, 2).T.ravel()
    rhs = rng.normal(size=(B, S, 2 * m))
    chains = Chains.of(diagonal, upper, order, linked)
    assert chains.data.shape[-1] == 2 * m + 2  # one block, and what lies between neighbours
    x, definite = chains.solve(rhs)
    assert definite.all()
    np.testing.assert_allclose(x, Chains.of(diagonal, upper).solve(rhs)[0], rtol=1e-9, atol=1e-12)
    for b in range(B):
        expected = np.linalg.solve(dense(diagonal[b], upper[b]), rhs[b].ravel())
        np.testing.assert_allclose(x[b].ravel(), expected, rtol=1e-9, atol=1e-12)
