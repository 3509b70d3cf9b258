"""The guard around GTSAM callbacks, linear residuals, whiteners."""

from __future__ import annotations

import gc
import weakref
from dataclasses import dataclass, replace
from typing import Any

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from factors.residual import (
    Array,
    Expansion,
    Linear,
    Residual,
    log_gaussian_normalizer,
    whitener,
    whiteners,
)
from tests.factor_testing import check_derivatives


@dataclass(frozen=True, eq=False)
class Swirl(Residual):
    """A small nonlinear residual of two variables: e = (x0·y0, sin y1) with chosen mistakes."""

    mistake: str = ""

    @property
    def dims(self) -> tuple[int, ...]:
        return (3, 2)

    @property
    def rows(self) -> int:
        return 2

    def error(self, *x: Array) -> Array:
        e = np.stack([x[0][..., 0] * x[1][..., 0], np.sin(x[1][..., 1])], axis=-1)
        return e[..., :1] if self.mistake == "short error" else e

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        a, b = x
        A = np.zeros((*a.shape[:-1], 2, 3))
        B = np.zeros((*b.shape[:-1], 2, 2))
        A[..., 0, 0] = b[..., 0]
        B[..., 0, 0] = a[..., 0]
        B[..., 1, 1] = np.cos(b[..., 1])
        blocks: dict[str, Any] = {
            "": (A, B),
            "short error": (A, B),
            "one Jacobian": (A,),
            "three Jacobians": (A, B, B),
            "no Jacobian": (A, None),
            "rows": (A[:1], B),
            "columns": (A, B[:, :1]),
            "one-dimensional": (A, B[0]),
        }
        return self.error(*x), blocks[self.mistake]

    def expand(self, *x: Array) -> Expansion:
        energy, gradient, hessian = self.gauss_newton(*x)
        e = self.error(*x)
        hessian[..., 0, 3] += e[..., 0]
        hessian[..., 3, 0] += e[..., 0]
        hessian[..., 4, 4] -= e[..., 1] * np.sin(x[1][..., 1])
        return Expansion(energy, gradient, hessian)


def values_of(*x: Array) -> gtsam.Values:
    values = gtsam.Values()
    for key, xi in enumerate(x):
        values.insert(key, np.asarray(xi, dtype=float))
    return values


POINT = (np.array([0.3, -0.2, 0.5]), np.array([0.7, 0.4]))
MISTAKES = [
    ("one Jacobian", "number of Jacobians"),
    ("three Jacobians", "number of Jacobians"),
    ("no Jacobian", "Jacobian 1"),
    ("rows", r"Jacobian 0 has shape \(1, 3\), expected \(2, 3\)"),
    ("columns", r"Jacobian 1 has shape \(2, 1\), expected \(2, 2\)"),
    ("one-dimensional", r"Jacobian 1 has shape \(2,\), expected \(2, 2\)"),
    ("short error", r"error has shape \(1,\), expected \(2,\)"),
]


@pytest.mark.parametrize(("mistake", "message"), MISTAKES)
def test_wrong_jacobian_or_error_raises_and_does_not_crash(mistake: str, message: str) -> None:
    factor = Swirl(mistake).on(0, 1)
    with pytest.raises(ValueError, match=f"Swirl: .*{message}"):
        factor.linearize(values_of(*POINT))


def test_wrong_error_shape_raises_without_jacobians_too() -> None:
    with pytest.raises(ValueError, match=r"error has shape \(1,\)"):
        Swirl("short error").on(0, 1).error(values_of(*POINT))


@pytest.mark.parametrize("wrong", [(2, 2), (3, 3)])
def test_wrong_variable_size_raises(wrong: tuple[int, int]) -> None:
    values = values_of(*(np.zeros(size) for size in wrong))
    with pytest.raises(ValueError, match=r"variable \d has shape"):
        Swirl().on(0, 1).error(values)


def test_mistake_inside_an_optimizer_raises() -> None:
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(Swirl("rows").on(0, 1))
    with pytest.raises(ValueError, match="Jacobian 0"):
        gtsam.LevenbergMarquardtOptimizer(graph, values_of(*POINT)).optimize()


@pytest.mark.parametrize("residual", [Swirl(), Linear((np.eye(2), np.eye(2)), np.zeros(2))])
@pytest.mark.parametrize("count", [0, 1, 3])
def test_wrong_number_of_keys_raises(residual: Residual, count: int) -> None:
    with pytest.raises(ValueError, match=f"connects 2 variables, got {count} keys"):
        residual.on(*range(count))


