"""What samples are worth: effective sample sizes, split R-hat, standard errors, heavy tails.

Chains are arrays (C, n, ...): C chains of n draws, with any trailing axes of scalars.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

Array = NDArray[np.float64]


def split_rhat(chains: Array) -> Array:
    r"""Split R-hat of rank-normalised draws: √(((n−1)/n W + B/n)/W) over half chains.

    1 where all chains agree; 1 for a scalar that never moves.

    Args:
        chains: Shape (C, n, ...), n ≥ 4.

    Returns:
        Shape (...).

    Reference:
        Vehtari, Gelman, Simpson, Carpenter, Bürkner, Bayesian Analysis 2021.
    """
    z = _split(_rank_normalised(chains))
    n = z.shape[1]
    within = z.var(axis=1, ddof=1).mean(axis=0)
    between = n * z.mean(axis=1).var(axis=0, ddof=1)
    still = within <= 1e-20
    ratio = between / np.where(still, 1.0, within) / n
    value = np.sqrt((n - 1) / n + ratio)
    # Chains that stand still at different places have not mixed at all.
    return np.asarray(np.where(still, np.where(between > 0, np.inf, 1.0), value))


def effective_sample_size(chains: Array) -> Array:
    r"""C n / (1 + 2 Σ_t ρ_t) of the mean, by Geyer's initial monotone sequence over split chains.

    C n for a scalar that never moves; never more than C n log10(C n), for antithetic chains.

    Args:
        chains: Shape (C, n, ...), n ≥ 4.

    Returns:
        Shape (...).

    Reference:
        Geyer, Statistical Science 1992; Vehtari et al., Bayesian Analysis 2021, section 3.2.
    """
    x = _split(chains)
    C, n = x.shape[:2]
    flat = x.reshape(C, n, -1)
    within = flat.var(axis=1, ddof=1).mean(axis=0)
    total = (n - 1) / n * within + flat.mean(axis=1).var(axis=0, ddof=1)
    covariance = _autocovariance(flat).mean(axis=0)  # (n, V)
    moves = total > 1e-300
    rho = 1 - (within - covariance * n / (n - 1)) / np.where(moves, total, 1.0)
    rho[0] = 1.0
    pairs = rho[: n - n % 2].reshape(-1, 2, rho.shape[-1]).sum(axis=1)
    # Sums of neighbouring pairs are positive and decreasing for a reversible chain: what comes
    # after the first that is not is noise.
    keep = np.logical_and.accumulate(pairs > 0, axis=0)
    monotone = np.minimum.accumulate(np.where(keep, pairs, 0.0), axis=0)
    tau = np.maximum(2 * monotone.sum(axis=0) - 1, 1 / np.log10(max(C * n, 10)))
    return np.asarray(np.where(moves, C * n / tau, C * n).reshape(x.shape[2:]))


def standard_error(chains: Array) -> Array:
    """Monte-Carlo standard error of the mean of each scalar, in its unit, shape (...)."""
    spread = chains.reshape(-1, *chains.shape[2:]).std(axis=0)
    return np.asarray(spread / np.sqrt(effective_sample_size(chains)))


def kish(log_weights: Array) -> float:
    r"""Effective size (Σ w)²/Σ w² of weighted draws; 0 where no weight is finite.

    Reference:
        Kish, Survey Sampling, 1965.
    """
    top = log_weights.max()
    if not np.isfinite(top):
        return 0.0
    w = np.exp(log_weights - top)
    return float(w.sum() ** 2 / (w**2).sum())


def pareto_shape(log_weights: Array) -> float:
    r"""Shape k of the generalised Pareto tail of importance weights: above 0.7 their mean cannot
    be trusted, below 0.5 it has a finite variance.

    −inf where the tail is flat (all weights are equal), inf where too few weights are positive.

    Reference:
        Zhang and Stephens, Technometrics 2009, for the fit; Vehtari, Simpson, Gelman, Yao, Gabry,
        JMLR 2024, for the tail's length min(N/5, 3√N) and the threshold.
    """
    N = len(log_weights)
    size = int(min(N / 5, 3 * np.sqrt(N)))
    order = np.sort(log_weights)
    if size < 5 or not np.isfinite(order[-1]):
        return float("inf")
    tail = np.exp(order[-size - 1 :] - order[-1])
    excess = tail[1:] - tail[0]
    if tail[0] <= 0 and np.count_nonzero(excess) < size:
        return float("inf")
    if excess[0] <= 1e-10 * tail[-1] and excess[-1] <= 1e-10 * tail[-1]:
        return float("-inf")
    return _fit_pareto(np.maximum(excess, 1e-300))


def _fit_pareto(excess: Array) -> float:
    """Posterior mean of the shape for sorted excesses, with a weak prior around 0.5."""
    n = len(excess)
    grid = np.arange(1, 30 + int(np.sqrt(n)) + 1)
    quartile = excess[int(n / 4 + 0.5) - 1]
    b = 1 / excess[-1] + (1 - np.sqrt(len(grid) / (grid - 0.5))) / (3 * quartile)
    k = np.log1p(-b[:, None] * excess).mean(axis=1)
    profile = n * (np.log(-b / k) - k - 1)
    weight = np.exp(profile - np.logaddexp.reduce(profile))
    shape = np.log1p(-float((b * weight).sum()) * excess).mean()
    return float((n * shape + 10 * 0.5) / (n + 10))


def _rank_normalised(chains: Array) -> Array:
    """Normal scores of the ranks over all chains."""
    from scipy.stats import rankdata  # a third of a second that planning alone need not pay

    flat = chains.reshape(chains.shape[0] * chains.shape[1], -1)
    ranks = rankdata(flat, axis=0)
    scores = ndtri((ranks - 3 / 8) / (len(flat) + 1 / 4))
    scores[:, np.ptp(flat, axis=0) == 0] = 0.0
    return np.asarray(scores.reshape(chains.shape))


def _split(chains: Array) -> Array:
    """Each chain as two: (2C, n/2, ...)."""
    half = chains.shape[1] // 2
    return np.concatenate([chains[:, :half], chains[:, -half:]])


def _autocovariance(x: Array) -> Array:
    """Biased autocovariance of (C, n, V) along n, by FFT."""
    n = x.shape[1]
    size = 1 << (2 * n - 1).bit_length()
    f = np.fft.rfft(x - x.mean(axis=1, keepdims=True), size, axis=1)
    return np.asarray(np.fft.irfft(f * f.conj(), size, axis=1)[:, :n] / n)
