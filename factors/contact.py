"""Contact between two bodies: what is not done, beside what is preferred (`interaction.py`)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from factors.hinge import TINY, Hinge, hinge_scale
from factors.pairwise import PairPotential
from factors.radial import Radial
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
    def _hinge(self) -> Hinge:
        return Hinge(self.reach, hinge_scale(self.sigma, self.weight), "below")

    def energy(self, d2: Array) -> Array:
        return self._hinge.energy_of(d2)

    def linearize(self, d2: Array) -> tuple[Array, Array]:
        d = np.sqrt(d2 + TINY**2)
        e = self._hinge.error(d)
        return e, np.where(e > 0, -self._hinge.scale / d, 0.0)

    def expand(self, d2: Array) -> Radial:
        return self._hinge.radial(d2)
