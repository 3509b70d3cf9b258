"""Starts that are bent around people who go on as predicted: cheap, and most of the way.

Among people that are variables a step costs ten times what it costs among people held at their
prediction, and most starts of a hypothesis end in a few optima. So all starts are solved there
first; only the distinct ends are worth a solve among people who react.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgplan.assembly import Assembly
from fgplan.hypothesis import Hypothesis
from fgplan.solver import SecondOrder, Solution, Stop

Array = NDArray[np.float64]

MARGIN = 6.0
"""A sketch this much above the best of its hypothesis is not followed [nats]: people who react
take back a few, not all."""
ROUGH = 1e-3
"""A sketch is at its end where a step promises less [nats]."""
ROUNDS = 20
"""A sketch is at its end after so many steps."""
ALIKE = 0.15
"""Sketches that are nowhere further apart are one [m, m/s]: not all are quite at their end."""
MOST = 4
"""Sketches of a hypothesis that are followed."""


@dataclass(frozen=True, eq=False)
class Sketch:
    """Where one start leads among people held at their prediction: the label of the start, and a
    state (T + 1, D) of the whole density with everybody else as expected."""

    label: str
    state: Array


def sketched(
    assembly: Assembly, held: Assembly, hypotheses: Sequence[Hypothesis], until: float = np.inf
) -> list[list[Sketch]]:
    """The distinct ends of each hypothesis's starts, the lowest first.

    Args:
        assembly: The density.
        held: The same with all people held at their prediction.
        hypotheses: With their starts.
        until: When to end, on the clock of `time.perf_counter` [s].
    """
    starts = [(i, start) for i, h in enumerate(hypotheses) for start in h.starts]
    which = np.array([i for i, _ in starts])
    initial = np.stack([held.models[i].initial(start) for i, start in starts])
    rough = SecondOrder(max_iterations=ROUNDS, tolerance=ROUGH, margin=MARGIN)
    solutions = rough.solve(held, initial, which, until)
    ends: list[list[Sketch]] = []
    for i in range(len(hypotheses)):
        own = [
            (solution, start.label)
            for (j, start), solution in zip(starts, solutions, strict=True)
            if j == i and _leads_on(solution)
        ]
        own.sort(key=lambda end: round(end[0].energy, 6))
        kept: list[tuple[Solution, str]] = []
        for end in own:
            near = end[0].energy < own[0][0].energy + MARGIN
            if near and all(np.abs(end[0].state - k.state).max() > ALIKE for k, _ in kept):
                kept.append(end)
        ends.append([Sketch(label, _among(assembly, held, i, s.state)) for s, label in kept[:MOST]])
    return ends


def _leads_on(solution: Solution) -> bool:
    ended = solution.stop not in (Stop.MERGED, Stop.GIVEN_UP, Stop.NOT_FINITE)
    return ended and bool(np.isfinite(solution.energy))


def _among(assembly: Assembly, held: Assembly, i: int, state: Array) -> Array:
    """A state of the density, from one without the people."""
    whole = assembly.models[i].reference.copy()
    for name, columns in held.models[i].columns.items():
        whole[:, assembly.models[i].columns[name]] = state[:, columns]
    return whole
