"""What Markov chains over trajectories share: where they start, jumps between modes, results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fgplan.assembly import Assembly
from fgplan.inference.base import HIGH_RHAT, LOW_ESS, Diagnostics, Inferred
from fgplan.inference.bridge import evidence, fitted
from fgplan.inference.diagnostics import effective_sample_size, split_rhat, standard_error
from fgplan.inference.gaussian import Blend
from fgplan.inference.importance import deeper
from fgplan.inference.modes import modes, proposal
from fgplan.inference.posterior import Posterior
from fgplan.solver import Solution

Array = NDArray[np.float64]
Generator = np.random.Generator

LOW_OVERLAP = 30.0
"""Bridge sampling with fewer draws where both densities are is not to be trusted."""


@dataclass(frozen=True, eq=False)
class Target:
    """One hypothesis to sample, and a proposal around its optima.

    Args:
        posterior: The density, and its optima.
        around: `modes.proposal`: Student t around each, and a share of the linear part.
        leaps: What jumps are proposed from.
    """

    posterior: Posterior
    around: Blend
    leaps: Blend

    @classmethod
    def of(cls, assembly: Assembly, which: int, optima: Sequence[Solution]) -> Target:
        """With the usual proposal."""
        posterior = Posterior(assembly, which, optima)
        around = proposal(posterior, modes(posterior), 30.0, 0.1)
        return cls(posterior, around, around)

    def adapted(self, seen: Sequence[Array]) -> Target:
        """With jumps from Gaussians fitted to warm-up states (n × (C, S, D)), one a mode: near
        limits and obstacles the optima's own Gaussians are far from the density."""
        if not seen:
            return self
        leaps = fitted(self.posterior.assembly, np.concatenate(seen), self.around)
        return replace(self, leaps=leaps)

    def starts(self, chains: int, rng: Generator) -> Array:
        """Dispersed over the modes by their mass, every mode at least once, shape (C, S, D).

        A draw around a mode that the density hardly allows is drawn towards an optimum there.
        """
        posterior, near = self.posterior, len(self.around.parts) - 1
        ends = np.stack([o.state for o in posterior.optima])
        modes = self.around.log_densities(ends)[:, :near].argmax(axis=1)
        allowed = posterior.energy(ends)
        share = self.around.shares[:near].copy()
        share[[j for j in range(near) if not np.isfinite(allowed[modes == j]).any()]] = 0.0
        mode = _allocate(share / share.sum(), chains)
        at = [min(np.flatnonzero(modes == j), key=lambda i: allowed[i]) for j in mode]
        centre, limit = ends[at], allowed[at] + posterior.assembly.dimension
        X = np.concatenate([self.around.parts[j].draw(rng, 1) for j in mode])
        for _ in range(20):
            far = posterior.energy(X) > limit
            if not far.any():
                return X
            for c in np.flatnonzero(far):
                part = self.around.parts[mode[c]]
                X[c] = part.bend(0.5 * (part.straighten(X[c]) + part.straighten(centre[c])))
        return np.where(far[:, None, None], centre, X)

    def jump(
        self, X: Array, energy: Array, rng: Generator
    ) -> tuple[Array, Array, NDArray[np.bool_]]:
        """An independent Metropolis–Hastings proposal from `leaps` for each chain: what takes
        chains from mode to mode where local moves cannot.

        Returns:
            States and energies after it, and which proposals were accepted.

        Reference:
            Tierney, Annals of Statistics 1994, on mixtures of kernels.
        """
        Y = self.leaps.draw(rng, len(X))
        proposed = self.posterior.energy(Y)
        log_q = self.leaps.log_density(np.concatenate([X, Y]))
        log_ratio = energy - proposed + log_q[: len(X)] - log_q[len(X) :]
        accepted = np.log(rng.random(len(X))) < log_ratio
        keep = accepted[:, None, None]
        return np.where(keep, Y, X), np.where(accepted, proposed, energy), accepted

    def mode_of(self, X: Array) -> NDArray[np.intp]:
        """The optimum whose Gaussian each state most probably belongs to, shape (N,)."""
        near = len(self.around.parts) - 1
        return np.asarray(self.around.log_densities(X)[:, :near].argmax(axis=1))


