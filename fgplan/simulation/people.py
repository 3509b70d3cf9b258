"""People of a world: where they are, and how they go on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Disc:
    """The robot among people.

    Args:
        position: Shape (2,) [m].
        velocity: Shape (2,) [m/s].
        radius: [m].
        seen: Whether people see it.
    """

    position: Array
    velocity: Array
    radius: float
    seen: bool = True


class People(Protocol):
    """Some people. They change when time goes on, and only then.

    Attributes:
        names: One a person; a name that changes is another person in the same row.
        radii: Shape (n,) [m].
        positions: Shape (n, 2) [m].
        velocities: Shape (n, 2) [m/s].
        present: Who is in the world now, shape (n,).
    """

    names: list[str]
    radii: Array
    positions: Array
    velocities: Array
    present: NDArray[np.bool_]

    def advance(self, dt: float, robot: Disc | None) -> None:
        """Go on by dt [s]; `robot` as it was at the beginning, None where there is none."""
        ...


class Motion(Protocol):
    """How a crowd chooses its velocities."""

    def __call__(
        self, positions: Array, velocities: Array, wishes: Array, dt: float, robot: Disc | None
    ) -> Array:
        """Velocities for the next dt [s], shape (n, 2) [m/s], from what is now and what each
        would do alone, all of shape (n, 2)."""
        ...


def heedless(
    positions: Array, velocities: Array, wishes: Array, dt: float, robot: Disc | None
) -> Array:
    """The motion of people who react to nobody: each does as it wishes."""
    return wishes
