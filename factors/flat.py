"""A trajectory without a prior of its own: nothing is said of its positions."""

from __future__ import annotations

import numpy as np

from factors.gp_prior import kron
from factors.residual import Array, Linear, log_gaussian_normalizer, positive, whitener


def velocity_of_positions(dt: float, Qc: Array, last: bool = False) -> Linear:
    r"""p(v_k | p_k, p_{k+1}): the velocity goes with the positions, which stay free.

    e = W (v_k − (p_{k+1} − p_k)/dt),  WᵀW = (Qc dt/3)⁻¹, on two consecutive states x = (p, v).

    As a density of v_k it integrates to 1 whatever the positions are. So with one for each step a
    trajectory is flat: integrated out, it is as if it were not there. Qc dt/3 is the variance of
    the mean velocity of a step about its first one under white noise on acceleration.

    Args:
        dt: Time between the two states [s].
        Qc: Shape (m, m) [m²/s³].
        last: Whether it is about the velocity of the second state instead, for the last step.

    Raises:
        ValueError: dt is not positive, or Qc is not symmetric positive definite.
    """
    positive(dt=dt)
    W = whitener(np.atleast_2d(np.asarray(Qc, dtype=float)) * dt / 3, "Qc")
    here, there = [1 / dt, 1.0], [-1 / dt, 0.0]
    if last:
        here, there = [1 / dt, 0.0], [-1 / dt, 1.0]
    A = tuple(W @ kron(np.array([row]), np.eye(len(W))) for row in (here, there))
    return Linear(A, np.zeros(len(W)), log_gaussian_normalizer(W))