def test_derivatives_of_a_nonlinear_residual() -> None:
    check_derivatives(Swirl(), *POINT)


def linear(seed: int, dims: tuple[int, ...], rows: int = 3) -> Linear:
    rng = np.random.default_rng(seed)
    return Linear(tuple(rng.normal(size=(rows, d)) for d in dims), rng.normal(size=rows))


@pytest.mark.parametrize("dims", [(4,), (4, 2), (1, 3, 2), (2, 4, 1, 3), (1, 2, 3, 1, 2)])
def test_linear_derivatives_for_any_number_of_keys(dims: tuple[int, ...]) -> None:
    rng = np.random.default_rng(7)
    check_derivatives(linear(3, dims), *(rng.normal(size=d) for d in dims))


@given(st.integers(0, 10**6), st.lists(st.integers(1, 4), min_size=1, max_size=5))
def test_linear_factor_shifts_with_the_values(seed: int, dims: list[int]) -> None:
    """A LinearContainerFactor without a linearization point would report 0 everywhere."""
    residual = linear(seed, tuple(dims))
    factor = residual.on(*range(len(dims)))
    rng = np.random.default_rng(seed)
    for scale in (0.0, 1.0, 100.0):
        x = [scale * rng.normal(size=d) for d in dims]
        assert_allclose(factor.error(values_of(*x)), residual.energy(*x), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("dims", [(2, 2), (1, 1, 1, 1)])
def test_newton_step_of_a_linear_factor_reaches_its_minimum(dims: tuple[int, ...]) -> None:
    residual = linear(11, dims, rows=sum(dims))
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(residual.on(*range(len(dims))))
    start = values_of(*(np.full(d, 5.0) for d in dims))
    result = gtsam.GaussNewtonOptimizer(graph, start).optimize()
    assert graph.error(result) == pytest.approx(0.0, abs=1e-16)


def test_linear_with_a_step_axis() -> None:
    rng = np.random.default_rng(5)
    residual = replace(linear(2, (2, 3)), b=rng.normal(size=(4, 3)))
    check_derivatives(residual, rng.normal(size=(4, 2)), rng.normal(size=(4, 3)))
    assert residual.at(2).at(3) is not residual


@pytest.mark.parametrize("residual", [Swirl(), linear(0, (3, 2)), linear(0, (3, 2, 1, 1))])
def test_factors_do_not_keep_graph_or_residual_alive(residual: Residual) -> None:
    residual = replace(residual)  # type: ignore[type-var]
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(residual.on(*range(len(residual.dims))))
    values = values_of(*(np.ones(d) for d in residual.dims))
    graph.linearize(values)
    graph.error(values)
    watched = weakref.ref(residual), weakref.ref(graph)
    del residual, graph
    gc.collect()
    assert [reference() for reference in watched] == [None, None]


@given(st.integers(0, 10**6), st.integers(1, 6))
def test_whitener_is_the_inverse_square_root(seed: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    S = (root := rng.normal(size=(size, size))) @ root.T + 0.1 * np.eye(size)
    W = whitener(S)
    assert_allclose(W @ S @ W.T, np.eye(size), atol=1e-9)
    assert np.array_equal(W, np.tril(W))
    expected = -0.5 * np.linalg.slogdet(2 * np.pi * S)[1]
    assert log_gaussian_normalizer(W) == pytest.approx(expected, rel=1e-9)


def test_whiteners_of_many_are_those_of_each() -> None:
    roots = np.random.default_rng(3).normal(size=(5, 4, 4))
    each = roots @ np.swapaxes(roots, -1, -2) + 0.1 * np.eye(4)
    assert_allclose(whiteners(each), np.stack([whitener(S) for S in each]), rtol=1e-12)
    each[3, 2, 2] = -1.0
    with pytest.raises(ValueError, match="of people must be positive definite"):
        whiteners(each, "covariance of people")


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        (np.ones((2, 3)), r"must be a square matrix, got shape \(2, 3\)"),
        (np.ones((2, 2, 2)), "must be a square matrix"),
        (np.array([[1.0, np.nan], [np.nan, 1.0]]), "not finite"),
        (np.array([[np.inf, 0.0], [0.0, 1.0]]), "not finite"),
        (np.array([[1.0, 0.5], [0.0, 1.0]]), "must be symmetric"),
        (np.diag([1.0, 0.0]), "must be positive definite"),
        (np.diag([1.0, -1.0]), "must be positive definite"),
        (0.0, "must be positive definite"),
    ],
)
def test_whitener_names_what_is_wrong(covariance: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"Qc .*{message}"):
        whitener(covariance, "Qc")
