"""Trajectories: states on a time grid, and the curve between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Positions and velocities at increasing times; a cubic Hermite curve between them.

    The Hermite cubic is the conditional mean of the white-noise-on-acceleration prior between
    two of its states (Barfoot, Tong, Särkkä, RSS 2014), so what is checked between the states is
    what the density means.

    Args:
        times: Shape (S,) [s], strictly increasing.
        positions: Shape (S, 2) [m].
        velocities: Shape (S, 2) [m/s].
        headings: Where a robot with wheels looks, shape (S,), never wrapped [rad]; None for
            bodies that move in any direction.
        yaw_rates: How fast it turns, shape (S,) [rad/s]; given with the headings.

    Raises:
        ValueError: shapes disagree, a number is not finite, or times do not increase.
    """

    times: Array
    positions: Array
    velocities: Array
    headings: Array | None = None
    yaw_rates: Array | None = None

    def __post_init__(self) -> None:
        size = len(self.times)
        shapes = {"times": (size,), "positions": (size, 2), "velocities": (size, 2)}
        if self.headings is not None:
            shapes["headings"] = (size,)
        if self.yaw_rates is not None:
            shapes["yaw_rates"] = (size,)
        for name, shape in shapes.items():
            value = np.asarray(getattr(self, name), dtype=float)
            if value.shape != shape:
                raise ValueError(f"{name} has shape {value.shape}, expected {shape}")
            if not np.isfinite(value).all():
                raise ValueError(f"{name} holds a number that is not finite")
            object.__setattr__(self, name, value)
        if size == 0 or (self.times[1:] <= self.times[:-1]).any():
            raise ValueError("times must be a non-empty, strictly increasing sequence")
        if (self.headings is None) != (self.yaw_rates is None):
            raise ValueError("headings and yaw_rates are given together or not at all")

    @classmethod
    def from_states(cls, times: Array, states: Array) -> Trajectory:
        """From rows (x, y, vx, vy), shape (S, 4)."""
        return cls(times, states[:, :2], states[:, 2:4])

    @property
    def states(self) -> Array:
        """Rows (x, y, vx, vy), shape (S, 4)."""
        return np.hstack([self.positions, self.velocities])

    @property
    def rows(self) -> list[list[float]]:
        """Rows (t, x, y, vx, vy), and the heading where there is one, as they go into a file."""
        columns = [self.times, self.states]
        if self.headings is not None:
            columns.append(self.headings)
        return np.column_stack(columns).tolist()  # type: ignore[no-any-return]

    def at(self, times: Any) -> Array:
        """States (x, y, vx, vy) at the given times, shape (..., 4).

        Outside the time grid the first or last velocity is held.
        """
        position, velocity = hermite(self.times, self.positions, self.velocities, times)
        return np.concatenate([position, velocity], -1)

    def resampled(self, times: Array) -> Trajectory:
        """The same curve with states at other times; headings, too, are a Hermite cubic."""
        t = np.asarray(times, dtype=float)
        position, velocity = hermite(self.times, self.positions, self.velocities, t)
        if self.headings is None or self.yaw_rates is None:
            return Trajectory(t, position, velocity)
        turned = hermite(self.times, self.headings, self.yaw_rates, t)
        return Trajectory(t, position, velocity, *turned)


def length(vectors: Array) -> Array:
    """Of vectors (..., 2), shape (...); several times as fast as numpy's norm."""
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", vectors, vectors)))


def hermite(times: Array, positions: Array, velocities: Array, at: Any) -> tuple[Array, Array]:
    """Positions and velocities of cubic Hermite curves through states at `times`.

    Args:
        times: Shape (S,), increasing [s].
        positions: Shape (S, ..., 2): any number of bodies at once [m].
        velocities: The same shape [m/s].
        at: Times to evaluate at, shape (Q,) or a number [s]. Outside the grid the first or last
            velocity is held.
    """
    t = np.asarray(at, dtype=float)
    trailing = (1,) * (positions.ndim - 1)
    inside = np.clip(t, times[0], times[-1])
    beyond = (t - inside).reshape(*t.shape, *trailing)
    if len(times) == 1:
        velocity = np.broadcast_to(velocities[0], (*t.shape, *velocities.shape[1:]))
        return positions[0] + beyond * velocity, np.array(velocity)
    k = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    dt = (times[k + 1] - times[k]).reshape(*t.shape, *trailing)
    s = (inside - times[k]).reshape(*t.shape, *trailing) / dt
    p0, p1 = positions[k], positions[k + 1]
    m0, m1 = velocities[k] * dt, velocities[k + 1] * dt
    position = (
        (1 + 2 * s) * (1 - s) ** 2 * p0
        + s * (1 - s) ** 2 * m0
        + s**2 * (3 - 2 * s) * p1
        - s**2 * (1 - s) * m1
    )
    rate = 6 * s * (s - 1) * (p0 - p1) + (1 - s) * (1 - 3 * s) * m0 + s * (3 * s - 2) * m1
    velocity = rate / dt
    return position + beyond * velocity, velocity
