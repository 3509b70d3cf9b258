"""Levenberg–Marquardt on one hypothesis or many: a second-order loop, and GTSAM's own.

Both take an assembly and states to start from, and say why they stopped. Each result is a local
optimum at best.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from time import perf_counter
from typing import Protocol

import gtsam
import numpy as np
from numpy.typing import NDArray

from fgplan.assembly import Assembly, Quadratic
from fgplan.block_tridiagonal import Factor, System, factorize

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class Stop(Enum):
    """Why a solve ended."""

    CONVERGED = "converged"
    NO_DESCENT = "no step lowers the energy"
    ITERATIONS = "iteration limit"
    NOT_FINITE = "the energy is not finite at the start"
    SADDLE = "stationary, but not a minimum"
    MERGED = "met another start on its way"
    DEADLINE = "no time left"


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

    def solve(
        self, assembly: Assembly, initial: Array, which: Index, until: float = np.inf
    ) -> tuple[Solution, ...]:
        """Optimise each start.

        Args:
            assembly: The density.
            initial: Shape (B, T + 1, D).
            which: Hypothesis of each start, shape (B,).
            until: When to return what there is, on the clock of `time.perf_counter` [s].
        """
        ...


@dataclass(frozen=True)
class SecondOrder:
    """Levenberg–Marquardt with the true Hessian on a block-tridiagonal factorisation.

    A Gauss–Newton step, then Newton. Where the Hessian is not positive definite it is damped
    by the Gauss–Newton one, H + λ H_GN, λ growing from 0 to infinity (Gauss–Newton itself). All
    starts are evaluated together.

    Args:
        warmup: Gauss–Newton steps before the true Hessian.
        max_iterations: Linear systems a start may solve.
        tolerance: Stop when a Newton step promises less than this [nats].
        meeting: Two starts of a hypothesis this close in every coordinate [m, m/s] and in energy
            [nats] go to one optimum: the worse one is not followed further. 0 follows all.
    """

    warmup: int = 1
    max_iterations: int = 100
    tolerance: float = 1e-9
    meeting: float = 0.05

    def solve(
        self, assembly: Assembly, initial: Array, which: Index, until: float = np.inf
    ) -> tuple[Solution, ...]:
        X = np.array(initial, dtype=float)
        which = np.asarray(which)
        B = len(X)
        stop = [Stop.ITERATIONS] * B
        iterations = np.zeros(B, dtype=int)
        decrement = np.full(B, np.inf)
        energy = assembly.energy(X, which)
        active = np.flatnonzero(np.isfinite(energy))
        for b in np.flatnonzero(~np.isfinite(energy)).tolist():
            stop[b] = Stop.NOT_FINITE
        began = perf_counter()
        for iteration in range(self.max_iterations):
            if not len(active):
                break
            # The next iteration is expected to last as long as the last one.
            now = perf_counter()
            if now + (now - began) > until:
                for b in active.tolist():
                    stop[b] = Stop.DEADLINE
                break
            began = now
            newton = iteration >= self.warmup
            way = _directions(assembly, X[active], which[active], newton)
            length, reached = _line_search(assembly, X[active], way, which[active])
            iterations[active] += 1
            decrement[active] = way.promised
            moved = length > 0
            X[active] = assembly.moved(X[active], length[:, None, None] * way.step)
            energy[active] = reached
            still: list[int] = []
            for b, went, gain, curved in zip(
                active.tolist(), moved, way.promised, way.minimum, strict=True
            ):
                if newton and gain < self.tolerance:
                    stop[b] = Stop.CONVERGED if curved else Stop.SADDLE
                elif newton and not went:
                    stop[b] = Stop.CONVERGED if curved and gain < 1e-6 else Stop.NO_DESCENT
                else:
                    still.append(b)
            if newton:
                for b in self._met(X, energy, which, still, stop):
                    stop[b] = Stop.MERGED
                    still.remove(b)
            active = np.array(still, dtype=np.intp)
        energy = assembly.energy(X, which)
        return tuple(
            Solution(X[b], float(energy[b]), int(iterations[b]), stop[b], float(decrement[b]))
            for b in range(B)
        )

    def _met(
        self, X: Array, energy: Array, which: Index, active: list[int], stop: list[Stop]
    ) -> list[int]:
        """Active starts that are where a better start of their hypothesis is, or has ended: time
        is for new optima."""
        others = active + [b for b, s in enumerate(stop) if s is Stop.CONVERGED]
        found: list[int] = []
        for b in active:
            for a in others:
                if a == b or which[a] != which[b] or abs(energy[a] - energy[b]) >= self.meeting:
                    continue
                ahead = stop[a] is Stop.CONVERGED or (energy[a], a) < (energy[b], b)
                if ahead and a not in found and np.abs(X[a] - X[b]).max() < self.meeting:
                    found.append(b)
                    break
        return found


@dataclass(frozen=True)
class GtsamLM:
    """GTSAM's `LevenbergMarquardtOptimizer` on the public graph: the reference.

    Args:
        max_iterations: Of the outer loop.
        tolerance: Absolute and relative decrease of the error at which GTSAM stops.
    """

    max_iterations: int = 200
    tolerance: float = 1e-12

    def solve(
        self, assembly: Assembly, initial: Array, which: Index, until: float = np.inf
    ) -> tuple[Solution, ...]:
        return tuple(
            self._solve_one(assembly, state, int(i))
            if perf_counter() < until
            else _unsolved(assembly, state, int(i))
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
        way = _directions(assembly, end[None], np.array([i]), newton=True)
        promised, minimum = float(way.promised[0]), bool(way.minimum[0])
        if optimizer.iterations() >= self.max_iterations:
            stop = Stop.ITERATIONS
        elif not minimum:
            stop = Stop.SADDLE
        else:
            stop = Stop.CONVERGED if promised < 1e-6 else Stop.NO_DESCENT
        energy = float(graph.error(result))
        return Solution(end, energy, optimizer.iterations(), stop, promised)


def _unsolved(assembly: Assembly, state: Array, which: int) -> Solution:
    energy = float(assembly.energy(state, np.asarray(which)))
    return Solution(state, energy, 0, Stop.DEADLINE, np.inf)


def factor_hessian(assembly: Assembly, state: Array, which: int) -> Factor | None:
    """Cholesky factor of the true Hessian at one state; None where it is not positive definite."""
    q = assembly.expand(state[None], np.array([which]))
    _, system = next(q.systems(np.zeros(1, dtype=np.intp)))
    return factorize(*system)


@dataclass(frozen=True, eq=False)
class _Directions:
    """Where to go from B states: steps (B, S, D), what they promise (B,) [nats], whether the true
    Hessian is positive definite (B,), and the expansion they come from."""

    step: Array
    promised: Array
    minimum: NDArray[np.bool_]
    expansion: Quadratic


def _directions(assembly: Assembly, X: Array, which: Index, newton: bool) -> _Directions:
    q = assembly.expand(X, which) if newton else assembly.gauss_newton(X, which)
    step, promised = np.zeros_like(X), np.full(len(X), np.inf)
    indefinite = []

    def follow(b: int, factor: Factor) -> None:
        step[b] = factor.solve(-q.gradient[b])
        promised[b] = -0.5 * float(np.vdot(q.gradient[b], step[b]))

    for b, system in q.systems(np.arange(len(X))):
        factor = factorize(*system)
        if factor is None:
            indefinite.append(b)
        else:
            follow(b, factor)
    if indefinite:
        rows = np.array(indefinite)
        damping = assembly.gauss_newton(X[rows], which[rows])
        for (b, true), (_, flat) in zip(
            q.systems(rows), damping.systems(np.arange(len(rows))), strict=True
        ):
            factor = _damped(true, flat)
            if factor is not None:
                follow(b, factor)
    minimum = np.ones(len(X), dtype=bool)
    minimum[indefinite] = False
    return _Directions(step, promised, minimum, q)


def _damped(true: System, flat: System) -> Factor | None:
    """Factor of (H + λ H_GN)/(1 + λ) for the first λ of 1 and infinity that allows it."""
    with np.errstate(invalid="ignore"):  # a user's factor may hold inf; no factor then
        return factorize(*true.mixed(flat, 0.5)) or factorize(*flat)


FULL_STEP = 0.5
"""A full step is taken when it brings this share of what it promised."""
LENGTHS = (0.25, 0.5, 1.0, 2.0, 4.0)
SHORT_LENGTHS = (2.0**-12, 2.0**-8, 2.0**-6, 2.0**-4)


def _line_search(
    assembly: Assembly, X: Array, way: _Directions, which: Index
) -> tuple[Array, Array]:
    """Length of the step for each start (B,), 0 where none lowers the energy, and that energy.

    The full step when it is good; else the best of a few lengths; else of a few short ones.
    """
    energy = way.expansion.energy
    energies = assembly.along(way.expansion, X, way.step, which)
    length, reached = np.ones(len(X)), _finite(energies(np.ones((1, len(X)))))[0]
    wanted = energy - FULL_STEP * np.maximum(way.promised, 0.0)
    for lengths in (LENGTHS, SHORT_LENGTHS):
        if np.all(reached <= wanted):
            break
        s = np.broadcast_to(np.array(lengths)[:, None], (len(lengths), len(X)))
        tried = _finite(energies(s))
        best = tried.argmin(axis=0)
        lowest = np.take_along_axis(tried, best[None], axis=0)[0]
        better = (reached > wanted) & (lowest < reached)
        length = np.where(better, np.array(lengths)[best], length)
        reached = np.where(better, lowest, reached)
        # A longer search is only for those that still go up.
        wanted = np.where(reached < energy, np.inf, -np.inf)
    descends = reached < energy
    return np.where(descends, length, 0.0), np.where(descends, reached, energy)


def _finite(energy: Array) -> Array:
    return np.where(np.isfinite(energy), energy, np.inf)
