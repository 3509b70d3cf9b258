"""Measurements, kernels and dense priors against closed-form Gaussian-process regression."""

from __future__ import annotations

from typing import Any, Literal

import gtsam
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import special

from factors.dense_prior import dense_prior
from factors.gp_prior import GPPrior, gaussian
from factors.kernels import linear_kernel, matern
from factors.measurement import (
    interpolated_measurement,
    measurement,
    position_measurement,
    velocity_measurement,
)
from factors.residual import Array, Residual
from tests.factor_testing import check_derivatives

R = np.array([[0.04, 0.01], [0.01, 0.09]])


def solve(placed: list[tuple[Residual, tuple[int, ...]]], sizes: list[int]) -> Array:
    """GTSAM's Levenberg-Marquardt from zero, all variables in one vector."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for residual, keys in placed:
        graph.push_back(residual.on(*keys))
    for key, size in enumerate(sizes):
        values.insert(key, np.zeros(size))
    parameters = gtsam.LevenbergMarquardtParams()
    # The error is flat to rounding 1e-8 away from the optimum: damping must not stop it there.
    parameters.setlambdaInitial(1e-12)
    parameters.setRelativeErrorTol(0.0)
    parameters.setAbsoluteErrorTol(0.0)
    result = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    return np.concatenate([result.atVector(key) for key in range(len(sizes))])


def log_density(residual: Residual, *x: Array) -> Any:
    return residual.log_normalizer - residual.energy(*x)


def log_gaussian(x: Array, mean: Array, covariance: Array) -> Any:
    d = x - mean
    log_det = np.linalg.slogdet(2 * np.pi * covariance)[1]
    return -0.5 * (d @ np.linalg.solve(covariance, d) + log_det)


@pytest.mark.parametrize(
    "residual",
    [
        position_measurement(np.array([1.0, -2.0]), R),
        position_measurement(np.array([1.0, -2.0]), R, dim=2),
        velocity_measurement(np.array([0.5, 0.2]), R),
        interpolated_measurement(GPPrior(0.5, np.eye(2)), 0.2, np.array([1.0, 3.0]), R),
        dense_prior(np.ones((2, 2)), np.kron(matern(np.arange(2.0), 1.0, 2.0), R)),
        dense_prior(np.ones((5, 2)), np.kron(matern(np.arange(5.0), 1.0, 2.0), R)),
    ],
)
def test_derivatives(residual: Residual) -> None:
    rng = np.random.default_rng(4)
    check_derivatives(residual, *(rng.normal(size=d) for d in residual.dims))


@pytest.mark.parametrize("build", [position_measurement, velocity_measurement])
def test_measurements_with_a_step_axis(build: Any) -> None:
    rng = np.random.default_rng(4)
    check_derivatives(build(rng.normal(size=(6, 2)), R), rng.normal(size=(6, 4)))


def test_position_and_velocity_are_normalised_gaussians_of_their_part() -> None:
    x, z = np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.5, 2.5])
    position = log_density(position_measurement(z, R), x)
    velocity = log_density(velocity_measurement(z, R), x)
    assert position == pytest.approx(log_gaussian(x[:2], z, R), rel=1e-12)
    assert velocity == pytest.approx(log_gaussian(x[2:], z, R), rel=1e-12)


def test_crowd_of_two_is_measured_by_its_positions() -> None:
    crowd, z = np.arange(8.0), np.array([0.0, 1.0, 2.0, 3.5])
    assert position_measurement(z, np.eye(4), dim=8).energy(crowd) == pytest.approx(0.125)


@given(
    seed=st.integers(0, 10**6),
    nu=st.sampled_from([0.5, 1.5, 2.5]),
    steps=st.integers(1, 9),
    length=st.floats(0.3, 5.0),
)
def test_regression_equals_dense_linear_algebra(
    seed: int, nu: float, steps: int, length: float
) -> None:
    """Matérn + linear kernel (Trautman and Krause, IROS 2010), positions at some of the steps."""
    rng = np.random.default_rng(seed)
    times = np.sort(rng.uniform(0, 5, steps)) + 0.1 * np.arange(steps)
    kernel = matern(times, 0.8, length, nu) + linear_kernel(times, 0.5, 1.0, center=2.0)
    K = np.kron(kernel, np.array([[1.0, 0.3], [0.3, 0.7]]))
    assume(np.linalg.cond(K) < 1e8)  # its inverse, the prior's precision, has digits to lose
    mean = rng.normal(size=(steps, 2))
    seen = [k for k in range(steps) if k % 2 == 0]
    z = rng.normal(size=(len(seen), 2))

    placed: list[tuple[Residual, tuple[int, ...]]] = [(dense_prior(mean, K), tuple(range(steps)))]
    placed += [(position_measurement(zk, R, dim=2), (k,)) for k, zk in zip(seen, z, strict=True)]
    H = np.kron(np.eye(steps)[seen], np.eye(2))
    S = H @ K @ H.T + np.kron(np.eye(len(seen)), R)
    expected = mean.ravel() + K @ H.T @ np.linalg.solve(S, z.ravel() - H @ mean.ravel())
    assert_allclose(solve(placed, [2] * steps), expected, rtol=0, atol=1e-10)


def test_dense_prior_is_a_normalised_gaussian() -> None:
    rng = np.random.default_rng(3)
    K = np.kron(matern(np.arange(4.0), 0.7, 1.5), R)
    mean, x = rng.normal(size=(2, 4, 2))
    expected = log_gaussian(x.ravel(), mean.ravel(), K)
    assert log_density(dense_prior(mean, K), *x) == pytest.approx(expected, rel=1e-12)


def test_dense_prior_with_the_wnoa_kernel_equals_the_sparse_prior() -> None:
    """The same process stated twice: by its covariance and by its increments."""
    rng = np.random.default_rng(8)
    S0, steps = np.diag([0.3, 0.2, 0.5, 0.4]), 5
    step = GPPrior(0.4, np.array([[0.6, 0.1], [0.1, 0.4]]))
    Phi = np.eye(4) + 0.4 * np.eye(4, k=2)
    transfer = np.zeros((steps, steps, 4, 4))
    for row, column in zip(*np.tril_indices(steps), strict=True):
        transfer[row, column] = np.linalg.matrix_power(Phi, row - column)
    A = transfer.transpose(0, 2, 1, 3).reshape(4 * steps, 4 * steps)
    noise = np.kron(np.eye(steps), step.Q)
    noise[:4, :4] = S0
    mean = A[:, :4] @ (first := rng.normal(size=4))
    x = rng.normal(size=(steps, 4))
    sparse = log_density(gaussian(first, S0), x[0])
    sparse += log_density(step, x[:-1], x[1:]).sum()
    dense = log_density(dense_prior(mean.reshape(steps, 4), A @ noise @ A.T), *x)
    assert dense == pytest.approx(sparse, rel=1e-10)


@given(
    fraction=st.floats(0.0, 1.0),
    quantity=st.sampled_from(["position", "velocity"]),
    seed=st.integers(0, 10**6),
)
def test_interpolated_measurement_equals_a_state_of_its_own(
    fraction: float, quantity: Literal["position", "velocity"], seed: int
) -> None:
    """Adding a state at the time stamp and measuring it gives the same two neighbours."""
    dt, Qc = 0.8, np.array([[0.6, 0.1], [0.1, 0.4]])
    # Nearer to a state the oracle itself loses its digits: the extra state's Q shrinks as tau³.
    tau = min(max(fraction, 0.05), 0.95) * dt
    rng = np.random.default_rng(seed)
    z, start = rng.normal(size=2), gaussian(rng.normal(size=4), np.diag([0.3, 0.2, 0.5, 0.4]))
    between = interpolated_measurement(GPPrior(dt, Qc), tau, z, R, quantity)
    direct = {"position": position_measurement, "velocity": velocity_measurement}[quantity](z, R)
    two = solve([(start, (0,)), (GPPrior(dt, Qc), (0, 1)), (between, (0, 1))], [4, 4])
    three = solve(
        [
            (start, (0,)),
            (GPPrior(tau, Qc), (0, 1)),
            (GPPrior(dt - tau, Qc), (1, 2)),
            (direct, (1,)),
        ],
        [4, 4, 4],
    )
    assert_allclose(two, np.delete(three, np.s_[4:8]), rtol=0, atol=1e-8)


@pytest.mark.parametrize("quantity", ["position", "velocity"])
@pytest.mark.parametrize(("tau", "slot"), [(0.0, 0), (0.5, 1)])
def test_interpolated_measurement_at_a_state_measures_that_state(
    quantity: Literal["position", "velocity"], tau: float, slot: int
) -> None:
    rng = np.random.default_rng(6)
    x, z = rng.normal(size=(2, 4)), rng.normal(size=2)
    between = interpolated_measurement(GPPrior(0.5, np.eye(2)), tau, z, R, quantity)
    direct = {"position": position_measurement, "velocity": velocity_measurement}[quantity](z, R)
    expected = log_density(direct, x[slot])
    assert log_density(between, *x) == pytest.approx(expected, rel=1e-9)


@given(st.floats(0.1, 3), st.floats(0.1, 10), st.sampled_from([0.5, 1.5, 2.5]))
def test_matern_is_a_stationary_covariance(sigma: float, length: float, nu: float) -> None:
    times = np.array([-1.0, 0.0, 0.3, 2.0, 2.5])
    K = matern(times, sigma, length, nu)
    assert_allclose(np.diag(K), sigma**2)
    assert_allclose(K, matern(times + 7.0, sigma, length, nu), rtol=1e-9)
    assert np.linalg.eigvalsh(K).min() > -1e-12 * sigma**2


def test_matern_agrees_with_its_bessel_form() -> None:
    """Rasmussen and Williams, 2006, eq. 4.14."""
    times, length = np.array([0.0, 0.7, 1.9]), 1.3
    r = np.abs(times[:, None] - times) + np.diag(np.full(3, np.nan))
    for nu in (0.5, 1.5, 2.5):
        a = np.sqrt(2 * nu) * r / length
        expected = 4 * 2 ** (1 - nu) / special.gamma(nu) * a**nu * special.kv(nu, a)
        off = ~np.eye(3, dtype=bool)
        assert_allclose(matern(times, 2.0, length, nu)[off], expected[off], rtol=1e-10)


def test_linear_kernel_is_the_covariance_of_a_random_line() -> None:
    times = np.array([0.0, 1.0, 3.0])
    features = np.stack([np.ones(3), times - 2.0], axis=1)
    expected = features @ np.diag([0.25, 9.0]) @ features.T
    assert_allclose(linear_kernel(times, 0.5, 3.0, center=2.0), expected)


ERRORS: list[tuple[Any, str]] = [
    (lambda: position_measurement(np.zeros(3), R), "do not fit"),
    (lambda: position_measurement(np.zeros(2), np.diag([1.0, -1.0])), "positive definite"),
    (lambda: position_measurement(np.array([0.0, np.nan]), R), "not finite"),
    (lambda: position_measurement(np.zeros(2), R, dim=1), "no position of 2"),
    (lambda: velocity_measurement(np.zeros(2), R, dim=5), "needs a state of 4, got 5"),
    (lambda: measurement((np.eye(3),), np.zeros(2), R), "do not fit"),
    (lambda: measurement((np.eye(2),), np.zeros((1, 1, 2)), R), "do not fit"),
    (lambda: interpolated_measurement(GPPrior(0.5, R), 0.6, np.zeros(2), R), "tau must lie"),
    (lambda: dense_prior(np.zeros((2, 3)), np.eye(5)), "does not fit"),
    (lambda: dense_prior(np.zeros(5), np.eye(5)), "does not fit"),
    (lambda: dense_prior(np.zeros((3, 1)), linear_kernel(np.arange(3.0), 1, 1)), "positive def"),
    (lambda: matern(np.arange(3.0), 1.0, 1.0, nu=2.0), "nu must be one of"),
    (lambda: matern(np.arange(3.0), -1.0, 1.0), "sigma must be positive"),
    (lambda: matern(np.arange(3.0), 1.0, np.nan), "length must be positive"),
    (lambda: linear_kernel(np.arange(3.0), 1.0, 0.0), "slope must be positive"),
]


@pytest.mark.parametrize(("build", "message"), ERRORS)
def test_documented_errors(build: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build()
