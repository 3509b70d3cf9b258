"""A place beside somebody who leads."""

from __future__ import annotations

import numpy as np

from factors.measurement import position_measurement
from factors.residual import Array, Linear, positive


def formation(
    leader: Array, direction: Array, offset: Array, sigma: float, weight: float = 1.0, dim: int = 4
) -> Linear:
    r"""p_k = leader_k + R_k offset + noise: the place in the leader's frame, at every step.

    R_k turns the x axis to the leader's direction; the noise has standard deviation
    sigma/√weight.

    Args:
        leader: Positions, shape (S, 2) [m].
        direction: Of the leader, any length above 0, shape (S, 2).
        offset: (ahead, to the left) of the leader, shape (2,) [m].
        sigma: [m].
        weight: Exponent of the potential, dt/t_ref.
        dim: Size of the state, whose first two components are the position.

    Raises:
        ValueError: sigma or weight is not positive, or a direction is 0.
    """
    positive(sigma=sigma, weight=weight)
    size = np.linalg.norm(direction, axis=-1, keepdims=True)
    if not np.all(size > 0):
        raise ValueError(f"direction must not be 0, got {direction}")
    u = direction / size
    left = np.stack([-u[..., 1], u[..., 0]], axis=-1)
    place = leader + offset[0] * u + offset[1] * left
    return position_measurement(place, sigma**2 / weight * np.eye(2), dim)
