"""The distinct optima of a hypothesis as a mixture: where samplers start and propose from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgplan.inference.gaussian import Blend, Gaussian, at_mode, average_curvature, blend, linear
from fgplan.inference.limits import moderated
from fgplan.inference.posterior import Posterior
from fgplan.solver import Solution

Array = NDArray[np.float64]

NEGLIGIBLE = 20.0
"""An optimum this many nats above the best adds nothing to the evidence."""


Limits = Literal["propagated", "curvature"]
"""How the robot's limits are seen around an optimum: as they are, by expectation propagation
(`limits.moderated`), or by their curvature there, which is none where a limit is kept."""


class Mode(NamedTuple):
    """A local optimum, the Gaussian there, and the log of its mass."""

    solution: Solution
    gaussian: Gaussian
    log_mass: float


def modes(posterior: Posterior, limits: Limits = "propagated") -> tuple[Mode, ...]:
    r"""Every optimum that matters and is one: log mass = log p(x*) + (d/2) log 2π − ½ log det H,
    and where limits are propagated what they change of it.

    Args:
        posterior: The density and its distinct local optima; those without a positive definite
            Hessian are left out, and those `NEGLIGIBLE` nats above the best.
        limits: How the robot's limits are seen.
    """
    assembly, which = posterior.assembly, posterior.which
    lowest = posterior.best.energy
    found = []
    for optimum in posterior.optima:
        if not optimum.energy < lowest + NEGLIGIBLE:
            continue
        gaussian = at_mode(assembly, optimum.state, which)
        if gaussian is None:
            continue
        log_mass = gaussian.log_volume - optimum.energy
        if limits == "propagated":
            within = moderated(assembly, optimum.state, which, posterior.bounded)
            gaussian, log_mass = within or (gaussian, log_mass)
        found.append(Mode(optimum, gaussian, posterior.log_normalizer + log_mass))
    return tuple(found)


def proposal(posterior: Posterior, found: Sequence[Mode], dof: float, defensive: float) -> Blend:
    r"""(1 − defensive) Σ_j mass_j t_ν(x_j*, H_j) + defensive N(linear-Gaussian part).

    Potentials have energies that are never negative, so that the density lies below its linear
    part and importance weights below Z_linear/defensive: their variance is finite whatever the
    modes miss.

    Where no optimum has a positive definite Hessian, the Gauss–Newton one stands in.

    Args:
        posterior: The density.
        found: Its modes.
        dof: ν.
        defensive: Share of the linear-Gaussian part.

    Reference:
        Hesterberg, Technometrics 1995, on defensive mixtures.
    """
    assembly, which = posterior.assembly, posterior.which
    whole = linear(assembly, which)
    if found:
        log_mass = np.array([mode.log_mass for mode in found])
        share = np.exp(log_mass - np.logaddexp.reduce(log_mass))
        parts = [
            (mode.gaussian, (1 - defensive) * max(s, 1e-6), dof)
            for mode, s in zip(found, share.tolist(), strict=True)
        ]
    else:
        stand_in = average_curvature(assembly, posterior.best.state[None], which)
        parts = [(stand_in, 1 - defensive, dof)]
    return blend([*parts, (whole, defensive, float("inf"))])
