"""ψ(a, b): how closely one plan trajectory follows another."""

from __future__ import annotations

import numpy as np

from factors.residual import Array, Linear


def coupling(
    h: float, dims: tuple[int, int] = (4, 4), space: int = 2, weight: float = 1.0
) -> Linear:
    r"""ψ(a, b) = exp(−weight ‖a − b‖²/(2h)) on the positions of two variables.

    Args:
        h: Variance [m²], not a standard deviation.
        dims: Sizes of the two variables.
        space: How many leading components are positions.
        weight: Exponent of the potential, dt/t_ref.

    Raises:
        ValueError: h is not positive.

    Reference:
        Trautman, arXiv 1611.08767, section 1.1.
    """
    scale = _scale(h, weight)
    A = tuple(sign * scale * np.eye(space, dim) for sign, dim in zip((1, -1), dims, strict=True))
    return Linear(A, np.zeros(space))


def coupling_to(path: Array, h: float, dim: int = 4, weight: float = 1.0) -> Linear:
    """The same with one side fixed: the paper's δ(η − path).

    Args:
        path: Positions, shape (space,) or (S, space) [m].
        h: Variance [m²].
        dim: Size of the variable that follows the path.
        weight: Exponent of the potential, dt/t_ref.

    Raises:
        ValueError: h is not positive.
    """
    scale = _scale(h, weight)
    path = np.asarray(path, dtype=float)
    return Linear((scale * np.eye(path.shape[-1], dim),), scale * path)


def _scale(h: float, weight: float) -> float:
    if not (np.isfinite(h) and h > 0):
        raise ValueError(f"h is a variance and must be positive, got {h}")
    return float(np.sqrt(weight / h))
