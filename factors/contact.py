"""Contact between two bodies: what is not done, beside what is preferred (`interaction.py`)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from factors.hinge import TINY, hinge_scale
from factors.pairwise import PairPotential, Radial
from factors.residual import Array


@dataclass(frozen=True, eq=False)
class Contact(PairPotential):
    r"""exp(−weight · max(0, reach − ‖Δ‖)²/(2 sigma²)).

    The interaction saturates at a few nats; this hinge costs tens of nats per step at contact.

    Args:
        reach: Separation below which it acts: both radii and a margin ε, a number or one per
            pair, shape (P,) [m].
        sigma: [m]; inf switches it off.
        weight: Exponent of the potential, dt/t_ref.

    Raises:
        ValueError: reach or weight is negative, or sigma is not positive.
    """

    reach: Array | float
    sigma: float
    weight: float = 1.0

    def __post_init__(self) -> None:
        if not np.all(np.asarray(self.reach) >= 0):
            raise ValueError(f"reach must not be negative, got {self.reach}")
        hinge_scale(self.sigma, self.weight)

    @cached_property
    def _scale(self) -> float:
        return hinge_scale(self.sigma, self.weight)

    def energy(self, d2: Array) -> Array:
        e, _ = self._hinge(d2)
        return 0.5 * e**2

    def linearize(self, d2: Array) -> tuple[Array, Array]:
        e, d = self._hinge(d2)
        return e, np.where(e > 0, -self._scale / d, 0.0)

    def expand(self, d2: Array) -> Radial:
        e, d = self._hinge(d2)
        slope = -self._scale * e / d
        second = np.where(e > 0, self._scale**2, 0.0)
        return Radial(0.5 * e**2, slope, slope, (second - slope) / d**2)

    def _hinge(self, d2: Array) -> tuple[Array, Array]:
        """The whitened hinge and the distance, smoothed at coincidence."""
        d = np.sqrt(d2 + TINY**2)
        return self._scale * np.maximum(self.reach - d, 0.0), d
