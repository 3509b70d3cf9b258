"""Importance sampling: from the robot's prior, as the paper reads the ROS stack, or around the
optima."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from fgplan.assembly import Assembly
from fgplan.inference.base import (
    HEAVY_TAIL,
    LOW_ESS,
    Diagnostics,
    Inferred,
    Progress,
    Seed,
    tell,
)
from fgplan.inference.diagnostics import kish, pareto_shape
from fgplan.inference.gaussian import Blend, Gaussian, blend, linear, prior
from fgplan.inference.modes import modes, proposal
from fgplan.inference.posterior import Posterior
from fgplan.model import Term
from fgplan.solver import Solution

Array = NDArray[np.float64]

Source = Literal["laplace", "linear", "prior", "kinematic"]


@dataclass(frozen=True)
class Importance:
    r"""Weighted draws x_n ~ q, w_n ∝ p(x_n)/q(x_n), log Z = log mean of the weights.

    Proposals:

    - "laplace": Student t around every optimum with the true Hessian, and a share of the linear
      part (`modes.proposal`).
    - "linear": the linear-Gaussian part, couplings included.
    - "prior": the normalised densities alone, p(f^R) p(f) p(η). The weights are then ψ alone,
      which is right for every expectation; the paper's choice, the sample with the largest ψ·p,
      is `Inferred.best`.
    - "kinematic": as "prior", with the robot drawn by its own model, which keeps every limit
      exactly (`RobotModel.sample`). The weights are ψ alone, too, limits not among them, and log Z
      is log E ψ under that prior: it compares hypotheses, and is no log Z of another source.

    Args:
        draws: How many.
        source: Where they come from.
        dof: ν of the Student t around the optima.
        defensive: Share of the linear part in "laplace".
        batch: Draws evaluated at once.

    Raises:
        ValueError: fewer than 2 draws, a share or ν out of range, or no source has that name.

    Reference:
        Trautman, arXiv 1611.08767, section 1.1; Owen and Zhou, JASA 2000.
    """

    draws: int = 8192
    source: Source = "laplace"
    dof: float = 30.0
    defensive: float = 0.1
    batch: int = 512
    name: str = "importance"

    def __post_init__(self) -> None:
        if self.source not in get_args(Source):
            names = ", ".join(map(repr, get_args(Source)))
            raise ValueError(f"source must be one of {names}, got {self.source!r}")
        if self.draws < 2 or self.batch < 1:
            raise ValueError(f"draws and batch must be positive, got {self.draws}, {self.batch}")
        if not (0 < self.defensive < 1 and self.dof > 0):
            raise ValueError(
                "defensive must lie in (0, 1) and dof be positive, got "
                f"{self.defensive}, {self.dof}"
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
        posterior = Posterior(assembly, which, optima)
        if self.source == "kinematic":
            drawn = _kinematic(posterior, self.draws, rng, self.batch, progress, self.name)
        else:
            q = self._proposal(posterior)
            drawn = weigh(posterior, q, self.draws, rng, self.batch, progress, self.name)
        return weighted(self.name, posterior, *drawn)

    def _proposal(self, posterior: Posterior) -> Blend:
        """What is drawn from, with a density."""
        if self.source == "laplace":
            return proposal(posterior, modes(posterior), self.dof, self.defensive)
        of = linear if self.source == "linear" else prior
        return blend([(of(posterior.assembly, posterior.which), 1.0, float("inf"))])


def weigh(
    posterior: Posterior,
    q: Blend,
    draws: int,
    rng: np.random.Generator,
    batch: int = 512,
    progress: Progress | None = None,
    what: str = "importance",
) -> tuple[Array, Array, Array]:
    """Draws from q with log p/q, p carrying its normalisers, and their energies."""
    X = np.empty((draws, *posterior.assembly.reference.shape[1:]))
    log_weights, energies = np.empty(draws), np.empty(draws)
    for at in range(0, draws, batch):
        rows = slice(at, min(at + batch, draws))
        X[rows] = q.draw(rng, rows.stop - rows.start)
        energies[rows] = posterior.energy(X[rows])
        log_weights[rows] = -energies[rows] - q.log_density(X[rows])
        tell(progress, what, rows.stop, draws)
    return X, log_weights + posterior.log_normalizer, energies


def _kinematic(
    posterior: Posterior,
    draws: int,
    rng: np.random.Generator,
    batch: int,
    progress: Progress | None,
    what: str,
) -> tuple[Array, Array, Array]:
    """Draws of the robot by its model, and of all else from its prior; log ψ, and energies.

    Raises:
        ValueError: the density has no robot model, or its levels no prior of their own.
    """
    assembly, which = posterior.assembly, posterior.which
    model = assembly.models[which]
    if model.kinematic is None:
        raise ValueError("this density has no robot model to draw from")
    robot = model.columns["robot"]
    only_robot = model.reference.shape[1] == robot.stop - robot.start
    others = None if only_robot else prior(assembly, which, robot=False)
    told = 0.0 if others is None else _told(assembly, which, others)
    X = np.empty((draws, *model.reference.shape))
    log_psi, energies = np.empty(draws), np.empty(draws)
    for at in range(0, draws, batch):
        rows = slice(at, min(at + batch, draws))
        count = rows.stop - rows.start
        if others is not None:
            X[rows] = others.draw(rng, count)
        X[rows, :, robot] = model.kinematic(count, rng)
        energies[rows] = posterior.energy(X[rows])
        log_psi[rows] = told - _potentials(assembly, which, X[rows])
        tell(progress, what, rows.stop, draws)
    return X, log_psi, energies


def _told(assembly: Assembly, which: int, others: Gaussian) -> float:
    """log of the integral of the densities of the others, which they are drawn from: what data on
    levels says of the hypothesis; 0 where there is none."""
    found, at = others.log_volume, others.mean[None]
    for wired, term in assembly.wired(which):
        if _of_others(term):
            energy = float(wired.residual.energy(*wired.variables(at)).sum())
            found += term.residual.log_normalizer * len(term.steps) - energy
    return found


def _of_others(term: Term) -> bool:
    """Whether it is a density, and not of the robot: data on the robot is a density, but none it
    was drawn from."""
    of_robot = all(name == "robot" for name, _ in term.variables)
    return bool(term.residual.log_normalizer) and not of_robot and not term.robots_own


def _potentials(assembly: Assembly, which: int, X: Array) -> Array:
    """Energy of what the draws have not seen: all but the robot's own and the densities of the
    others. Shape (N,)."""
    total = np.zeros(len(X))
    for wired, term in assembly.wired(which):
        if not term.robots_own and not _of_others(term):
            total += wired.residual.energy(*wired.variables(X)).sum(-1)
    return total


def log_mean(log_weights: Array) -> tuple[float, float]:
    """log of the mean of the weights and its standard error, to first order."""
    N, top = len(log_weights), float(log_weights.max())
    if not np.isfinite(top):
        return -np.inf, np.inf
    w = np.exp(log_weights - top)
    return top + float(np.log(w.mean())), float(w.std(ddof=1) / w.mean() / np.sqrt(N))


def weighted(
    name: str, posterior: Posterior, X: Array, log_weights: Array, energies: Array
) -> Inferred:
    """The result of weighted draws; those without weight are counted and not returned."""
    N, possible = len(X), np.isfinite(log_weights)
    log_z, error = log_mean(log_weights)
    ess, tail = kish(log_weights), pareto_shape(log_weights)
    doubts = distrust(ess, tail)  # an error from such weights would itself be one
    some = bool(possible.any())
    if some:
        X, log_weights, energies = X[possible], log_weights[possible], energies[possible]
    else:  # nothing that was drawn can be: what the solver found is all there is
        best = posterior.best
        X, log_weights, energies = best.state[None], np.zeros(1), np.array([best.energy])
    return Inferred(
        method=name,
        states=X,
        weights=np.exp(log_weights - np.logaddexp.reduce(log_weights)),
        energies=energies,
        log_evidence=log_z if some else None,
        log_evidence_error=error if some and not doubts else None,
        diagnostics=Diagnostics(
            draws=N,
            ess=ess,
            acceptance=ess / N,
            mcse=float(1 / np.sqrt(ess)) if ess > 0 else None,
            pareto=tail,
            energies=N,
        ),
        warnings=(*posterior.warnings, *doubts, *deeper(energies, posterior.optima)),
        model=posterior.assembly.models[posterior.which],
    )


def distrust(ess: float, tail: float) -> list[str]:
    """Why weighted draws cannot be trusted."""
    warnings = []
    if ess < LOW_ESS:
        warnings.append(f"effective sample size {ess:.1f} is below {LOW_ESS:g}")
    if tail > HEAVY_TAIL:
        warnings.append(f"importance weights have a heavy tail (k = {tail:.2f})")
    return warnings


def deeper(energies: Array, optima: Sequence[Solution]) -> list[str]:
    """A sample that no optimum found lies above: a mode was missed."""
    gap = min(o.energy for o in optima) - float(energies.min())
    if gap > 1e-3:
        return [f"a sample is {gap:.2f} nats more probable than every optimum found"]
    return []
