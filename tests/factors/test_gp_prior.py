"""GP priors: WNOA against GTSAM's native factor, Matérn against its own kernel."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from factors.coupling import coupling, coupling_to
from factors.gp_prior import GPPrior, gaussian, matern_first, matern_prior, transition
from factors.kernels import matern
from tests.factor_testing import check_derivatives


def random_spd(rng, n):
    B = rng.normal(size=(n, n))
    return B @ B.T + 0.1 * np.eye(n)


def test_constant_velocity_has_zero_error():
    x = np.array([1.0, 2.0, 0.5, -0.3])
    prior = GPPrior(0.7, np.eye(2))
    np.testing.assert_allclose(prior.error(x, transition(0.7, 2) @ x), 0, atol=1e-12)


@pytest.mark.parametrize("seed", range(10))
def test_error_matches_gtsam_wnoa_factor(seed):
    rng = np.random.default_rng(seed)
    dt, q = rng.uniform(0.05, 2), rng.uniform(0.01, 5)
    x0, x1 = rng.normal(size=(2, 4))
    keys = range(4)
    native = gtsam.WnoaMotionFactorPoint2(
        gtsam.StateData(keys[0], keys[1], 0.0),
        gtsam.StateData(keys[2], keys[3], dt),
        q * np.ones(2),
    )
    values = gtsam.Values()
    for key, part in zip(keys, (x0[:2], x0[2:], x1[:2], x1[2:]), strict=True):
        values.insert(key, gtsam.Point2(*part))
    ours = GPPrior(dt, q * np.eye(2)).energy(x0, x1)
    assert ours == pytest.approx(native.error(values), rel=1e-12)


@pytest.mark.parametrize("m", [1, 2, 3])
def test_derivatives_and_gtsam_form(m):
    rng = np.random.default_rng(m)
    x0, x1 = rng.normal(size=(2, 2 * m))
    check_derivatives(GPPrior(0.4, random_spd(rng, m)), x0, x1)


def test_covariance_is_that_of_the_stated_process():
    """Two steps of dt/2 compose to one of dt."""
    Qc = random_spd(np.random.default_rng(0), 2)
    half, whole = GPPrior(0.3, Qc), GPPrior(0.6, Qc)
    Phi = transition(0.3, 2)
    np.testing.assert_allclose(Phi @ half.Q @ Phi.T + half.Q, whole.Q, atol=1e-12)


def test_interpolation_is_the_conditional_mean():
    """Oracle: condition the joint Gaussian of (x(τ), x(dt)) given x(0) on x(dt)."""
    rng = np.random.default_rng(1)
    dt, tau, Qc = 0.8, 0.3, random_spd(rng, 2)
    prior = GPPrior(dt, Qc)
    Lambda, Psi = prior.interpolate(tau)
    x0, x1 = rng.normal(size=(2, 4))
    early = GPPrior(tau, Qc).Q
    late = transition(dt - tau, 2)
    mean = transition(tau, 2) @ x0
    gain = early @ late.T @ np.linalg.inv(prior.Q)
    expected = mean + gain @ (x1 - late @ mean)
    np.testing.assert_allclose(Lambda @ x0 + Psi @ x1, expected, atol=1e-10)


def test_log_normalizer_is_the_gaussian_one():
    Qc = random_spd(np.random.default_rng(2), 2)
    prior = GPPrior(0.4, Qc)
    expected = -0.5 * np.linalg.slogdet(2 * np.pi * prior.Q)[1]
    assert prior.log_normalizer == pytest.approx(expected, abs=1e-10)


def test_matern_chain_is_the_matern_kernel():
    """The product of the Markov factors has the covariance of the Matérn-3/2 kernel."""
    dt, sigma, length, S = 0.4, 0.6, 2.5, 7
    mean = np.random.default_rng(3).normal(size=(S, 2))
    information = np.zeros((2 * S, 2 * S))
    first = matern_first(mean[0], sigma, length)
    information[:2, :2] += first.A[0].T @ first.A[0]
    chain = matern_prior(mean, dt, sigma, length)
    J = np.hstack(chain.A)
    for k in range(S - 1):
        at = slice(2 * k, 2 * k + 4)
        information[at, at] += J.T @ J
    covariance = np.linalg.inv(information)[::2, ::2]
    np.testing.assert_allclose(covariance, matern(dt * np.arange(S), sigma, length), atol=1e-9)
    for k in range(S - 1):
        np.testing.assert_allclose(chain.at(k).error(mean[k], mean[k + 1]), 0, atol=1e-12)


def test_matern_derivatives():
    mean = np.random.default_rng(4).normal(size=(5, 4))
    check_derivatives(matern_prior(mean, 0.4, 0.5, 3.0), mean[:-1] + 0.1, mean[1:] - 0.2)


@pytest.mark.parametrize("h", [0.01, 2.0])
def test_coupling_energy_and_derivatives(h):
    rng = np.random.default_rng(5)
    a, b = rng.normal(size=(2, 4))
    psi = coupling(h, weight=0.25)
    assert psi.energy(a, b) == pytest.approx(0.25 * np.sum((a - b)[:2] ** 2) / (2 * h))
    assert coupling_to(a[:2], h, weight=0.25).energy(b) == pytest.approx(float(psi.energy(a, b)))
    check_derivatives(psi, a, b)
    check_derivatives(coupling_to(rng.normal(size=(4, 2)), h), rng.normal(size=(4, 4)))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: GPPrior(0.0, np.eye(2)), "dt must be positive"),
        (lambda: GPPrior(np.nan, np.eye(2)), "dt must be positive"),
        (lambda: GPPrior(0.4, -np.eye(2)), "Qc must be positive definite"),
        (lambda: GPPrior(0.4, np.eye(2)).interpolate(0.5), "tau must lie"),
        (lambda: matern_prior(np.zeros((2, 4)), 0.4, 0.0, 1.0), "sigma must be positive"),
        (lambda: coupling(0.0), "h is a variance"),
        (lambda: coupling_to(np.zeros(2), -1.0), "h is a variance"),
        (lambda: gaussian(np.zeros(2), np.diag([1.0, 0.0])), "positive definite"),
    ],
)
def test_bad_parameters_are_named(make, says):
    with pytest.raises(ValueError, match=says):
        make()
