"""Diagnostics against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from arviz_stats.base import array_stats

from fgplan.inference.diagnostics import (
    effective_sample_size,
    kish,
    pareto_shape,
    split_rhat,
    standard_error,
)


def autoregressive(rho: float, chains: int, n: int, seed: int = 0) -> np.ndarray:
    """Stationary AR(1) chains of unit variance."""
    rng = np.random.default_rng(seed)
    x = np.empty((chains, n))
    x[:, 0] = rng.standard_normal(chains)
    for t in range(1, n):
        x[:, t] = rho * x[:, t - 1] + np.sqrt(1 - rho**2) * rng.standard_normal(chains)
    return x


@pytest.mark.parametrize("rho", [-0.5, 0.0, 0.5, 0.9])
def test_effective_sample_size_of_an_autoregression(rho):
    """N (1 − ρ)/(1 + ρ)."""
    x = autoregressive(rho, chains=16, n=4000)
    expected = x.size * (1 - rho) / (1 + rho)
    assert effective_sample_size(x) == pytest.approx(expected, rel=0.12)


def test_standard_error_of_an_autoregression_covers_its_mean():
    means = [autoregressive(0.8, 4, 1000, seed).mean() for seed in range(200)]
    claimed = [float(standard_error(autoregressive(0.8, 4, 1000, seed))) for seed in range(20)]
    assert np.mean(claimed) == pytest.approx(np.std(means), rel=0.2)


def test_rhat_is_one_for_chains_that_agree_and_not_for_one_that_does_not():
    x = autoregressive(0.3, 8, 2000)
    assert split_rhat(x) == pytest.approx(1, abs=0.005)
    apart = x.copy()
    apart[0] += 1.0
    assert split_rhat(apart) > 1.03
    drifting = x + np.linspace(0, 2, x.shape[1])
    assert split_rhat(drifting) > 1.1


def test_rhat_has_its_textbook_value():
    """Two halves a chain, m = 4, by hand on normal scores: no rounding of the formula."""
    x = np.random.default_rng(3).normal(size=(2, 50)) + np.array([[0.0], [0.7]])
    from scipy.stats import norm, rankdata

    z = norm.ppf((rankdata(x).reshape(x.shape) - 3 / 8) / (x.size + 1 / 4))
    halves = z.reshape(4, 25)
    B = 25 * halves.mean(axis=1).var(ddof=1)
    W = halves.var(axis=1, ddof=1).mean()
    assert split_rhat(x) == pytest.approx(np.sqrt((24 / 25 * W + B / 25) / W), rel=1e-12)


def test_a_scalar_that_never_moves_is_not_a_failure():
    x = np.ones((4, 100, 2))
    x[..., 1] = autoregressive(0.0, 4, 100)
    np.testing.assert_array_equal(split_rhat(x)[0], 1.0)
    assert effective_sample_size(x)[0] == 400


def test_chains_that_stand_still_apart_have_not_mixed():
    x = np.repeat(np.arange(4.0)[:, None], 100, axis=1)
    assert split_rhat(x) == np.inf
    assert effective_sample_size(x) < 10


def test_kish_of_equal_single_and_impossible_weights():
    assert kish(np.full(7, -1e4)) == pytest.approx(7)
    assert kish(np.array([0.0, -np.inf, -1e5])) == 1
    assert kish(np.full(3, -np.inf)) == 0


@pytest.mark.parametrize("k", [0.2, 0.5, 0.9])
def test_pareto_shape_of_pareto_weights(k):
    u = np.random.default_rng(0).random(40_000)
    weights = (u**-k - 1) / k + 1  # generalised Pareto of shape k
    assert pareto_shape(np.log(weights)) == pytest.approx(k, abs=0.15)


def test_pareto_shape_of_equal_weights_and_of_one():
    assert pareto_shape(np.zeros(1000)) == -np.inf
    one = np.full(1000, -np.inf)
    one[0] = 0.0
    assert pareto_shape(one) == np.inf


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_diagnostics_of_chains_are_those_of_arviz(rho):
    """ArviZ cuts Geyer's sequence one pair later, which is within the noise of the estimate."""
    x, axes = autoregressive(rho, 6, 400), {"chain_axis": 0, "draw_axis": 1}
    assert split_rhat(x) == pytest.approx(array_stats.rhat(x, method="z_scale", **axes), rel=1e-12)
    ess = array_stats.ess(x, method="mean", **axes)
    assert effective_sample_size(x) == pytest.approx(float(ess), rel=0.02)
    error = array_stats.mcse(x, method="mean", **axes)
    assert standard_error(x) == pytest.approx(float(error), rel=0.01)


@pytest.mark.parametrize("shape", [0.2, 0.5, 0.7, 1.0])
def test_the_tail_of_importance_weights_is_that_of_arviz(shape):
    weights = np.random.default_rng(0).random(8000) ** -shape - 1
    expected = array_stats.psislw(-np.log(weights))[1]
    assert pareto_shape(np.log(weights)) == pytest.approx(float(expected), abs=1e-9)
