"""Markov chain Monte Carlo that is fitted to Gaussian-process priors: elliptical slices."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fgplan.assembly import Assembly
from fgplan.inference.base import Inferred, Progress, Seed, tell
from fgplan.inference.chains import Recorder, Target
from fgplan.inference.gaussian import Gaussian, linear, prior
from fgplan.solver import Solution

Array = NDArray[np.float64]
Generator = np.random.Generator


@dataclass(frozen=True)
class EllipticalSlice:
    r"""Elliptical slice sampling against a Gaussian N(m, C) over the whole trajectory.

    p(x) = N(x; m, C) · L(x) for any N. A new state lies on the ellipse through x and a draw of N,
    x' = m + (x − m) cos θ + (ν − m) sin θ, at the first θ of a shrinking bracket whose L is above
    a random level. There is no step size, and every draw of N keeps the GP's smoothness.

    N is "linear", the linear-Gaussian part of the density, or "prior", its normalised densities
    alone. Where limits and obstacles cut off most of N, the slices are short: chains are then
    slow, and say so.

    Every `jump_every` steps each chain also proposes a jump to an independent draw around the
    optima, so that modes get their masses.

    Args:
        chains: Evaluated together.
        draws: Kept of each chain.
        warmup: Steps before.
        thin: Steps a draw.
        reference: N.
        jump_every: 0 for no jumps.

    Raises:
        ValueError: a count out of range, or no reference has that name.

    Reference:
        Murray, Adams, MacKay, AISTATS 2010.
    """

    chains: int = 16
    draws: int = 500
    warmup: int = 1000
    thin: int = 4
    reference: Literal["linear", "prior"] = "linear"
    jump_every: int = 10
    name: str = "mcmc"

    def __post_init__(self) -> None:
        if self.chains < 2 or self.draws < 8 or self.warmup < 0 or self.thin < 1:
            raise ValueError(
                "chains must be at least 2, draws 8, warmup 0 and thin 1, got "
                f"{self.chains}, {self.draws}, {self.warmup}, {self.thin}"
            )
        if self.reference not in ("linear", "prior"):
            raise ValueError(f"reference must be 'linear' or 'prior', got {self.reference!r}")
        if self.jump_every < 0:
            raise ValueError(f"jump_every must be 0 or above, got {self.jump_every}")

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
        N = prior(assembly, which) if self.reference == "prior" else linear(assembly, which)
        energy = target.posterior.energy(X)
        steps = self.warmup + self.draws * self.thin
        seen: list[Array] = []
        for i in range(steps):
            if i == self.warmup:
                target = target.adapted(seen)
                record.accepted.clear()
                record.jumps.clear()
            X, energy, tries = slice_step(target.posterior.energy, N, X, energy, rng)
            record.evaluated += tries
            record.accepted.append(self.chains / tries)
            if self.jump_every and i % self.jump_every == self.jump_every - 1:
                X, energy, went = target.jump(X, energy, rng)
                record.evaluated += self.chains
                record.jumps.append(float(went.mean()))
            if i >= self.warmup and (i - self.warmup) % self.thin == self.thin - 1:
                record.add(X, energy)
            elif self.warmup // 2 <= i < self.warmup:
                seen.append(X)
            if i % 50 == 49 or i + 1 == steps:
                tell(progress, self.name, i + 1, steps)
        return record.result(self.name, target, rng)


def slice_step(
    energy_of: Callable[[Array], Array], N: Gaussian, X: Array, energy: Array, rng: Generator
) -> tuple[Array, Array, int]:
    """One elliptical slice step of every chain, in the coordinates of N.

    Args:
        energy_of: States (C, S, D) → −log p, shape (C,).
        N: The Gaussian reference.
        X: Shape (C, S, D).
        energy: At X, shape (C,).
        rng: Of all random numbers.

    Returns:
        States, energies, and how many energies were evaluated.
    """
    C = len(X)
    d = N.straighten(X) - N.mean
    nu = N.deviation(rng, C)
    level = 0.5 * N.distance2(X) - energy + np.log(rng.random(C))
    theta = rng.uniform(0, 2 * np.pi, C)
    low, high = theta - 2 * np.pi, theta.copy()
    new, reached = X.copy(), energy.copy()
    active, tries = np.arange(C), 0
    for _ in range(200):  # the bracket shrinks to the current state, which is always allowed
        angle = theta[active, None, None]
        Y = N.bend(N.mean + d[active] * np.cos(angle) + nu[active] * np.sin(angle))
        tried = energy_of(Y)
        tries += len(active)
        good = 0.5 * N.distance2(Y) - tried > level[active]
        new[active[good]], reached[active[good]] = Y[good], tried[good]
        active = active[~good]
        if not len(active):
            break
        behind = theta[active] < 0
        low[active] = np.where(behind, theta[active], low[active])
        high[active] = np.where(behind, high[active], theta[active])
        theta[active] = rng.uniform(low[active], high[active])
    return new, reached, tries
