"""The best plan known: many random starts, two optimisers, and the planner's own rules."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.scenes import smooth
from benchmarks.solver import whitened
from fgplan.assembly import Assembly
from fgplan.components import distinct
from fgplan.mixture import Mixture
from fgplan.planner import plan
from fgplan.scenario import Scenario
from fgplan.solver import SecondOrder, Solution, Stop

Array = NDArray[np.float64]
Index = NDArray[np.intp]

STARTS = 64
"""Random starts of each hypothesis."""
CROWD = 0.3
"""How far a start moves people, at first [m]."""
BATCH = 32
"""Starts solved together."""


class Score(NamedTuple):
    """log w_i − energy of the best safe plan (−inf where none is) and of the best of all [nats]."""

    safe: float
    any: float


def score(mixture: Mixture) -> Score:
    """What a plan reached."""
    reached = [c.log_prior - c.energy for c in mixture.components]
    safe = -np.inf if mixture.selected is None else reached[mixture.selected]
    return Score(float(safe), float(max(reached)))


def gap(own: Score, best: Score) -> float:
    """How far below the best known a plan is [nats]; inf if it stops although there is a way."""
    if np.isfinite(best.safe):
        return max(0.0, best.safe - own.safe)
    return max(0.0, best.any - own.any)


def best_known(scenario: Scenario, seed: int, starts: int = STARTS) -> tuple[Score, str]:
    """The score of the best plan, and which optimiser and start led to the lowest energy.

    Only the solver differs from a plan: which people are planned, the hard check, merging and
    selection are the same.
    """
    solver = MultiStart(seed, starts)
    mixture = plan(scenario, solver=solver)
    return score(mixture), ", ".join(f"{name}: {n}" for name, n in solver.found_by.most_common())


@dataclass(frozen=True)
class MultiStart:
    """A solver that ignores how few starts it was given.

    Args:
        seed: Of the random starts.
        starts: Random starts of each hypothesis, around its first start.
        found_by: Counts, over hypotheses, what led to the lowest energy.
    """

    seed: int
    starts: int = STARTS
    found_by: Counter[str] = field(default_factory=Counter)

    def solve(
        self, assembly: Assembly, initial: Array, which: Index, until: float = np.inf
    ) -> tuple[Solution, ...]:
        """The best distinct optima of each hypothesis, as many as it has starts."""
        ends: list[Solution | None] = [None] * len(initial)
        for i in np.unique(which).tolist():
            rows = np.flatnonzero(which == i)
            optima = self._optima(assembly, initial[rows], i)
            for rank, row in enumerate(rows.tolist()):
                ends[row] = optima[min(rank, len(optima) - 1)]
        return tuple(end for end in ends if end is not None)

    def _optima(self, assembly: Assembly, given: Array, i: int) -> list[Solution]:
        """Distinct optima of one hypothesis, best first."""
        rng = np.random.default_rng([self.seed, i])
        tried = [*given, *(_perturbed(assembly, given[0], rng) for _ in range(self.starts))]
        found = []
        for name, method in (("second order", _second_order), ("L-BFGS", _lbfgs)):
            ends = method(assembly, np.stack(tried), i)
            for rank, end in enumerate(ends):
                origin = "given" if rank < len(given) else "random"
                found.append((f"{name} from {origin}", end))
        # A merged start was not followed to its end; the one that it met was.
        found = [pair for pair in found if pair[1].stop is not Stop.MERGED]
        found.sort(key=lambda pair: pair[1].energy)
        # What is found by several counts for all of them: who is needed at all?
        lowest = found[0][1].energy
        self.found_by.update({name for name, end in found if end.energy < lowest + 1e-3})
        return distinct([end for _, end in found])


def _perturbed(assembly: Assembly, state: Array, rng: np.random.Generator) -> Array:
    """A start in which the robot goes another way and the people do, a little."""
    model = assembly.models[0]
    other = state.copy()
    sizes = {"robot": rng.uniform(0.3, 2.5), "crowd": CROWD}
    for name, columns in model.columns.items():
        dim = (columns.stop - columns.start) // 2
        if name in sizes:
            other[:, columns] += smooth(rng, model.times, sizes[name], dim)
    return other


def _second_order(assembly: Assembly, starts: Array, i: int) -> list[Solution]:
    """From all starts, a few at a time."""
    ends: list[Solution] = []
    for at in range(0, len(starts), BATCH):
        chunk = starts[at : at + BATCH]
        ends += SecondOrder(patience=np.inf).solve(assembly, chunk, np.full(len(chunk), i))
    return ends


def _lbfgs(assembly: Assembly, starts: Array, i: int) -> list[Solution]:
    """From all starts, and then to the last digit."""
    ends = np.stack([whitened.minimise(assembly, start, i, most=200)[0] for start in starts])
    return _second_order(assembly, ends, i)
