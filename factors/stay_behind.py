"""Stay behind somebody who walks on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from factors.one_sided import OnPosition, Scalar, affine, directed
from factors.residual import Array, Residual


@dataclass(frozen=True, eq=False)
class StayBehind(OnPosition):
    r"""e = √weight · max(0, uᵀ(p − person) + gap)/sigma: no further along their way than they are.

    Args:
        person: Where they are, shape (2,), or (S, 2) [m].
        direction: Where they walk, any length above 0, shape (2,), or (S, 2).
        gap: How far behind to stay [m].
        sigma: [m]; inf switches the penalty off.
        weight: Exponent of the potential, dt/t_ref.
        dim: Size of the state, whose first two components are the position.

    Raises:
        ValueError: a direction is 0, sigma is not positive, or the weight is negative.
    """

    per_step: ClassVar[tuple[str, ...]] = ("person", "direction")

    person: Array
    direction: Array
    gap: float = 1.0
    sigma: float = 0.2
    weight: float = 1.0
    dim: int = 4

    def __post_init__(self) -> None:
        super().__post_init__()
        person, direction = directed(self.person, self.direction)
        object.__setattr__(self, "person", person)
        object.__setattr__(self, "direction", direction)

    def at(self, step: int) -> Residual:
        return self if self.person.ndim == 1 else super().at(step)

    def excess(self, *x: Array) -> Scalar:
        ahead = np.sum(self.direction * (x[0][..., :2] - self.person), axis=-1)
        return affine(ahead + self.gap, self.direction)
