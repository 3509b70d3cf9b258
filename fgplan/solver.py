"""Levenberg–Marquardt on one hypothesis or many: a second-order loop, and GTSAM's own.

Both take an assembly and states to start from, and say why they stopped. Each result is a local
optimum at best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import gtsam
import numpy as np
from numpy.typing import NDArray

from fgplan.assembly import Assembly
from fgplan.block_tridiagonal import Factor, factorize

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class Stop(Enum):
    """Why a solve ended."""

    CONVERGED = "converged"
    NO_DESCENT = "no step lowers the energy"
    ITERATIONS = "iteration limit"
    NOT_FINITE = "the energy is not finite at the start"
    SADDLE = "stationary, but not a minimum"


@dataclass(frozen=True, eq=False)
class Solution:
    """Where one solve ended: a local optimum when converged.

    Args:
        state: Shape (T + 1, D), see `Model.columns`.
        energy: −log of the unnormalised density, the error of the model's graph.
        iterations: Linear systems solved.
        stop: Why it ended.
        decrement: Decrease that the next Newton step promises [nats].
    """

    state: Array
    energy: float
    iterations: int
    stop: Stop
    decrement: float

    @property
    def converged(self) -> bool:
        """Whether this is a local optimum."""
        return self.stop is Stop.CONVERGED


class Solver(Protocol):
    """Anything that takes starts to local optima."""

    def solve(self, assembly: Assembly, initial: Array, which: Index) -> tuple[Solution, ...]:
        """Optimise each start.

        Args:
            assembly: The density.
            initial: Shape (B, T + 1, D).
            which: Hypothesis of each start, shape (B,).
        """
        ...


@dataclass(frozen=True)
class SecondOrder:
    """Levenberg–Marquardt with the true Hessian on a block-tridiagonal factorisation.

    A few Gauss–Newton steps, then Newton. Where the Hessian is not positive definite it is damped
    by the Gauss–Newton one, H + λ H_GN, λ growing from 0 to infinity (Gauss–Newton itself). All
    starts are evaluated together.

    Args:
        warmup: Gauss–Newton steps before the true Hessian.
        max_iterations: Linear systems a start may solve.
        tolerance: Stop when a Newton step promises less than this [nats].
    """

    warmup: int = 3
    max_iterations: int = 100
    tolerance: float = 1e-9

    def solve(self, assembly: Assembly, initial: Array, which: Index) -> tuple[Solution, ...]:
        X = np.array(initial, dtype=float)
        which = np.asarray(which)
        B = len(X)
        stop = [Stop.ITERATIONS] * B
        iterations = np.zeros(B, dtype=int)
        decrement = np.full(B, np.inf)
        energy = assembly.energy(X, which)
        active = np.flatnonzero(np.isfinite(energy))
        for b in np.flatnonzero(~np.isfinite(energy)):
            stop[b] = Stop.NOT_FINITE
        for iteration in range(self.max_iterations):
            if not len(active):
                break
            newton = iteration >= self.warmup
            step, promised, minimum = _directions(assembly, X[active], which[active], newton)
            iterations[active] += 1
            decrement[active] = promised
            length, reached = _line_search(assembly, X[active], step, which[active], energy[active])
            X[active] += length[:, None, None] * step
            energy[active] = reached
            still = []
            for b, moved, gain, curved in zip(active, length > 0, promised, minimum, strict=True):
                if newton and gain < self.tolerance:
                    stop[b] = Stop.CONVERGED if curved else Stop.SADDLE
                elif newton and not moved:
                    stop[b] = Stop.CONVERGED if curved and gain < 1e-6 else Stop.NO_DESCENT
                else:
                    still.append(b)
            active = np.array(still, dtype=np.intp)
        return tuple(
            Solution(X[b], float(energy[b]), int(iterations[b]), stop[b], float(decrement[b]))
            for b in range(B)
        )


@dataclass(frozen=True)
class GtsamLM:
    """GTSAM's `LevenbergMarquardtOptimizer` on the public graph: the reference.

    Args:
        max_iterations: Of the outer loop.
        tolerance: Absolute and relative decrease of the error at which GTSAM stops.
    """

    max_iterations: int = 200
    tolerance: float = 1e-12

    def solve(self, assembly: Assembly, initial: Array, which: Index) -> tuple[Solution, ...]:
        return tuple(
            self._solve_one(assembly, state, int(i))
            for state, i in zip(initial, which, strict=True)
        )

    def _solve_one(self, assembly: Assembly, state: Array, i: int) -> Solution:
        model = assembly.models[i]
        graph, values = model.graph(), model.values(state)
        if not np.isfinite(graph.error(values)):
            return Solution(state, float(graph.error(values)), 0, Stop.NOT_FINITE, np.inf)
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setMaxIterations(self.max_iterations)
        parameters.setRelativeErrorTol(self.tolerance)
        parameters.setAbsoluteErrorTol(self.tolerance)
        optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)
        result = optimizer.optimize()
        end = model.state(result)
        # LM returns the initial guess, without raising, when the error is NaN.
        if not np.all(np.isfinite(end)):
            return Solution(state, np.inf, optimizer.iterations(), Stop.NOT_FINITE, np.inf)
        promised, minimum = _promise(assembly, end, i)
        if optimizer.iterations() >= self.max_iterations:
            stop = Stop.ITERATIONS
        elif not minimum:
            stop = Stop.SADDLE
        else:
            stop = Stop.CONVERGED if promised < 1e-6 else Stop.NO_DESCENT
        energy = float(graph.error(result))
        return Solution(end, energy, optimizer.iterations(), stop, promised)


def factor_hessian(assembly: Assembly, state: Array, which: int) -> Factor | None:
    """Cholesky factor of the true Hessian at one state; None where it is not positive definite."""
    q = assembly.expand(state[None], np.array([which]))
    return factorize(q.diagonal[0], q.upper[0])


def _promise(assembly: Assembly, state: Array, which: int) -> tuple[float, bool]:
    """What a Newton step from a state promises [nats], and whether the Hessian is positive."""
    step, promised, minimum = _directions(assembly, state[None], np.array([which]), newton=True)
    del step
    return float(promised[0]), bool(minimum[0])


def _directions(
    assembly: Assembly, X: Array, which: Index, newton: bool
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Descent directions (B, S, D), what they promise (B,) [nats], and where the true Hessian is
    positive definite (B,)."""
    q = assembly.expand(X, which) if newton else assembly.gauss_newton(X, which)
    step, promised = np.zeros_like(X), np.full(len(X), np.inf)
    minimum = np.zeros(len(X), dtype=bool)
    indefinite = []
    for b in range(len(X)):
        factor = factorize(q.diagonal[b], q.upper[b])
        if factor is None:
            indefinite.append(b)
            continue
        minimum[b] = True
        step[b] = factor.solve(-q.gradient[b])
        promised[b] = -0.5 * float(np.vdot(q.gradient[b], step[b]))
    if indefinite:
        damping = assembly.gauss_newton(X[indefinite], which[indefinite])
        for row, b in enumerate(indefinite):
            damp = (damping.diagonal[row], damping.upper[row])
            factor = _damped((q.diagonal[b], q.upper[b]), damp)
            if factor is not None:
                step[b] = factor.solve(-q.gradient[b])
                promised[b] = -0.5 * float(np.vdot(q.gradient[b], step[b]))
    return step, promised, minimum


