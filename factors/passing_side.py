"""On which side to pass a point: somebody, a table, a wet floor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from factors.one_sided import OnPosition, Scalar, affine, directed
from factors.residual import Array, Residual


@dataclass(frozen=True, eq=False)
class PassingSide(OnPosition):
    r"""e = √weight · g(a) · max(0, gap − s)/sigma, with s = nᵀ(p − centre), a = uᵀ(p − centre).

    u is the direction of travel past the centre and n points to the side where to be; the gate
    g(a) = exp(−a²/(2 length²)) lets it count only abeam of the centre.

    Args:
        centre: What is passed, shape (2,), or (S, 2) where it moves [m].
        direction: Of travel, any length above 0, shape (2,), or (S, 2).
        side: "left": the robot passes on the left of the centre, as seen along the direction.
        gap: Distance beside the centre [m].
        length: Of the gate [m].
        sigma: [m]; inf switches the penalty off.
        weight: Exponent of the potential, dt/t_ref.
        dim: Size of the state, whose first two components are the position.

    Raises:
        ValueError: the side is neither left nor right, a direction is 0, sigma or length is not
            positive, or the weight is negative.
    """

    per_step: ClassVar[tuple[str, ...]] = ("centre", "direction")

    centre: Array
    direction: Array
    side: str
    gap: float = 0.8
    length: float = 1.0
    sigma: float = 0.2
    weight: float = 1.0
    dim: int = 4

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.side not in ("left", "right"):
            raise ValueError(f"side must be 'left' or 'right', got {self.side!r}")
        if not self.length > 0:
            raise ValueError(f"length must be positive, got {self.length}")
        centre, direction = directed(self.centre, self.direction)
        object.__setattr__(self, "centre", centre)
        object.__setattr__(self, "direction", direction)

    def at(self, step: int) -> Residual:
        return self if self.centre.ndim == 1 else super().at(step)

    def excess(self, *x: Array) -> Scalar:
        sign = 1.0 if self.side == "left" else -1.0
        n = sign * np.stack([-self.direction[..., 1], self.direction[..., 0]], axis=-1)
        s = np.sum(n * (x[0][..., :2] - self.centre), axis=-1)
        return affine(self.gap - s, -n)

    def gate(self, *x: Array) -> Scalar:
        u = np.broadcast_to(self.direction, (*x[0].shape[:-1], 2))
        a = np.sum(u * (x[0][..., :2] - self.centre), axis=-1)
        g = np.exp(-(a**2) / (2 * self.length**2))
        slope = -a / self.length**2 * g
        bend = (a**2 / self.length**4 - 1 / self.length**2) * g
        outer = u[..., :, None] * u[..., None, :]
        return Scalar(g, slope[..., None] * u, bend[..., None, None] * outer)
