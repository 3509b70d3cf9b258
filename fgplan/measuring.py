"""Data about a planning level or the robot: operator data, waypoints, tactical data.

Whatever is known about a trajectory of the density enters as a `Measurement` of it: once, at its
level, at its own times. No data is no measurement, and never a wish to stop.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from fgplan.robots import Piece

Array = NDArray[np.float64]


@runtime_checkable
class Measurement(Protocol):
    """What measures one level of the stack, or the robot."""

    @property
    def on(self) -> str:
        """Name of the level that is measured, or "robot"."""
        ...

    def pieces(self, now: float, times: Array) -> Iterable[Piece]:
        """The factors, on states (x, y, vx, vy) at the steps of the density.

        Args:
            now: Time of the density's first state, on the clock of the data [s].
            times: t_k from now, shape (T + 1,) [s].
        """
        ...
