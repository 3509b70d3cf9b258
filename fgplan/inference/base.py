"""What every inference method takes and returns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fgplan.assembly import Assembly
from fgplan.inference.gaussian import Gaussian
from fgplan.model import Model
from fgplan.solver import Solution
from fgplan.trajectory import Trajectory

Array = NDArray[np.float64]
Seed = int | Sequence[int] | np.random.Generator
Progress = Callable[[str, int, int], None]
"""Told (what is being done, steps done, steps in all) now and then."""

LOW_ESS = 100.0
"""Fewer effective samples than this are too few to trust."""
HIGH_RHAT = 1.01
"""Chains above this have not mixed (Vehtari et al., Bayesian Analysis 2021)."""
HEAVY_TAIL = 0.7
"""Pareto shape above which importance weights cannot be trusted (Vehtari et al., JMLR 2024)."""

REDRAWN = 100
"""A Gaussian's draws beyond a limit are drawn again so often; then it is its optimum."""


class Inference(Protocol):
    """A way to know p(x | hypothesis i, data) and its evidence: a frozen strategy."""

    @property
    def name(self) -> str:
        """For tables and the command line."""
        ...

    def infer(
        self,
        assembly: Assembly,
        which: int,
        optima: Sequence[Solution],
        seed: Seed = 0,
        progress: Progress | None = None,
    ) -> Inferred:
        """Infer the trajectories of one hypothesis.

        Args:
            assembly: The density.
            which: The hypothesis.
            optima: Its distinct local optima, at least one, as the solver found them.
            seed: Of every random number; the same seed gives the same bits.
            progress: Told how far it is.
        """
        ...


@dataclass(frozen=True)
class Diagnostics:
    """What a result is worth; None where a number does not apply.

    Args:
        draws: Trajectories returned.
        chains: Markov chains they come from.
        ess: Effective sample size: Kish's for weighted draws; for chains the smallest of all
            coordinates and of the energy.
        acceptance: Share of accepted proposals; for elliptical slices one over the evaluations
            that one draw took.
        jumps: Share of accepted jumps between modes.
        rhat: Largest split R-hat of all coordinates and of the energy.
        mcse: Largest Monte-Carlo standard error of a coordinate's mean, in its own posterior
            standard deviations.
        pareto: Shape of the tail of the importance weights.
        divergences: Leapfrog paths that left the energy surface.
        step: Leapfrog step in whitened coordinates.
        energies: Trajectories whose energy was evaluated.
        gradients: Trajectories whose gradient was evaluated.
    """

    draws: int
    chains: int = 0
    ess: float | None = None
    acceptance: float | None = None
    jumps: float | None = None
    rhat: float | None = None
    mcse: float | None = None
    pareto: float | None = None
    divergences: int | None = None
    step: float | None = None
    energies: int = 0
    gradients: int = 0


