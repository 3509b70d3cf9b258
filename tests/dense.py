"""The Gaussian part of a density by dense linear algebra, from kernels: an oracle for stacks.

Positions alone, at the times at which a level has states; it uses no factor of the library.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import lcm

import numpy as np
from numpy.typing import NDArray

from fgplan import Density, Level, Robot

Array = NDArray[np.float64]


def matern(t: Array, sigma: float, length: float) -> Array:
    """Covariance of a Matérn-3/2 process at times (n,)."""
    r = np.sqrt(3) * np.abs(t[:, None] - t) / length
    return sigma**2 * (1 + r) * np.exp(-r)


def integrated_wiener(t: Array, Qc: float) -> Array:
    """Covariance of positions under white noise on acceleration, from a known state at 0."""
    low, high = np.minimum(t[:, None], t), np.maximum(t[:, None], t)
    return Qc * low**2 * (3 * high - low) / 6


def smooth_precision(t: Array, Qc: float) -> Array:
    """Precision of positions under white noise on acceleration with nothing known at the start:
    the same covariance with a vague state now, in the limit, by the polynomial part left out."""
    K = np.zeros((len(t), len(t)))
    K[1:, 1:] = integrated_wiener(t[1:] - t[0], Qc)
    # A first position and velocity without a prior: P = K⁻¹ without its span of (1, t). In terms
    # of second divided differences D (their null space is that span): P = Dᵀ (D K Dᵀ)⁻¹ D.
    D = np.zeros((len(t) - 2, len(t)))
    for i, ((a, b), (_, c)) in enumerate(pairwise(pairwise(t))):
        D[i, i : i + 3] = [1 / (b - a), -1 / (b - a) - 1 / (c - b), 1 / (c - b)]
    return D.T @ np.linalg.solve(D @ K @ D.T, D)


class Stack:
    """Precision and information vector over the positions of all levels and of the robot.

    Args:
        levels: At least one; each of positive width.
        means: Mean positions of each level at every step, shape (T + 1, 2).
        robot: With an exact state.
        d: The density.
    """

    def __init__(
        self, levels: Sequence[Level], means: Sequence[Array], robot: Robot, d: Density
    ) -> None:
        t = d.times
        self.steps = [np.arange(0, len(t), level.every) for level in levels]
        self.steps.append(np.arange(1, len(t)))
        self.ends = np.cumsum([0, *map(len, self.steps)])
        size = self.ends[-1]
        self.P, self.b = np.zeros((size, size)), np.zeros((size, 2))
        for i, (level, mean) in enumerate(zip(levels, means, strict=True)):
            at = self.steps[i]
            if np.isfinite(level.sigma):
                self._add(i, np.linalg.inv(matern(t[at], level.sigma, level.length)), mean[at])
            elif level.Qc is not None:
                self._add(i, smooth_precision(t[at], level.Qc), np.zeros((len(at), 2)))
        free = robot.position + t[1:, None] * robot.velocity
        self._add(len(levels), np.linalg.inv(integrated_wiener(t[1:], d.Qc_robot)), free)
        names = [level.name for level in levels]
        above = [
            i - 1 if level.follows is None else names.index(level.follows)
            for i, level in enumerate(levels)
        ]
        for i in range(1, len(levels)):
            every = lcm(levels[above[i]].every, levels[i].every)
            self._couple(above[i], i, levels[above[i]].h, every, d)
        for i, level in enumerate(levels):
            if i not in above[1:]:
                self._couple(i, len(levels), level.h, level.every, d)
                k = self._index(i, 0)  # the robot's state now is known
                self.P[k, k] += level.every * d.exponent / level.h
                self.b[k] += level.every * d.exponent / level.h * robot.position

    def _index(self, i: int, step: int) -> int:
        return int(self.ends[i] + np.flatnonzero(self.steps[i] == step)[0])

    def _add(self, i: int, P: Array, mean: Array) -> None:
        part = slice(self.ends[i], self.ends[i + 1])
        self.P[part, part] += P
        self.b[part] += P @ mean

    def _couple(self, i: int, j: int, h: float, every: int, d: Density) -> None:
        for step in range(0, d.steps + 1, every):
            if step in self.steps[j]:
                a, b = self._index(i, step), self._index(j, step)
                p = every * d.exponent / h
                self.P[[a, b], [a, b]] += p
                self.P[[a, b], [b, a]] -= p

    @property
    def mean(self) -> list[Array]:
        """Optimal positions of each level, then of the robot from step 1 on."""
        return np.split(np.linalg.solve(self.P, self.b), self.ends[1:-1])

    @property
    def covariance(self) -> Array:
        return np.linalg.inv(self.P)
