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
from fgplan.inference.modes import proposal
from fgplan.solver import Solution

Array = NDArray[np.float64]
Generator = np.random.Generator

LOW_OVERLAP = 30.0
"""Bridge sampling with fewer draws where both densities are is not to be trusted."""


@dataclass(frozen=True, eq=False)
class Target:
    """One hypothesis to sample, and a proposal around its optima.

    Args:
        assembly: The density.
        which: The hypothesis.
        optima: Its distinct local optima.
        around: `modes.proposal`: Student t around each, and a share of the linear part.
        leaps: What jumps are proposed from.
    """

    assembly: Assembly
    which: int
    optima: Sequence[Solution]
    around: Blend
    leaps: Blend

    @classmethod
    def of(cls, assembly: Assembly, which: int, optima: Sequence[Solution]) -> Target:
        """With the usual proposal."""
        around = proposal(assembly, which, optima, 30.0, 0.1)
        return cls(assembly, which, optima, around, around)

    def adapted(self, seen: Sequence[Array]) -> Target:
        """With jumps from Gaussians fitted to warm-up states (n × (C, S, D)), one a mode: near
        limits and obstacles the optima's own Gaussians are far from the density."""
        leaps = fitted(self.assembly, np.concatenate(seen), self.around) if seen else self.around
        return replace(self, leaps=leaps)

    def energy(self, X: Array) -> Array:
        """Shape (N,); inf where it is not finite."""
        energy = self.assembly.energy(X, np.asarray(self.which))
        return np.where(np.isfinite(energy), energy, np.inf)

    def slope(self, X: Array) -> tuple[Array, Array]:
        """Energy (N,) and gradient (N, S, D); an energy that is not finite is inf."""
        with np.errstate(all="ignore"):  # a path that diverges is refused, not reported
            q = self.assembly.gauss_newton(X, np.full(len(X), self.which))
        energy = np.where(np.isfinite(q.energy), q.energy, np.inf)
        return energy, np.where(np.isfinite(q.gradient), q.gradient, 0.0)

    def starts(self, chains: int, rng: Generator) -> Array:
        """Dispersed over the modes by their mass, every mode at least once, shape (C, S, D).

        A draw around a mode that the density hardly allows is drawn towards it.
        """
        near = len(self.around.parts) - 1
        share = self.around.shares[:near] / self.around.shares[:near].sum()
        mode = _allocate(share, chains)
        X = np.empty((chains, *self.assembly.reference.shape[1:]))
        limit = np.empty(chains)
        centre = np.stack([self.around.parts[j].mean for j in mode])
        for c, j in enumerate(mode):
            X[c] = self.around.parts[j].draw(rng, 1)[0]
            limit[c] = self.energy(centre[c : c + 1])[0] + self.assembly.dimension
        for _ in range(20):
            far = self.energy(X) > limit
            if not far.any():
                break
            X[far] = 0.5 * (X[far] + centre[far])
        return X

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
        proposed = self.energy(Y)
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
        free = draws.reshape(C, n, -1)[..., target.assembly.free.ravel()]
        watched = np.concatenate([free, energies[..., None]], axis=-1)
        ess = float(effective_sample_size(watched).min())
        rhat = float(split_rhat(watched).max())
        spread = np.maximum(free.reshape(C * n, -1).std(axis=0), 1e-300)
        mcse = float((standard_error(free) / spread).max())
        bridged = evidence(target.assembly, target.which, draws, energies, target.around, rng)
        flat = draws.reshape(C * n, *draws.shape[2:])
        warnings = self._doubts(ess, rhat, bridged.overlap)
        warnings += _stuck(target, draws)
        warnings += deeper(energies.ravel(), target.optima)
        connected = bridged.overlap >= LOW_OVERLAP
        possible = np.isfinite(bridged.log_z) and np.isfinite(bridged.error)
        return Inferred(
            method=name,
            states=flat,
            weights=np.full(C * n, 1 / (C * n)),
            energies=energies.ravel(),
            log_evidence=bridged.log_z if possible else None,
            log_evidence_error=bridged.error if possible and connected else None,
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
            model=target.assembly.models[target.which],
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
    """Chains by mode: at least one each where there are enough, the rest by share."""
    order = np.argsort(-share, kind="stable")[:chains]
    count = np.zeros(len(share), dtype=np.intp)
    count[order] = 1
    while count.sum() < chains:
        count[np.argmax(share * chains - count)] += 1
    return np.repeat(np.arange(len(share)), count)