@dataclass(frozen=True, eq=False)
class Inferred:
    """The trajectories of one hypothesis, weighted, and the evidence they leave.

    Args:
        method: Name of what inferred it.
        states: Trajectories of all variables, shape (N, S, D), see `Model.columns`: draws, or the
            optima. Chains follow one another: (chains, draws) in C order.
        weights: Shape (N,), they sum to 1.
        energies: −log of the unnormalised density at each, shape (N,) [nats].
        log_evidence: log Z_i; None where the method gives none.
        log_evidence_error: Its standard error [nats]; None where it is not known.
        diagnostics: What it is worth.
        warnings: Why it cannot be trusted; empty where nothing speaks against it.
        gaussians: What surrounds each trajectory; empty where they are points.
        model: The density of the hypothesis; it knows what is where in a state. None where the
            states are only those of a robot.
    """

    method: str
    states: Array
    weights: Array
    energies: Array
    log_evidence: float | None
    log_evidence_error: float | None
    diagnostics: Diagnostics
    warnings: tuple[str, ...] = ()
    gaussians: tuple[Gaussian, ...] = ()
    model: Model | None = None

    @property
    def best(self) -> Array:
        """The trajectory of the highest density, shape (S, D): the mode, or the sample of the
        largest ψ·p. The only one to act on: a mean over modes may be a collision."""
        return np.asarray(self.states[int(np.argmin(self.energies))])

    @cached_property
    def mean(self) -> Array:
        """Shape (S, D)."""
        return np.asarray(np.einsum("n,nsd->sd", self.weights, self._centres))

    @property
    def _centres(self) -> Array:
        """The states, or the means of what surrounds them."""
        return np.stack([g.mean for g in self.gaussians]) if self.gaussians else self.states

    @cached_property
    def covariance(self) -> Array:
        """Of the flattened trajectory, shape (S·D, S·D)."""
        d = (self._centres - self.mean).reshape(len(self.states), -1)
        spread = (self.weights[:, None] * d).T @ d
        for weight, gaussian in zip(self.weights, self.gaussians, strict=False):
            spread += weight * gaussian.covariance
        return np.asarray(spread)

    def trajectories(self, name: str = "robot") -> tuple[Trajectory, ...]:
        """Each as a trajectory of the robot, as it is driven; or of a random level ("level 0", from
        the mission down), or of a planned person by name.

        Raises:
            ValueError: none of them has that name, or the density is not known.
        """
        model = self.model
        if model is None:
            raise ValueError("these states come without the density that says what they are")
        return tuple(model.trajectory(state, name) for state in self.states)

    def resampled(self, count: int, seed: Seed = 0) -> Array:
        """Trajectories of equal weight, shape (count, S, D). Around optima that keep the robot's
        limits, what would break one is drawn again."""
        rng = np.random.default_rng(seed)
        rows = rng.choice(len(self.states), size=count, p=self.weights)
        X = self.states[rows]
        for j, gaussian in enumerate(self.gaussians):
            left = np.flatnonzero(rows == j)
            for _ in range(REDRAWN if self._within(self.states[j : j + 1]).all() else 1):
                drawn = gaussian.draw(rng, len(left))
                fine = self._within(drawn) | ~self._within(X[left])
                X[left[fine]] = drawn[fine]
                left = left[~fine]
                if not len(left):
                    break
        return X

    def _within(self, X: Array) -> NDArray[np.bool_]:
        """Which states (N, S, D) break no limit of the robot, shape (N,)."""
        if self.model is None or self.model.within is None:
            return np.ones(len(X), dtype=bool)
        return self.model.within(X[..., self.model.columns["robot"]])

    def to_dict(self) -> dict[str, Any]:
        """Numbers for JSON, without the trajectories."""
        numbers = {
            key: None if value is not None and not np.isfinite(value) else value
            for key, value in asdict(self.diagnostics).items()
        }
        return {
            "method": self.method,
            "log_evidence": self.log_evidence,
            "log_evidence_error": self.log_evidence_error,
            **numbers,
            "warnings": list(self.warnings),
        }


def probabilities(log_priors: Sequence[float], inferred: Sequence[Inferred]) -> tuple[Array, Array]:
    r"""p(i | data) ∝ w_i Z_i and their standard errors, both shape (K,): inference on the mixture.

    var p_i = p_i² Σ_j (δ_ij − p_j)² var(log Z_j), to first order. A hypothesis without evidence
    has probability 0; one whose error is unknown makes the errors infinite.
    """
    log_z = np.array([-np.inf if r.log_evidence is None else r.log_evidence for r in inferred])
    score = np.asarray(log_priors, dtype=float) + log_z
    if not np.isfinite(score).any():
        return np.zeros(len(score)), np.full(len(score), np.inf)
    p = np.exp(score - np.logaddexp.reduce(score))
    errors = np.array(
        [
            (0.0 if r.log_evidence is None else np.inf)
            if r.log_evidence_error is None
            else r.log_evidence_error
            for r in inferred
        ]
    )
    if not np.isfinite(errors).all():
        return p, np.full(len(p), np.inf)
    slope = p[:, None] * (np.eye(len(p)) - p)
    return p, np.sqrt(slope**2 @ errors**2)


def tell(progress: Progress | None, what: str, done: int, total: int) -> None:
    """Report progress, where somebody listens."""
    if progress is not None:
        progress(what, done, total)
