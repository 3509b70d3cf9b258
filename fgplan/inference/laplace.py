"""Laplace's method: a Gaussian at every optimum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fgplan.assembly import Assembly
from fgplan.inference.base import HEAVY_TAIL, Diagnostics, Inferred, Progress, Seed
from fgplan.inference.diagnostics import kish, pareto_shape
from fgplan.inference.importance import log_mean, weigh
from fgplan.inference.modes import Limits, Mode, modes, proposal
from fgplan.inference.posterior import Posterior
from fgplan.solver import Solution

Array = NDArray[np.float64]

FEW = 30.0
"""A check with fewer effective draws than this says nothing."""


@dataclass(frozen=True)
class Laplace:
    r"""p(x) ≈ Σ_j m_j N(x_j*, H_j⁻¹), log m_j = log p(x_j*) + (d/2) log 2π − ½ log det H_j.

    H_j is the true Hessian: the Gauss–Newton one would misrank hypotheses by more than a nat. The
    masses of distinct optima are summed, which counts twice what two of them share.

    The robot's limits act on one side only, which no Hessian sees: they are propagated by default
    (`fgplan.inference.limits`), in place of their curvature.

    What it cannot see (skewness, a wall or a contact that only just touches, modes that no start
    led to) a few draws can: `check` compares log Z with importance sampling around the same
    Gaussians. The difference is the error that is reported.

    Args:
        modes: "all" optima, or only the "best".
        check: Draws of that comparison; 0 for none, and no error then.
        tolerance: Largest difference that is not worth a warning [nats].
        limits: Of the robot: "propagated", or by their "curvature" at the optimum: faster, and far
            too high where an optimum keeps a limit only just.

    Raises:
        ValueError: a negative number of draws, or an unknown choice.
    """

    modes: Literal["all", "best"] = "all"
    check: int = 2000
    tolerance: float = 0.25
    limits: Limits = "propagated"
    name: str = "laplace"

    def __post_init__(self) -> None:
        if self.check < 0:
            raise ValueError(f"check must not be negative, got {self.check}")
        if self.modes not in ("all", "best"):
            raise ValueError(f"modes must be 'all' or 'best', got {self.modes!r}")
        if self.limits not in ("propagated", "curvature"):
            raise ValueError(f"limits must be 'propagated' or 'curvature', got {self.limits!r}")

    def infer(
        self,
        assembly: Assembly,
        which: int,
        optima: Sequence[Solution],
        seed: Seed = 0,
        progress: Progress | None = None,
    ) -> Inferred:
        posterior = Posterior(assembly, which, optima)
        best = posterior.best
        used = list(optima) if self.modes == "all" else [best]
        posterior = Posterior(assembly, which, used)
        found = modes(posterior, self.limits)
        warnings = list(posterior.warnings)
        if len(used) < len(optima):
            warnings.append(f"one mode of {len(optima)}")
        if not found:
            return Inferred(
                self.name, best.state[None], np.ones(1), np.array([best.energy]), None, None,
                Diagnostics(draws=1), (*warnings, "its Hessian is not positive definite"),
                model=assembly.models[which],
            )  # fmt: skip
        log_mass = np.array([mode.log_mass for mode in found])
        log_z = float(np.logaddexp.reduce(log_mass))
        error, numbers = None, Diagnostics(draws=len(found))
        if self.check:
            error, numbers, doubts = self._checked(posterior, found, log_z, seed, progress)
            warnings += doubts
        return Inferred(
            method=self.name,
            states=np.stack([mode.solution.state for mode in found]),
            weights=np.exp(log_mass - log_z),
            energies=np.array([mode.solution.energy for mode in found]),
            log_evidence=log_z,
            log_evidence_error=error,
            diagnostics=numbers,
            warnings=tuple(warnings),
            gaussians=tuple(mode.gaussian for mode in found),
            model=assembly.models[which],
        )

    def _checked(
        self,
        posterior: Posterior,
        found: Sequence[Mode],
        log_z: float,
        seed: Seed,
        progress: Progress | None,
    ) -> tuple[float | None, Diagnostics, list[str]]:
        """Error, numbers and warnings from importance sampling around the same Gaussians."""
        rng = np.random.default_rng(seed)
        q = proposal(posterior, found, dof=30.0, defensive=0.1)
        _, log_weights, _ = weigh(posterior, q, self.check, rng, progress=progress, what=self.name)
        sampled, sampling_error = log_mean(log_weights)
        ess, tail = kish(log_weights), pareto_shape(log_weights)
        numbers = Diagnostics(len(posterior.optima), ess=ess, pareto=tail, energies=self.check)
        if ess < FEW or tail > HEAVY_TAIL:
            why = f"{ess:.0f} effective of {self.check} draws, tail {tail:.2f}"
            return None, numbers, [f"the density is far from Gaussian around its modes ({why})"]
        off = log_z - sampled
        doubts = []
        if abs(off) > self.tolerance + 3 * sampling_error:
            doubts.append(f"log evidence is {abs(off):.2f} nats too {'high' if off > 0 else 'low'}")
        return float(np.hypot(off, sampling_error)), numbers, doubts


QUICK = Laplace(check=0, limits="curvature")
"""What `fgplan.plan` uses unless told otherwise: milliseconds, and no word about its error."""
