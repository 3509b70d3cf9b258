"""Any Gaussian over a whole trajectory, as one factor."""

from __future__ import annotations

import numpy as np

from factors.residual import Array, Linear, log_gaussian_normalizer, whitener


def dense_prior(mean: Array, covariance: Array) -> Linear:
    r"""(x_1, ..., x_S) ~ N(mean, covariance), for kernels that are not Markov in the state.

    It connects all S variables, so a graph with it is dense: use `factors.gp_prior` where a
    sparse prior exists.

    Args:
        mean: Shape (S, d).
        covariance: Of the trajectory flattened step by step, shape (S·d, S·d); for a kernel K
            over time and a covariance over space it is `np.kron(K, spatial)`.

    Raises:
        ValueError: the covariance is not symmetric positive definite, or does not fit the mean.
    """
    mean = np.asarray(mean, dtype=float)
    W = whitener(covariance)
    if mean.ndim != 2 or mean.size != len(W):
        raise ValueError(f"mean of shape {mean.shape} does not fit a covariance of {len(W)} rows")
    blocks = tuple(np.split(W, len(mean), axis=1))
    return Linear(blocks, W @ mean.ravel(), log_gaussian_normalizer(W))
