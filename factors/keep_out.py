"""A region to keep out of."""

from __future__ import annotations

from dataclasses import dataclass

from factors.one_sided import OnPosition, Scalar
from factors.residual import Array
from factors.shape import Shape


@dataclass(frozen=True, eq=False)
class KeepOut(OnPosition):
    r"""e = √weight · max(0, margin − d(p))/sigma, d the signed distance to a region.

    Args:
        shape: The region.
        margin: Distance that is kept from it: the robot's radius, and some more [m].
        sigma: [m]; inf switches the penalty off.
        weight: Exponent of the potential, dt/t_ref.
        dim: Size of the state, whose first two components are the position.

    Raises:
        ValueError: sigma is not positive, or the weight is negative.
    """

    shape: Shape
    margin: float = 0.0
    sigma: float = 0.1
    weight: float = 1.0
    dim: int = 4

    def excess(self, *x: Array) -> Scalar:
        d, gradient, hessian = self.shape.expand(x[0][..., :2])
        return Scalar(self.margin - d, -gradient, -hessian)
