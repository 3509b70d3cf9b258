"""Those who solve the same problems, behind one interface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from benchmarks.solver import ipopt, whitened
from benchmarks.solver.problem import Problem
from fgplan.backend import Backend, Numpy, fastest
from fgplan.block_tridiagonal import Chains
from fgplan.solver import GtsamLM, SecondOrder, Solver

Array = NDArray[np.float64]

AGREEMENT = 1e-8
"""Relative difference of two ways to compute one energy that is put down to rounding."""


class Peer(Protocol):
    """A way to solve all starts of a problem.

    `prepare` does what a program that runs for long would do once; `solve` does the rest, from
    the scenario on, and is what is timed.
    """

    name: str
    most_people: int

    def prepare(self, problem: Problem) -> Any:
        """Whatever `solve` is to be given."""
        ...

    def solve(self, problem: Problem, prepared: Any) -> tuple[Array, int]:
        """Where the starts lead, shape (B, T + 1, D), and iterations, summed over the starts."""
        ...


@dataclass(frozen=True)
class Native:
    """One of fgplan's own solvers.

    Args:
        name: In the table.
        solver: It.
        most_people: It would take too long with more.
        backend: What computes; by default the fastest there is.
    """

    name: str = "fgplan"
    solver: Solver = field(default_factory=SecondOrder)
    most_people: int = 1000
    backend: Backend | None = None

    def prepare(self, problem: Problem) -> None:
        """Nothing: the density is assembled anew for every plan."""

    def solve(self, problem: Problem, prepared: None) -> tuple[Array, int]:
        assembly = problem.assemble(self.backend)
        solutions = self.solver.solve(assembly, problem.initial, problem.which)
        return _stacked([(s.state, s.iterations) for s in solutions])


@dataclass(frozen=True)
class Ipopt:
    """CasADi and IPOPT with exact derivatives; building the problem is not timed.

    Args:
        gated: With the pairs alone that fgplan keeps for the scene.
        most_people: It would take too long with more.
    """

    gated: bool = False
    most_people: int = 20

    @property
    def name(self) -> str:
        """In the table."""
        return "CasADi + IPOPT, gated" if self.gated else "CasADi + IPOPT"

    def prepare(self, problem: Problem) -> ipopt.Program:
        """Build, and see that it is the same density."""
        program = ipopt.Program.build(problem, self.gated)
        rng = np.random.default_rng(0)
        for state, which in zip(problem.initial, problem.which.tolist(), strict=True):
            noisy = state + 0.2 * rng.standard_normal(state.shape)
            noisy[0, :4] = state[0, :4]
            error = program.disagreement(noisy, which)
            if error > AGREEMENT:
                raise AssertionError(f"the expression is another density: energy off by {error}")
        return program

    def solve(self, problem: Problem, prepared: ipopt.Program) -> tuple[Array, int]:
        starts = zip(problem.initial, problem.which.tolist(), strict=True)
        return _stacked([prepared.solve(state, which) for state, which in starts])


@dataclass(frozen=True)
class Whitened:
    """L-BFGS in prior-whitened coordinates, on fgplan's expansion: it pays for curvature, too."""

    name: str = "whitened L-BFGS"
    most_people: int = 50

    def prepare(self, problem: Problem) -> None:
        """Nothing."""

    def solve(self, problem: Problem, prepared: None) -> tuple[Array, int]:
        assembly = problem.assemble()
        starts = zip(problem.initial, problem.which.tolist(), strict=True)
        return _stacked([whitened.minimise(assembly, state, which) for state, which in starts])


NUMPY = Native("fgplan, numpy", most_people=20, backend=Numpy())
GTSAM = Native("GTSAM LM", GtsamLM(), most_people=20)
PEERS: tuple[Peer, ...] = (Native(), NUMPY, GTSAM, Ipopt(), Ipopt(gated=True), Whitened())


FLOORS: dict[str, Backend] = {"floor": fastest(), "floor, LAPACK": Numpy()}
"""What factorises: the kernels that the solver uses, and a library's."""


def floor(
    problem: Problem,
    state: Array,
    which: int,
    backend: Backend,
    clock: Callable[[], float] = perf_counter,
    repeat: int = 5,
) -> float:
    """One banded factorisation and solve at an optimum (T + 1, D) [s]: least of a few."""
    assembly = problem.assembly
    q = assembly.expand(state[None], np.array([which]))
    hessian = q.hessian(np.zeros(1, dtype=np.intp))
    steps = backend.systems(Chains.of(*hessian, assembly.order, assembly.linked))
    seconds = []
    for _ in range(repeat):
        began = clock()
        _, definite = steps(np.zeros(1, dtype=np.intp), (), q.gradient)
        seconds.append(clock() - began)
        assert definite.all()
    return min(seconds)


def _stacked(ends: Sequence[tuple[Array, int]]) -> tuple[Array, int]:
    return np.stack([state for state, _ in ends]), sum(count for _, count in ends)
