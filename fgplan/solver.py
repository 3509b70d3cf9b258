"""Optimisers of one hypothesis or many: a second-order loop, and GTSAM's Levenberg–Marquardt.

Both take an assembly and states to start from, and say why they stopped. Each result is a local
optimum at best.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import partial
from time import perf_counter
from typing import Protocol

import gtsam
import numpy as np
from numpy.typing import NDArray

from fgplan.assembly import Assembly, Quadratic
from fgplan.sparse import Layout, Sparse

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
    GIVEN_UP = "too far above another start to win"
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
    """Newton steps with the true Hessian on a block-tridiagonal factorisation.

    Where the Hessian is not positive definite the step is Gauss–Newton's; mixing the two was
    measured to be no better. All starts are evaluated and factorised together.

    Args:
        max_iterations: Linear systems a start may solve.
        tolerance: Stop when a Newton step promises less than this [nats]; that step is still
            taken, after which the next one would promise about its square.
        meeting: Two starts of a hypothesis this close in every coordinate [m, m/s] and in energy
            [nats] go to one optimum: the worse one is not followed further. 0 follows all.
        patience: A start that this many times what its Newton step promises would still leave
            `margin` above another one of its hypothesis is given up. inf follows all.
        margin: How far above the best an optimum still matters [nats]: for the evidence, as a
            share exp(−margin) of it; for the best plan alone, not at all.
    """

    max_iterations: int = 100
    tolerance: float = 1e-7
    meeting: float = 0.05
    patience: float = 2.0
    margin: float = 3.0

    def solve(
        self, assembly: Assembly, initial: Array, which: Index, until: float = np.inf
    ) -> tuple[Solution, ...]:
        X = np.array(initial, dtype=float)
        which = np.asarray(which)
        B = len(X)
        if not B:
            return ()
        stop = [Stop.ITERATIONS] * B
        iterations = np.zeros(B, dtype=int)
        decrement = np.full(B, np.inf)
        expand = _expansions(assembly)
        q = expand(X, which)
        energy = q.energy.copy()
        last, stuck = np.zeros_like(X), np.zeros(B, dtype=bool)
        active = np.flatnonzero(np.isfinite(energy))
        if len(active) < B:
            for b in np.flatnonzero(~np.isfinite(energy)).tolist():
                stop[b] = Stop.NOT_FINITE
            q = q.take(active)
        rivals = len(set(which.tolist())) < B  # else there is nobody to compare with
        began, busy = perf_counter(), 0
        for _ in range(self.max_iterations):
            if not len(active):
                break
            # An iteration is expected to last as long as the last one, in an earlier solve, too.
            now = perf_counter()
            if busy:
                assembly.pace = (now - began) / busy
            busy = len(active)
            if now + busy * assembly.pace > until:
                for b in active.tolist():
                    stop[b] = Stop.DEADLINE
                break
            began = now
            way = _directions(q, stuck[active])
            iterations[active] += 1
            decrement[active], energy[active] = way.promised, q.energy
            done = way.promised < self.tolerance
            if done.any():
                curved = way.minimum[done] & q.confirmed(np.flatnonzero(done))
                for b, minimum in zip(active[done].tolist(), curved.tolist(), strict=True):
                    stop[b] = Stop.CONVERGED if minimum else Stop.SADDLE
                last[active[done]] = way.step[done]
            ended = done
            if rivals:
                hopeless = ~done & self._hopeless(way, energy, which, active)
                for b in active[hopeless].tolist():
                    stop[b] = Stop.GIVEN_UP
                ended = done | hopeless
            going = np.flatnonzero(~ended)
            if not len(going):
                break
            length, ahead = _line_search(assembly, expand, way, going)
            rows, moved = active[going], length > 0
            on = rows[moved]
            X[rows], energy[rows], stuck[rows] = ahead.states, ahead.energy, False
            if not moved.all():
                still, at = rows[~moved], going[~moved]
                for b, i in zip(still.tolist(), at.tolist(), strict=True):
                    if way.promised[i] < 1e-6:  # nothing is lower, as far as rounding tells
                        minimum = way.minimum[i] and q.confirmed(np.array([i]))[0]
                        stop[b] = Stop.CONVERGED if minimum else Stop.SADDLE
                    elif not way.newton[i]:
                        stop[b] = Stop.NO_DESCENT
                # Where Newton's step leads nowhere Gauss-Newton's may.
                again = still[way.newton[at] & (way.promised[at] >= 1e-6)]
                stuck[again] = True
                on = np.sort(np.concatenate([on, again]))
            active = self._apart(X, energy, which, on, stop) if rivals else on
            q = ahead if len(active) == len(rows) else ahead.take(np.searchsorted(rows, active))
        end = assembly.moved(X, last)
        after = assembly.energy(end, which)
        worse = after > energy + ROUNDING * np.abs(energy)
        if worse.any():
            end[worse], after[worse] = X[worse], assembly.energy(X[worse], which[worse])
        X, energy = end, after
        return tuple(
            Solution(X[b], float(energy[b]), int(iterations[b]), stop[b], float(decrement[b]))
            for b in range(B)
        )

    def _hopeless(
        self, way: _Directions, energy: Array, which: Index, active: Index
    ) -> NDArray[np.bool_]:
        """Which active starts cannot be expected to matter beside others of their hypothesis."""
        lowest = np.full(which.max() + 1, np.inf)
        np.minimum.at(lowest, which, np.where(np.isfinite(energy), energy, np.inf))
        # Without a minimum ahead, what a step promises says little of what lies beyond it.
        gain = np.where(way.minimum, self.patience * np.maximum(way.promised, 1e-300), np.inf)
        return np.asarray(energy[active] - gain - self.margin > lowest[which[active]])

    def _apart(
        self, X: Array, energy: Array, which: Index, active: Index, stop: list[Stop]
    ) -> Index:
        """The active starts without those that are where a better one of their hypothesis is, or
        has ended: time is for new optima."""
        ended = [b for b, s in enumerate(stop) if s is Stop.CONVERGED]
        others = np.concatenate([active, np.array(ended, dtype=np.intp)])
        mine, theirs = energy[active][:, None], energy[others]
        near = (np.abs(mine - theirs) < self.meeting) & (which[active][:, None] == which[others])
        ahead = (theirs < mine) | ((theirs == mine) & (others < active[:, None]))
        ahead[:, len(active) :] = True
        for i, j in np.argwhere(near & ahead).tolist():
            a, b = int(others[j]), int(active[i])
            apart = stop[a] is Stop.MERGED or stop[b] is Stop.MERGED
            if not apart and np.abs(X[a] - X[b]).max() < self.meeting:
                stop[b] = Stop.MERGED
        return np.array([b for b in active.tolist() if stop[b] is not Stop.MERGED], dtype=np.intp)


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
        way = _directions(assembly.expand(end[None], np.array([i])))
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


Expand = Callable[[Array, Index], Quadratic]


def _expansions(assembly: Assembly) -> Expand:
    """How an assembly is expanded on the way to an optimum: pair by pair where it can be."""
    layout = Layout.of(assembly)
    return assembly.expand if layout is None else partial(Sparse, assembly, layout)


@dataclass(frozen=True, eq=False)
class _Directions:
    """Where to go from B states: steps (B, S, D), what they promise (B,) [nats], whether the true
    Hessian is positive definite (B,), whether the step is Newton's (B,), and the expansion they
    come from."""

    step: Array
    promised: Array
    minimum: NDArray[np.bool_]
    newton: NDArray[np.bool_]
    expansion: Quadratic


def _directions(q: Quadratic, stuck: NDArray[np.bool_] | None = None) -> _Directions:
    """Newton's steps; Gauss–Newton's where the true Hessian is not positive definite, and for
    those that are stuck."""
    step, minimum, newton = q.newton()
    if stuck is not None:
        newton = newton & ~stuck
    found = newton.copy()
    if not newton.all():
        rows = np.flatnonzero(~newton)
        step[rows], found[rows] = q.flattened(rows)
    promised = -0.5 * np.einsum("bsd,bsd->b", q.gradient, step)
    return _Directions(step, np.where(found, promised, np.inf), minimum, newton, q)


ROUNDING = 1e-12
"""Relative error of an energy."""
FULL_STEP = 0.5
"""A full step is taken when it brings this share of what it promised."""
LENGTHS = (0.25, 0.5), (2.0**-6, 2.0**-4), (2.0**-20, 2.0**-16, 2.0**-12, 2.0**-8)
"""The shortest cross a hinge that is off by a hair: once it is on, the next step knows it."""
LONG_LENGTHS = (4.0, 16.0, 64.0)
"""For Gauss–Newton steps on which the energy curves downwards: near a saddle they are short."""
CURVED = 1.5
"""It does where a full step brings this many times what it promised."""


def _line_search(
    assembly: Assembly, expand: Expand, way: _Directions, rows: Index
) -> tuple[Array, Quadratic]:
    """Length of the step for some rows (R,), 0 where none lowers the energy, and the expansions
    at its end.

    The full step when it is good, which is nearly always, so that is where the next expansion is
    made; else the best of two lengths, and of shorter ones while all of them lead up.
    """
    q = way.expansion
    X, which, step = q.states[rows], q.which[rows], way.step[rows]
    before, promised = q.energy[rows], np.maximum(way.promised[rows], 0.0)
    ahead = expand(assembly.moved(X, step), which)
    energies = assembly.along(q, ahead, way.step, rows)
    length, reached = np.ones(len(rows)), _finite(ahead.energy)

    def search(some: Index, lengths: tuple[float, ...]) -> None:
        s = np.array(lengths)
        tried = _finite(energies(np.tile(s[:, None], len(some)), some))
        best, lowest = s[tried.argmin(axis=0)], tried.min(axis=0)
        better = lowest < reached[some]
        length[some[better]], reached[some[better]] = best[better], lowest[better]

    poor = np.flatnonzero(reached > before - FULL_STEP * promised)
    for lengths in LENGTHS:
        if not len(poor):
            break
        search(poor, lengths)
        poor = poor[reached[poor] >= before[poor]]
    whole = (way.newton & way.minimum)[rows]
    if not whole.all():
        way_down = before - reached > CURVED * promised
        long = np.flatnonzero(way_down & ~whole & (length == 1.0))
        if len(long):
            search(long, LONG_LENGTHS)
    length[reached >= before] = 0.0
    other = np.flatnonzero(length != 1.0)
    if len(other):
        shorter = length[other, None, None] * step[other]
        ahead.put(other, expand(assembly.moved(X[other], shorter), which[other]))
    return length, ahead


def _finite(energy: Array) -> Array:
    return np.where(np.isfinite(energy), energy, np.inf)
