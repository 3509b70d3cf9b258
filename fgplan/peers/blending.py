r"""Linear blending and switching: how shared control is usually arbitrated.

Both decide after the two sides have made up their minds: autonomy has one command u_R, the
operator one u_h. Linear blending mixes them, u = K_h u_h + (I − K_h) u_R. Where both beliefs are
single Gaussians that is the optimum of the joint density, with K_h = K (K + S + h I)⁻¹, K the
covariance of autonomy, S that of the operator, h the variance of the coupling; where either has
several modes it may be a command that neither side would give (Trautman, arXiv 1506.06784).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from factors.coupling import coupling
from factors.gp_prior import gaussian
from fgplan import keys
from fgplan.assembly import Assembly
from fgplan.model import Model, Term, Variable
from fgplan.solver import SecondOrder, Solver

Array = NDArray[np.float64]


def blend_gain(K: Any, S: Any, h: float) -> Array:
    """K_h = K (K + S + h I)⁻¹, shape (m, m): the share of the operator.

    Args:
        K: Covariance of autonomy's command, shape (m, m), or a number.
        S: Covariance of the operator's, the same.
        h: Variance of the coupling, ≥ 0.
    """
    K, S = np.atleast_2d(np.asarray(K, dtype=float)), np.atleast_2d(np.asarray(S, dtype=float))
    return np.asarray(np.linalg.solve((K + S + h * np.eye(len(K))).T, K.T).T)


def blend(u_h: Any, u_R: Any, gain: Any) -> Array:
    """u = K_h u_h + (I − K_h) u_R, shape (m,); a gain may be a number."""
    u_h, u_R = np.atleast_1d(u_h).astype(float), np.atleast_1d(u_R).astype(float)
    K_h = gain * np.eye(len(u_R)) if np.ndim(gain) == 0 else np.asarray(gain, dtype=float)
    return np.asarray(u_R + K_h @ (u_h - u_R), dtype=float)


@dataclass(frozen=True)
class TwistMux:
    """The source with the highest priority that spoke within its timeout (ROS twist_mux).

    Args:
        timeout: An operator who has been silent for longer is not asked [s].
    """

    timeout: float = 0.5

    def choose(self, u_R: Any, u_h: Any | None, age: float) -> Array:
        """The operator's command while it is fresh, else autonomy's.

        Args:
            u_R: Autonomy's.
            u_h: The operator's last one; None where there was none.
            age: Of the operator's [s].
        """
        fresh = u_h is not None and age <= self.timeout
        return np.asarray(u_h if fresh else u_R, dtype=float)


@dataclass(frozen=True, eq=False)
class Modes:
    """A belief about a command as a mixture of Gaussians.

    Args:
        weights: Shape (n,), positive, Σ = 1.
        means: Shape (n, m).
        covariances: Shape (n, m, m).
    """

    weights: Array
    means: Array
    covariances: Array

    def log_peaks(self) -> Array:
        """log density of each component at its own mean, shape (n,)."""
        determinants = np.linalg.slogdet(2 * np.pi * self.covariances)[1]
        return np.asarray(np.log(self.weights) - 0.5 * determinants)

    @property
    def favourite(self) -> int:
        """The component with the highest peak: what this side would do by itself."""
        return int(np.argmax(self.log_peaks()))


@dataclass(frozen=True, eq=False)
class Arbitration:
    """The joint density of autonomy's and the operator's command, p(f) p(η) ψ(η, f), each pair of
    modes a hypothesis, solved by the library's own factors and solver.

    Args:
        autonomy: p(f).
        operator: p(η).
        h: Variance of the coupling.
    """

    autonomy: Modes
    operator: Modes
    h: float

    def pair(self, i: int, j: int) -> Model:
        """The density given component i of autonomy and j of the operator."""
        m = self.autonomy.means.shape[1]
        variables = (
            Variable("level 0", m, lambda k: keys.level(0, k)),
            Variable("robot", m, keys.robot),
        )
        terms = (
            (gaussian(self.operator.means[j], self.operator.covariances[j]), ("level 0",)),
            (gaussian(self.autonomy.means[i], self.autonomy.covariances[i]), ("robot",)),
            (coupling(self.h, (m, m), space=m), ("level 0", "robot")),
        )
        own = tuple(
            Term("blend", residual, tuple((name, 0) for name in on), range(1))
            for residual, on in terms
        )
        return Model(np.zeros(1), variables, (), own, {}, np.zeros((1, 2 * m)))

    @property
    def pairs(self) -> Sequence[tuple[int, int]]:
        """All (i, j)."""
        n, m = len(self.autonomy.weights), len(self.operator.weights)
        return [(i, j) for i in range(n) for j in range(m)]

    def solve(self, solver: Solver = SecondOrder()) -> tuple[Array, float]:  # noqa: B008 - frozen
        """The joint choice: the command f, shape (m,), and its log probability, the largest over
        pairs and η."""
        first = self.pair(*self.pairs[0])
        models = [self.pair(*pair) for pair in self.pairs]
        shared = [
            Model(m.times, m.variables, first.shared, m.own, m.fixed, m.reference) for m in models
        ]
        assembly = Assembly(shared)
        which = np.arange(len(models))
        solutions = solver.solve(assembly, assembly.reference, which)
        scores = np.array(
            [
                self._log_weight(pair) + model.log_normalizer_own - solution.energy
                for pair, model, solution in zip(self.pairs, models, solutions, strict=True)
            ]
        )
        best = int(np.argmax(scores))
        m = self.autonomy.means.shape[1]
        return solutions[best].state[0, m:], float(scores[best])

    def log_probability(self, f: Array) -> float:
        """The largest log probability of any pair and any η at a command f.

        Given f, the density in η is Gaussian: its maximum is in closed form.
        """
        m, best = len(f), -np.inf
        for pair in self.pairs:
            model = self.pair(*pair)
            S, mean = self.operator.covariances[pair[1]], self.operator.means[pair[1]]
            eta = mean + S @ np.linalg.solve(S + self.h * np.eye(m), f - mean)
            state = np.concatenate([eta, f])[None]
            energy = float(Assembly([model]).energy(state[None], np.zeros(1, dtype=np.intp))[0])
            best = max(best, self._log_weight(pair) + model.log_normalizer_own - energy)
        return best

    def linear_blend(self) -> Array:
        """What linear blending makes of the same beliefs: each side's favourite, mixed."""
        i, j = self.autonomy.favourite, self.operator.favourite
        gain = blend_gain(self.autonomy.covariances[i], self.operator.covariances[j], self.h)
        return blend(self.operator.means[j], self.autonomy.means[i], gain)

    def _log_weight(self, pair: tuple[int, int]) -> float:
        return float(np.log(self.autonomy.weights[pair[0]] * self.operator.weights[pair[1]]))