@dataclass(eq=False)
class Recorder:
    """What chains leave behind."""

    states: list[Array] = field(default_factory=list)
    energies: list[Array] = field(default_factory=list)
    accepted: list[float] = field(default_factory=list)
    jumps: list[float] = field(default_factory=list)
    divergences: int = 0
    evaluated: int = 0
    differentiated: int = 0

    def add(self, X: Array, energy: Array) -> None:
        self.states.append(X.copy())
        self.energies.append(energy.copy())

    def result(
        self,
        name: str,
        target: Target,
        rng: Generator,
        step: float | None = None,
        sampler: str = "",
    ) -> Inferred:
        """Diagnostics, evidence by bridge sampling, and what speaks against them."""
        draws = np.stack(self.states, axis=1)
        energies = np.stack(self.energies, axis=1)
        C, n = energies.shape
        posterior = target.posterior
        free = draws.reshape(C, n, -1)[..., posterior.assembly.free.ravel()]
        watched = np.concatenate([free, energies[..., None]], axis=-1)
        ess = float(effective_sample_size(watched).min())
        rhat = float(split_rhat(watched).max())
        spread = np.maximum(free.reshape(C * n, -1).std(axis=0), 1e-300)
        mcse = float((standard_error(free) / spread).max())
        bridged = evidence(posterior, draws, energies, target.around, rng)
        flat = draws.reshape(C * n, *draws.shape[2:])
        warnings = [*posterior.warnings, *self._doubts(ess, rhat, bridged.overlap)]
        warnings += _stuck(target, draws)
        warnings += deeper(energies.ravel(), posterior.optima)
        connected = bridged.overlap >= LOW_OVERLAP
        possible = np.isfinite(bridged.log_z) and np.isfinite(bridged.error)
        return Inferred(
            method=name,
            states=flat,
            weights=np.full(C * n, 1 / (C * n)),
            energies=energies.ravel(),
            log_evidence=bridged.log_z if possible else None,
            log_evidence_error=bridged.error if possible and connected and ess >= LOW_ESS else None,
            diagnostics=Diagnostics(
                draws=C * n,
                chains=C,
                ess=ess,
                acceptance=float(np.mean(self.accepted)) if self.accepted else None,
                jumps=float(np.mean(self.jumps)) if self.jumps else None,
                rhat=rhat,
                mcse=mcse,
                divergences=self.divergences if sampler == "hmc" else None,
                step=step,
                energies=self.evaluated + C * (n - n // 2),
                gradients=self.differentiated,
            ),
            warnings=tuple(warnings),
            model=posterior.assembly.models[posterior.which],
        )

    def _doubts(self, ess: float, rhat: float, overlap: float) -> list[str]:
        warnings = []
        if ess < LOW_ESS:
            warnings.append(f"effective sample size {ess:.1f} is below {LOW_ESS:g}")
        if rhat > HIGH_RHAT:
            warnings.append(f"chains have not mixed: split R-hat {rhat:.3f} is above {HIGH_RHAT}")
        if overlap < LOW_OVERLAP:
            warnings.append(f"log evidence rests on {overlap:.0f} draws: the bridge is too long")
        if self.divergences:
            warnings.append(f"{self.divergences} divergences: part of the density is too stiff")
        return warnings


def _stuck(target: Target, draws: Array) -> list[str]:
    """Chains that never left their modes say nothing about the masses of the modes."""
    near = len(target.around.parts) - 1
    if near < 2:
        return []
    C, n = draws.shape[:2]
    mode = target.mode_of(draws.reshape(C * n, *draws.shape[2:])).reshape(C, n)
    visited = len(np.unique(mode))
    if visited > 1 and not np.any(mode[:, 1:] != mode[:, :-1]):
        return [
            f"no chain went from one of {visited} modes to another: their masses are the starts'"
        ]
    return []


def _allocate(share: Array, chains: int) -> NDArray[np.intp]:
    """Chains by mode: at least one each with a share where there are enough, the rest by share."""
    order = np.argsort(-share, kind="stable")[: min(chains, np.count_nonzero(share))]
    count = np.zeros(len(share), dtype=np.intp)
    count[order] = 1
    while count.sum() < chains:
        count[np.argmax(share * chains - count)] += 1
    return np.repeat(np.arange(len(share)), count)
