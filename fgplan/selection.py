"""Which component to follow: by height or by mass."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from fgplan.mixture import Component

Array = NDArray[np.float64]

Rule = Callable[[Sequence[Component]], Array]
"""A selection rule: components → one log score each; the best feasible score is followed."""


def height(components: Sequence[Component]) -> Array:
    """log w_i + log p(x_i*): the most probable single joint trajectory."""
    return np.array([c.log_prior - c.lowest for c in components])


def mass(components: Sequence[Component]) -> Array:
    """log w_i + log Z_i: the most probable hypothesis; −inf where there is no evidence."""
    return np.array(
        [-np.inf if c.log_evidence is None else c.log_prior + c.log_evidence for c in components]
    )


def softmax(scores: Array) -> Array:
    """Probabilities from log scores; all zero when no score is finite."""
    finite = np.isfinite(scores)
    if not finite.any():
        return np.zeros_like(scores)
    weights = np.where(finite, np.exp(scores - scores[finite].max()), 0.0)
    return np.asarray(weights / weights.sum())
