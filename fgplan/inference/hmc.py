"""Hamiltonian Monte Carlo with the density's own gradient, in whitened coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fgplan.assembly import Assembly
from fgplan.inference.base import Inferred, Progress, Seed, tell
from fgplan.inference.chains import Recorder, Target
from fgplan.inference.gaussian import Gaussian, average_curvature, markov_fit
from fgplan.solver import Solution

Array = NDArray[np.float64]
Generator = np.random.Generator

DIVERGED = 1000.0
"""An energy error from here on is a divergence [nats], as in Stan."""


@dataclass(frozen=True)
class HMC:
    r"""Hamiltonian Monte Carlo: H(x, r) = energy(x) + ½‖r‖², ẋ = L⁻ᵀ r, ṙ = −L⁻¹ ∇energy.

    L Lᵀ is the mass matrix: the mean Gauss–Newton Hessian over the starts, then the block-
    tridiagonal precision with the moments of the chains so far. In these coordinates the density
    is nearly isotropic, and one step size, found by dual averaging, serves all. The length of a
    path is random, so that no period is met.

    Every `jump_every` paths each chain also proposes a jump to an independent draw around the
    optima, so that modes get their masses.

    Args:
        chains: Evaluated together.
        draws: Kept of each chain.
        warmup: Paths before, in which mass matrix and step are found.
        target: Share of accepted paths that the step size aims at.
        length: Mean length of a path, in posterior standard deviations.
        most_leaps: Leapfrog steps a path at most.
        jump_every: 0 for no jumps.

    Raises:
        ValueError: a count or share out of range.

    Reference:
        Neal, Handbook of Markov Chain Monte Carlo, 2011, ch. 5; Hoffman and Gelman, JMLR 2014, for
        dual averaging.
    """

    chains: int = 16
    draws: int = 1000
    warmup: int = 300
    target: float = 0.8
    length: float = 1.6
    most_leaps: int = 32
    jump_every: int = 2
    name: str = "hmc"

    def __post_init__(self) -> None:
        if self.chains < 2 or self.draws < 8 or self.warmup < 0 or self.most_leaps < 1:
            raise ValueError(
                "chains must be at least 2, draws 8, warmup 0 and most_leaps 1, got "
                f"{self.chains}, {self.draws}, {self.warmup}, {self.most_leaps}"
            )
        if self.jump_every < 0:
            raise ValueError(f"jump_every must be 0 or above, got {self.jump_every}")
        if not (0 < self.target < 1 and self.length > 0):
            raise ValueError(
                "target must lie in (0, 1) and length be positive, got "
                f"{self.target}, {self.length}"
            )

    def infer(
        self,
        assembly: Assembly,
        which: int,
        optima: Sequence[Solution],
        seed: Seed = 0,
        progress: Progress | None = None,
    ) -> Inferred:
        rng = np.random.default_rng(seed)
        target = Target.of(assembly, which, optima)
        record = Recorder()
        X = target.starts(self.chains, rng)
        paths = _Paths(target, self._mass(target, X), X)
        step = _DualAveraging(self.target)
        total, seen = self.warmup + self.draws, list[Array]()
        for i in range(total):
            warm = i < self.warmup
            if i in (self.warmup // 3, 2 * self.warmup // 3) and seen:
                paths.mass = self._fit(paths.mass, seen) or paths.mass
                step, seen = _DualAveraging(self.target, step.settled), []
            size = step.trial if warm else step.settled
            leaps = 1 + int(rng.uniform(0.5, 1.5) * self.length / size)
            kept = paths.follow(size * rng.uniform(0.8, 1.0), min(leaps, self.most_leaps), rng)
            if warm:
                step.learn(float(kept.mean()))
                seen.append(paths.Y)
            else:
                record.accepted.append(paths.accepted)
            if self.jump_every and i % self.jump_every == self.jump_every - 1:
                went = paths.jump(rng)
                record.evaluated += self.chains
                if not warm:
                    record.jumps.append(float(went.mean()))
            if not warm:
                record.add(paths.X, paths.energy)
            elif i == self.warmup - 1:
                paths.divergences = 0
                paths.target = target.adapted([paths.mass.bend(Y) for Y in seen])
            if i % 10 == 9 or i + 1 == total:
                tell(progress, self.name, i + 1, total)
        record.divergences, record.differentiated = paths.divergences, paths.gradients
        return record.result(self.name, target, rng, step.settled, "hmc")

    def _mass(self, target: Target, X: Array) -> Gaussian:
        """The first mass matrix; of a robot with wheels at the best optimum."""
        posterior = target.posterior
        assembly, which = posterior.assembly, posterior.which
        mass = average_curvature(assembly, posterior.best.state[None], which)
        return mass if mass.shear else average_curvature(assembly, X, which)

    def _fit(self, mass: Gaussian, seen: list[Array]) -> Gaussian | None:
        """From deviations of each chain from its own mean: modes apart do not widen it."""
        Y = np.stack(seen[len(seen) // 3 :])
        S, D = Y.shape[-2:]
        if Y.shape[0] * Y.shape[1] < 10 * 2 * D:
            return None
        fit = markov_fit((Y - Y.mean(axis=0)).reshape(-1, S, D), mass.free)
        return None if fit is None else replace(fit, shear=mass.shear)


class _Paths:
    """Hamiltonian paths of all chains together, in the coordinates y of the mass matrix."""

    def __init__(self, target: Target, mass: Gaussian, X: Array) -> None:
        self.target, self.mass, self.Y = target, mass, mass.straighten(X)
        self.energy, self.slope = self._slope(self.Y)
        self.divergences, self.gradients, self.accepted = 0, len(X), 1.0

    @property
    def X(self) -> Array:
        """States of the chains, shape (C, S, D)."""
        return self.mass.bend(self.Y)

    def follow(self, step: float, leaps: int, rng: Generator) -> Array:
        """One path of every chain by leapfrog, refused where it ends beyond a limit.

        Returns:
            What the leapfrog alone would leave of its probability of acceptance, shape (C,): a
            shorter step keeps energy better, and limits no better.
        """
        L, mass = self.mass.factor, self.mass
        r = mass.noise(rng, len(self.Y))
        before = self.energy + 0.5 * np.einsum("nsd,nsd->n", r, r)
        Y, slope = self.Y, self.slope
        with np.errstate(all="ignore"):  # a path that diverges is refused below
            r = r - 0.5 * step * L.forward(slope)
            for leap in range(leaps):
                Y = Y + step * L.backward(r)
                energy, slope = self._slope(Y)
                r = r - (0.5 if leap == leaps - 1 else 1.0) * step * L.forward(slope)
            error = energy + 0.5 * np.einsum("nsd,nsd->n", r, r) - before
            end = mass.bend(Y)
        self.gradients += leaps * len(Y)
        error = np.where(np.isfinite(error), error, np.inf)
        self.divergences += int(np.count_nonzero(error > DIVERGED))
        probability = np.exp(-np.maximum(error, 0.0))
        accepted = rng.random(len(Y)) < probability
        accepted &= self.target.posterior.allows(end)
        self._move(Y, energy, slope, accepted)
        self.accepted = float(accepted.mean())
        return np.asarray(probability)

    def jump(self, rng: Generator) -> NDArray[np.bool_]:
        """Jumps between modes; returns which were accepted."""
        X, _, accepted = self.target.jump(self.X, self.energy, rng)
        if accepted.any():
            Y = self.mass.straighten(X)
            energy, slope = self._slope(Y)
            self.gradients += len(Y)
            self._move(Y, energy, slope, accepted)
        return accepted

    def _slope(self, Y: Array) -> tuple[Array, Array]:
        """Energy (C,) and its gradient in y (C, S, D)."""
        X = self.mass.bend(Y)
        energy, slope = self.target.posterior.slope(X)
        shear = self.mass.shear
        return energy, slope if shear is None else shear.pull(X, slope) * self.mass.free

    def _move(self, Y: Array, energy: Array, slope: Array, accepted: NDArray[np.bool_]) -> None:
        keep = accepted[:, None, None]
        self.Y = np.where(keep, Y, self.Y)
        self.slope = np.where(keep, slope, self.slope)
        self.energy = np.where(accepted, energy, self.energy)


class _DualAveraging:
    """Step size whose mean acceptance is the target (Hoffman and Gelman 2014, section 3.2)."""

    def __init__(self, target: float, first: float = 0.25) -> None:
        self._target, self._anchor = target, np.log(10 * first)
        self._log, self._smooth, self._gap, self._count = np.log(first), np.log(first), 0.0, 0

    def learn(self, acceptance: float) -> None:
        self._count += 1
        t = self._count
        self._gap += (self._target - acceptance - self._gap) / (t + 10)
        self._log = float(np.clip(self._anchor - np.sqrt(t) / 0.05 * self._gap, -9.0, 1.0))
        self._smooth += t**-0.75 * (self._log - self._smooth)

    @property
    def trial(self) -> float:
        """Step size to learn with."""
        return float(np.exp(self._log))

    @property
    def settled(self) -> float:
        """Step size to keep."""
        return float(np.exp(self._smooth))
