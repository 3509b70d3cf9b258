"""Log evidence from draws of the posterior: bridge sampling."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgplan.assembly import Assembly
from fgplan.inference.diagnostics import effective_sample_size, kish
from fgplan.inference.gaussian import Blend, blend, markov_fit
from fgplan.inference.posterior import Posterior

Array = NDArray[np.float64]

FITTED, MODES, TAILS = 0.85, 0.10, 0.05
"""Shares of the proposal: fitted to draws, around the optima, and the linear part."""
DRAWS_A_COORDINATE = 10
"""A fit needs so many draws for each coordinate of two neighbouring steps."""


class Evidence(NamedTuple):
    """log Z, its standard error, and how many draws of each side lie where both do."""

    log_z: float
    error: float
    overlap: float


def bridge(log_ratio_posterior: Array, log_ratio_proposal: Array) -> Evidence:
    r"""Z by the optimal bridge between an unnormalised p and a normalised q:

    Z = E_q[p h] / E_p[q h],  h = 1/(s₁ p + s₂ Z q),

    iterated to its fixed point. The error follows from the variances of both means, that over the
    chains with their effective sample size.

    Args:
        log_ratio_posterior: log p/q at draws of p, shape (C, n).
        log_ratio_proposal: log p/q at independent draws of q, shape (M,).

    Reference:
        Meng and Wong, Statistica Sinica 1996; Frühwirth-Schnatter, Econometrics Journal 2004, for
        the error.
    """
    l1, l2 = log_ratio_posterior, log_ratio_proposal
    N1 = max(1.0, float(effective_sample_size(np.clip(l1, -1e3, 1e3))))
    N2 = len(l2)
    s1, s2 = N1 / (N1 + N2), N2 / (N1 + N2)
    log_z = float(np.median(l1))
    for _ in range(1000):
        # p/(s1 p + s2 Z q) and q/(s1 p + s2 Z q), in logs of p/q.
        top = l2 - np.logaddexp(np.log(s1) + l2, np.log(s2) + log_z)
        bottom = -np.logaddexp(np.log(s1) + l1, np.log(s2) + log_z)
        new = _log_mean(top) - _log_mean(bottom)
        done = abs(new - log_z) < 1e-10
        log_z = float(new)
        if done or not np.isfinite(log_z):
            break
    if not np.isfinite(log_z):
        return Evidence(-np.inf, np.inf, 0.0)
    f1, f2 = np.exp(top - top.max()), np.exp(bottom - bottom.max())
    variance = f1.var() / f1.mean() ** 2 / N2
    if f2.std() > 0:
        variance += f2.var() / f2.mean() ** 2 / float(effective_sample_size(f2))
    overlap = min(kish(top), kish(bottom.ravel()))
    return Evidence(log_z, float(np.sqrt(variance)), overlap)


def evidence(
    posterior: Posterior,
    draws: Array,
    energies: Array,
    around: Blend,
    rng: np.random.Generator,
) -> Evidence:
    """log Z of a hypothesis from its chains.

    The first half of the chains fits a proposal, a Gaussian a mode with the chains' own moments;
    the second half is bridged to it, so that nothing is used twice.

    Args:
        posterior: The density.
        draws: Shape (C, n, S, D).
        energies: Shape (C, n).
        around: Around the optima, the linear part last (`modes.proposal`).
        rng: For the draws of the proposal.
    """
    half = draws.shape[1] // 2
    shape = draws.shape[2:]
    q = fitted(posterior.assembly, draws[:, :half].reshape(-1, *shape), around)
    second = draws[:, half:]
    offset = posterior.log_normalizer
    log_q = q.log_density(second.reshape(-1, *shape)).reshape(second.shape[:2])
    count = second.shape[0] * second.shape[1]
    Y = q.draw(rng, count)
    energy = np.concatenate([posterior.energy(Y[at : at + 512]) for at in range(0, count, 512)])
    return bridge(offset - energies[:, half:] - log_q, offset - energy - q.log_density(Y))


def fitted(assembly: Assembly, X: Array, around: Blend) -> Blend:
    """A Gaussian fitted to the draws of each mode, with shares of `around` for the rest."""
    *near, whole = zip(around.parts, around.shares.tolist(), around.dof, strict=True)
    mode = around.log_densities(X)[:, : len(near)].argmax(axis=1)
    parts = []
    for j in range(len(near)):
        own = X[mode == j]
        if len(own) >= DRAWS_A_COORDINATE * 2 * X.shape[-1]:
            gaussian = markov_fit(own, assembly.free, near[j][0].shear)
            if gaussian is not None:
                parts.append((gaussian, FITTED * len(own) / len(X), float("inf")))
    total = sum(share for _, share, _ in near)
    parts += [(g, MODES * share / total, dof) for g, share, dof in near]
    return blend([*parts, (whole[0], TAILS, whole[2])])


def _log_mean(x: Array) -> float:
    return float(np.logaddexp.reduce(x, axis=None) - np.log(x.size))
