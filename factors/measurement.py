"""Data: goals, waypoints, operator input, tactical data, all z = H x + noise.

Each is a normalised Gaussian density of z, so that data weighs hypotheses as well as bending
trajectories. A measurement of a whole state is `factors.gp_prior.gaussian`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from factors.gp_prior import GPPrior, transition
from factors.residual import Array, Linear, log_gaussian_normalizer, whitener


def measurement(H: Sequence[Array], z: Array, covariance: Array) -> Linear:
    r"""z = Σ H_i x_i + noise: e = W (Σ H_i x_i − z), WᵀW = covariance⁻¹.

    Args:
        H: One matrix (rows, dims[i]) per variable.
        z: What was measured, shape (rows,), or (S, rows) where it differs by step.
        covariance: Of the noise, shape (rows, rows).

    Raises:
        ValueError: z is not finite, the covariance is not symmetric positive definite, or their
            shapes do not fit.
    """
    z, W = np.asarray(z, dtype=float), whitener(covariance)
    rows = len(W)
    if z.ndim not in (1, 2) or z.shape[-1] != rows or any(len(h) != rows for h in H):
        shapes = [np.shape(h) for h in H]
        raise ValueError(
            f"z of shape {z.shape}, H of shapes {shapes} and a covariance of {rows} rows do not fit"
        )
    if not np.all(np.isfinite(z)):
        raise ValueError(f"z holds a number that is not finite: {z.tolist()}")
    return Linear(tuple(W @ h for h in H), z @ W.T, log_gaussian_normalizer(W))


def position_measurement(z: Array, covariance: Array, dim: int = 4) -> Linear:
    """A measured position (goal, waypoint) of a state whose first components are positions.

    Args:
        z: Shape (m,) or (S, m) [m].
        covariance: Shape (m, m) [m²].
        dim: Size of the state, at least m.

    Raises:
        ValueError: See `measurement`; or the state is smaller than z.
    """
    m = np.shape(z)[-1]
    if m > dim:
        raise ValueError(f"a state of {dim} components has no position of {m}")
    return measurement((np.eye(m, dim),), z, covariance)


def velocity_measurement(z: Array, covariance: Array, dim: int = 4) -> Linear:
    """A measured velocity (joystick) of a state of m positions, then m velocities.

    Args:
        z: Shape (m,) or (S, m) [m/s].
        covariance: Shape (m, m) [m²/s²].
        dim: Size of the state, 2m.

    Raises:
        ValueError: See `measurement`; or dim is not 2m.
    """
    m = np.shape(z)[-1]
    if dim != 2 * m:
        raise ValueError(f"a velocity of {m} components needs a state of {2 * m}, got {dim}")
    return measurement((np.eye(m, dim, k=m),), z, covariance)


def interpolated_measurement(
    prior: GPPrior,
    tau: float,
    z: Array,
    covariance: Array,
    quantity: Literal["position", "velocity"] = "position",
) -> Linear:
    r"""A measurement with its own time stamp, between the states x_k and x_{k+1}.

    z = H x(t_k + τ) + noise, and x(t_k + τ) ~ N(Λ x_k + Ψ x_{k+1}, P(τ)) given the two states, so
    e = W (H Λ x_k + H Ψ x_{k+1} − z) with WᵀW = (covariance + H P Hᵀ)⁻¹: exact for one
    measurement an interval; what several in one interval have in common counts as independent.

    Args:
        prior: The process between the two states.
        tau: Time of the measurement after x_k, 0 ≤ tau ≤ dt [s].
        z: Shape (m,) or (S, m) [m] or [m/s].
        covariance: Shape (m, m).
        quantity: What z measures.

    Raises:
        ValueError: See `measurement`; or tau lies outside the interval.

    Reference:
        Barfoot, Tong, Särkkä, RSS 2014, section III-D, for Λ, Ψ and P.
    """
    dim = prior.dims[0]
    m = dim // 2
    H = np.eye(m, dim, k=0 if quantity == "position" else m)
    Lambda, Psi = prior.interpolate(tau)
    # P = Q(τ) − Ψ Q(dt) Ψᵀ, with Q(τ) = Ψ Q(dt) Phi(τ − dt)ᵀ from the definition of Ψ.
    P = Psi @ prior.Q @ (transition(tau - prior.dt, m) - Psi).T
    return measurement((H @ Lambda, H @ Psi), z, np.atleast_2d(covariance) + H @ P @ H.T)
