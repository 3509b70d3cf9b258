"""Data about a planning level or the robot: operator data, waypoints, tactical data.

Whatever is known about a trajectory of the density enters as a `Measurement` of it: once, at its
level, at its own times. No data is no measurement, and never a wish to stop.

`Reading`s carry time stamps, so they may arrive in any order, lie between two steps of the density,
before now or beyond the horizon: `fgplan.conditioning` says what each then means. What is no
reading (a region to stay in, a speed that holds for a while) is a factor on the steps themselves,
a `Piece`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from fgplan.robots import Piece

Array = NDArray[np.float64]

ROBOT = "robot"
"""Measures the robot's own trajectory f^R instead of a level."""


@dataclass(frozen=True, eq=False)
class Reading:
    """z = position or velocity at one time, plus noise.

    Args:
        time: On the clock of `Scenario.now` [s]. None: whenever the plan comes nearest, which each
            hypothesis answers for itself; only for a position on a level.
        value: Shape (2,) [m] or [m/s], map frame.
        covariance: Of the noise, shape (2, 2).
        quantity: What is measured.
        said: When it was said, on the same clock [s]: before its time where a wish is about what
            comes next. None is at its time. On a plan without width it is compared with the plan
            there was then.
    """

    time: float | None
    value: Array
    covariance: Array
    quantity: Literal["position", "velocity"] = "position"
    said: float | None = None


@runtime_checkable
class Measurement(Protocol):
    """What measures one level of the stack, or the robot."""

    @property
    def on(self) -> str | None:
        """Name of the level that is measured, "robot", or None for the first level, η_0."""
        ...

    @property
    def readings(self) -> Sequence[Reading]:
        """What was read at which time; may be empty."""
        ...

    def pieces(self, now: float, times: Array) -> Iterable[Piece]:
        """Further factors, on states (x, y, vx, vy) at the steps of the density; may be empty.

        Args:
            now: Time of the density's first state, on the clock of the data [s].
            times: t_k from now, shape (T + 1,) [s].
        """
        ...


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings of one level and nothing else: the plainest measurement."""

    readings: tuple[Reading, ...]
    on: str | None = None

    def pieces(self, now: float, times: Array) -> Iterable[Piece]:
        """None."""
        return ()
