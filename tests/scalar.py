"""Small densities for closed forms: one dimension, one time step, the library's factors and
solvers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from factors.residual import Residual
from fgplan import keys
from fgplan.assembly import Assembly
from fgplan.model import Model, Term, Variable
from fgplan.solver import SecondOrder, Solution, Solver

Array = NDArray[np.float64]
Placed = tuple[Residual, tuple[str, ...]]

ROBOT = Variable("robot", 1, keys.robot)


def plan_variable(index: int, dim: int = 1) -> Variable:
    """η_index as a variable."""
    return Variable(f"level {index}", dim, partial(keys.level, index))


def model(
    variables: Sequence[Variable],
    shared: Sequence[Placed],
    own: Sequence[Placed] = (),
) -> Model:
    """One step; `shared` and `own` are residuals with the names of their variables."""

    def terms(placed: Sequence[Placed]) -> tuple[Term, ...]:
        return tuple(
            Term("term", residual, tuple((name, 0) for name in names), range(1))
            for residual, names in placed
        )

    reference = np.zeros((1, sum(v.dim for v in variables)))
    return Model(np.zeros(1), tuple(variables), terms(shared), terms(own), {}, reference)


def together(models: Sequence[Model]) -> Assembly:
    """Hypotheses that differ only in their own terms."""
    first = models[0]
    return Assembly(
        [Model(m.times, m.variables, first.shared, m.own, m.fixed, m.reference) for m in models]
    )


def optimum(
    m: Model,
    start: Sequence[float] = (),
    solver: Solver = SecondOrder(),  # noqa: B008
) -> Solution:
    """The local optimum of one model from a start, zeros by default."""
    state = np.array(start, dtype=float)[None] if len(start) else m.reference
    return solver.solve(Assembly([m]), state[None], np.zeros(1, dtype=int))[0]
