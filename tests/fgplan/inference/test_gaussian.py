"""Gaussians over trajectories against dense numpy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal, multivariate_t

from fgplan import Density, Level
from fgplan.block_tridiagonal import System, factorize
from fgplan.inference.gaussian import (
    Gaussian,
    at_mode,
    average_curvature,
    blend,
    linear,
    markov_fit,
    prior,
)
from fgplan.solver import SecondOrder
from tests.fgplan.test_block_tridiagonal import chain
from tests.scenes import CORRIDOR, STACK, assembled, dense, forked, initial, short, track

FAR = (np.array([0, 1, 8]), 3.0 * np.eye(3))


def gaussian(S: int, D: int, links: bool = False) -> tuple[Gaussian, np.ndarray]:
    """With its dense precision: in the band, block by block, or with links."""
    diagonal, upper = chain(S, D, seed=S + D)
    H = dense(diagonal, upper)
    if links:
        H[np.ix_(FAR[0], FAR[0])] += FAR[1]
    system = System(diagonal, upper, (FAR,) if links else ())
    factor = factorize(*system)
    assert factor is not None
    mean = np.random.default_rng(1).normal(size=(S, D))
    return Gaussian(mean, system, factor, np.ones((S, D), dtype=bool)), H


SIZES = [(1, 1, False), (4, 3, False), (3, 20, False), (4, 3, True)]


@pytest.mark.parametrize(("S", "D", "links"), SIZES)
def test_triangular_solves_invert_the_precision(S, D, links):
    g, H = gaussian(S, D, links)
    b = np.random.default_rng(2).normal(size=(5, S, D))
    half = g.factor.forward(b)
    np.testing.assert_allclose(
        g.factor.backward(half).reshape(5, -1) @ H, b.reshape(5, -1), atol=1e-9
    )
    np.testing.assert_allclose(g.system.times(b).reshape(5, -1), b.reshape(5, -1) @ H, atol=1e-10)
    # ‖L⁻¹ b‖² = bᵀ H⁻¹ b, so that the factor is the one draws need.
    np.testing.assert_allclose(
        (half**2).sum(axis=(1, 2)),
        np.einsum("ni,ij,nj->n", b.reshape(5, -1), np.linalg.inv(H), b.reshape(5, -1)),
        rtol=1e-8,
    )


@pytest.mark.parametrize(("S", "D", "links"), SIZES)
def test_density_and_covariance_equal_scipy(S, D, links):
    g, H = gaussian(S, D, links)
    X = g.draw(np.random.default_rng(3), 6)
    C = np.linalg.inv(H)
    np.testing.assert_allclose(g.covariance, C, atol=1e-9)
    flat, mean = X.reshape(6, -1), g.mean.ravel()
    # Where scipy's own inverse of a covariance is good enough.
    np.testing.assert_allclose(
        g.log_density(X), multivariate_normal(mean, C).logpdf(flat), rtol=1e-6, atol=1e-6
    )
    heavy = blend([(g, 1.0, 5.0)])
    np.testing.assert_allclose(
        heavy.log_density(X), multivariate_t(mean, C, df=5).logpdf(flat), rtol=1e-6, atol=1e-6
    )


def test_draws_have_the_moments():
    g, H = gaussian(3, 2)
    X = g.draw(np.random.default_rng(4), 40_000).reshape(40_000, -1)
    C = np.linalg.inv(H)
    sd = np.sqrt(np.diag(C))
    assert np.abs((X.mean(axis=0) - g.mean.ravel()) / sd).max() < 4 / 200
    assert np.abs((np.cov(X.T) - C) / np.outer(sd, sd)).max() < 4 * np.sqrt(2) / 200


def test_a_blend_integrates_to_one_against_each_of_its_parts():
    g, _ = gaussian(2, 2)
    other = Gaussian(g.mean + 0.5, g.system, g.factor, g.free)
    q = blend([(g, 2.0, 4.0), (other, 1.0, np.inf)])
    X = q.draw(np.random.default_rng(5), 40_000)
    w = np.exp(g.log_density(X) - q.log_density(X))
    assert w.mean() == pytest.approx(1, abs=4 * w.std() / 200)


def test_markov_fit_recovers_a_markov_gaussian():
    g, H = gaussian(5, 2)
    X = g.draw(np.random.default_rng(6), 200_000)
    fit = markov_fit(X, g.free)
    assert fit is not None
    np.testing.assert_allclose(fit.covariance, np.linalg.inv(H), rtol=0.1, atol=0.01)
    assert fit.factor.log_determinant == pytest.approx(g.factor.log_determinant, abs=0.1)


def test_markov_fit_of_too_few_draws_is_none():
    g, _ = gaussian(4, 3)
    assert markov_fit(g.draw(np.random.default_rng(0), 4), g.free) is None


LIGHT = {"contact_sigma": np.inf, "limit_sigma": np.inf, "alpha": 0.0}


@pytest.mark.parametrize("levels", [(Level(),), (CORRIDOR,), STACK], ids=["delta", "wide", "two"])
def test_the_linear_part_is_where_a_linear_solve_ends(levels):
    """From a known state that is not the reference's: the robot does not move along its plan."""
    # Seen to fail with the gradient taken at the reference's held state.
    scenario = forked(track("a", 3.0, 0.5), density=short(**LIGHT), levels=levels)
    assembly, hypotheses = assembled(scenario)
    X, which = initial(assembly, hypotheses)
    solved = SecondOrder().solve(assembly, X[-1:], which[-1:])[0]
    g = linear(assembly, int(which[-1]))
    np.testing.assert_allclose(g.mean, solved.state, atol=1e-7)
    at = at_mode(assembly, solved.state, int(which[-1]))
    assert at is not None
    assert at.factor.log_determinant == pytest.approx(g.factor.log_determinant, abs=1e-8)


def test_the_prior_is_constant_velocity_from_the_state_now():
    assembly, _ = assembled(forked(density=short()))
    g = prior(assembly, 0)
    t = assembly.models[0].times
    np.testing.assert_allclose(g.mean[:, 0], 0.8 * t, atol=1e-9)
    np.testing.assert_allclose(g.mean[:, 1:], [[0, 0.8, 0]] * len(t), atol=1e-9)
    # Integrated white noise: the variance of the last position is Qc t³/3.
    assert g.covariance[-4, -4] == pytest.approx(Density().Qc_robot * t[-1] ** 3 / 3)


def test_a_level_without_a_prior_of_its_own_cannot_be_sampled_from_the_prior():
    assembly, _ = assembled(forked(density=short(), levels=STACK))
    with pytest.raises(ValueError, match="does not fix all"):
        prior(assembly, 0)


def test_states_known_without_error_never_move():
    assembly, hypotheses = assembled(forked(track("a", 2.0, 0.2), density=short()))
    X, which = initial(assembly, hypotheses)
    rng = np.random.default_rng(0)
    now = assembly.models[0].fixed["robot", 0]
    curved = average_curvature(assembly, X[which == 0], 0)
    for g in (linear(assembly, 0), prior(assembly, 0), curved):
        drawn = g.draw(rng, 20)[:, 0, assembly.models[0].columns["robot"]]
        np.testing.assert_array_equal(drawn, np.broadcast_to(now, drawn.shape))
        assert g.covariance[:4, :].any() == g.covariance[:, :4].any()
    fit = markov_fit(linear(assembly, 0).draw(rng, 4000), assembly.free)
    assert fit is not None
    np.testing.assert_allclose(fit.draw(rng, 5)[:, 0, :4], np.broadcast_to(now, (5, 4)), atol=1e-12)
