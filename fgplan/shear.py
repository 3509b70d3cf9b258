r"""Coordinates in which a robot with wheels moves linearly.

Its next position is p' = p + m(θ, v, ω, v', ω') + defect, and the defect is millimetres: around a
curve the density is a thin bent sheet, which no Gaussian in the states can follow. With m taken
linear around a reference, ȳ = m(u*) + M (u − u*), u = (θ, v, ω, v', ω'), the map

    x = y,  but its positions  p_k = y_k + Σ_{j<k} [m(u_j) − ȳ(u_j)],

adds to positions a function of all else. Its Jacobian is unit triangular, so densities keep their
values; in y the prior of the robot is a Gaussian, and a Gaussian in y bends along.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from factors.unicycle import UnicycleMotion

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Shear:
    """The map from y to states x, and back.

    Args:
        motion: How the robot moves between two states.
        robot: Columns of the robot's states.
        reference: A state of all variables, shape (S, D), or one of each of a batch; there x = y.
    """

    motion: UnicycleMotion
    robot: slice
    reference: Array

    def bend(self, Y: Array) -> Array:
        """x of y, shape (..., S, D)."""
        return self._shifted(Y, 1.0)

    def straighten(self, X: Array) -> Array:
        """y of x, shape (..., S, D)."""
        return self._shifted(X, -1.0)

    def pull(self, X: Array, gradient: Array) -> Array:
        """The gradient in y of what has this gradient (..., S, D) in x, at states x."""
        before, after = self._pair(X)
        bend = self.motion.moved_slope(before, after) - self._slope
        at = self.robot.start
        later = np.cumsum(gradient[..., :0:-1, at : at + 2], axis=-2)[..., ::-1, :]
        share = np.einsum("...i,...ij->...j", later, bend)
        out = gradient.copy()
        out[..., :-1, at + 2 : at + 5] += share[..., :3]
        out[..., 1:, at + 3 : at + 5] += share[..., 3:]
        return out

    def _shifted(self, X: Array, sign: float) -> Array:
        before, after = self._pair(X)
        u, moved = _local(before, after), self.motion.moved(before, after)
        straight = self._moved + np.einsum("...kij,...kj->...ki", self._slope, u - self._at)
        out = X.copy()
        at = self.robot.start
        out[..., 1:, at : at + 2] += sign * np.cumsum(moved - straight, axis=-2)
        return out

    def _pair(self, X: Array) -> tuple[Array, Array]:
        return X[..., :-1, self.robot], X[..., 1:, self.robot]

    @cached_property
    def _at(self) -> Array:
        return _local(*self._pair(self.reference))

    @cached_property
    def _moved(self) -> Array:
        return self.motion.moved(*self._pair(self.reference))

    @cached_property
    def _slope(self) -> Array:
        return self.motion.moved_slope(*self._pair(self.reference))


def _local(before: Array, after: Array) -> Array:
    """(θ, v, ω, v', ω'), shape (..., 5)."""
    return np.concatenate([before[..., 2:], after[..., 3:]], axis=-1)