def _damped(true: tuple[Array, Array], damping: tuple[Array, Array]) -> Factor | None:
    """Factor of (H + λ H_GN)/(1 + λ) for the first λ of 1/4, 1, 4, infinity that allows it."""
    for share in (0.2, 0.5, 0.8, 1.0):
        diagonal, upper = ((1 - share) * a + share * b for a, b in zip(true, damping, strict=True))
        factor = factorize(diagonal, upper)
        if factor is not None:
            return factor
    return None


LENGTHS = (0.25, 0.5, 1.0, 2.0, 4.0)
SHORT_LENGTHS = (2.0**-12, 2.0**-8, 2.0**-6, 2.0**-4)


def _line_search(
    assembly: Assembly, X: Array, step: Array, which: Index, energy: Array
) -> tuple[Array, Array]:
    """Best of a few step lengths for each start (B,), 0 where none lowers the energy (B,)."""
    length, reached = np.zeros(len(X)), energy.copy()
    search = np.arange(len(X))
    for lengths in (LENGTHS, SHORT_LENGTHS):
        s = np.array(lengths)
        trial = X[search] + s[:, None, None, None] * step[search]
        tried = assembly.energy(trial, which[search])
        tried = np.where(np.isfinite(tried), tried, np.inf)
        best = np.argmin(tried, axis=0)
        lowest = tried[best, np.arange(len(search))]
        better = lowest < energy[search]
        length[search[better]] = s[best[better]]
        reached[search[better]] = lowest[better]
        search = search[~better]
        if not len(search):
            break
    return length, reached


def stack(starts: Sequence[Array]) -> Array:
    """Starts of one size as one array (B, S, D)."""
    return np.stack(list(starts))
