"""How the starts of all hypotheses are spent: warm ones first, and only where they can matter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from fgplan.assembly import Assembly
from fgplan.block_tridiagonal import factorize
from fgplan.hypothesis import Hypothesis, Start
from fgplan.mixture import Mixture
from fgplan.scenario import Scenario
from fgplan.solver import Solution, Solver, Stop
from fgplan.trajectory import Trajectory

Array = NDArray[np.float64]

AT_ONCE = 8
"""Hypotheses solved together when many are bounded."""


@dataclass(frozen=True, eq=False)
class Found:
    """Where one start of one hypothesis ended."""

    which: int
    label: str
    solution: Solution


@dataclass(frozen=True, eq=False)
class Search:
    """What was solved.

    Args:
        found: One per start that was tried.
        dropped: Hypotheses whose bound cannot win: no other start of theirs was tried.
        unfinished: Hypotheses with a start that time did not allow to end or to begin.
    """

    found: tuple[Found, ...]
    dropped: frozenset[int]
    unfinished: frozenset[int]


def search(
    assembly: Assembly,
    hypotheses: Sequence[Hypothesis],
    solver: Solver,
    warm: Sequence[Start] = (),
    until: float = np.inf,
) -> Search:
    """Solve the starts of all hypotheses.

    Without a deadline all starts are solved together. With one they are solved in turns: first
    the most promising start of each hypothesis (a warm one, if any), so that there is something
    to compare; then, while time is left, the next one of each that can still win.

    Args:
        assembly: The density, one model per hypothesis.
        hypotheses: With their starts.
        solver: How a start is solved.
        warm: Starts from the previous plan; each hypothesis takes the best of them.
        until: When to stop, on the clock of `time.perf_counter` [s].
    """
    queue = [
        [
            *_warmest(assembly, i, warm),
            *((s.label, assembly.models[i].initial(s)) for s in h.starts),
        ]
        for i, h in enumerate(hypotheses)
    ]
    indices = range(len(hypotheses))
    if np.isinf(until):
        every = [(i, *start) for i in indices for start in queue[i]]
        return Search(_solve(assembly, solver, every), frozenset(), frozenset())
    found: list[Found] = []
    dropped: set[int] = set()
    for turn in range(max(map(len, queue))):
        starts = [
            (i, *queue[i][turn]) for i in indices if i not in dropped and turn < len(queue[i])
        ]
        if turn > 0 and perf_counter() >= until:
            late = {i for i, *_ in starts}
            return Search(tuple(found), frozenset(dropped), _unended(found) | late)
        if starts:
            found += _solve(assembly, solver, starts, until)
        if turn == 0 and len(hypotheses) > 1:
            best = max(hypotheses[f.which].log_prior - _score(assembly, f) for f in found)
            dropped = {i for i in indices if hypotheses[i].log_prior - _bound(assembly, i) < best}
    return Search(tuple(found), frozenset(dropped), _unended(found))


def worth_solving(
    assembly: Assembly, hypotheses: Sequence[Hypothesis], solver: Solver, margin: float
) -> list[int]:
    """Branch and bound over many hypotheses: those that a bound does not exclude, in their order.

    No optimum of hypothesis i scores above log w_i − bound_i. The most promising are solved from
    their first start, best bound first; who cannot come within `margin` of the best score so far
    has less than exp(−margin) of its probability by height, and is left out.

    Args:
        assembly: The density, one model per hypothesis.
        hypotheses: With their starts.
        solver: How a start is solved.
        margin: [nats].
    """
    reach = [h.log_prior - _bound(assembly, i) for i, h in enumerate(hypotheses)]
    order = sorted(range(len(hypotheses)), key=lambda i: -reach[i])
    best = -np.inf
    for at in range(0, len(order), AT_ONCE):
        some = [i for i in order[at : at + AT_ONCE] if reach[i] >= best]
        if not some:
            break
        starts = [
            (i, hypotheses[i].starts[0].label, assembly.models[i].initial(hypotheses[i].starts[0]))
            for i in some
        ]
        for f in _solve(assembly, solver, starts):
            score = hypotheses[f.which].log_prior - _score(assembly, f)
            best = max(best, score if np.isfinite(score) else -np.inf)
    return [i for i in range(len(hypotheses)) if reach[i] >= best - margin]


def shifted(previous: Mixture, scenario: Scenario, now: float) -> tuple[Start, ...]:
    """Every component of a previous plan as a start for now: what is left of it, then straight on.

    Args:
        previous: The plan that is being driven.
        scenario: What is known now.
        now: Time since that plan began [s].
    """
    times = scenario.density.times
    starts = []
    for component in previous.components:
        ahead = component.robot.at(times + now)
        # The robot is not quite where the plan wanted it: close the gap over the horizon.
        gap = scenario.robot.position - ahead[0, :2]
        ahead[:, :2] += gap * (1 - times[:, None] / times[-1])
        crowd = {
            name: Trajectory.from_states(times, person.at(times + now))
            for name, person in component.crowd.items()
        }
        starts.append(Start("warm", Trajectory.from_states(times, ahead), crowd))
    return tuple(starts)


def _warmest(assembly: Assembly, i: int, warm: Sequence[Start]) -> list[tuple[str, Array]]:
    """The warm start with the lowest energy under hypothesis i."""
    if not warm:
        return []
    states = np.stack([assembly.models[i].initial(start) for start in warm])
    energy = assembly.energy(states, np.full(len(warm), i))
    if not np.isfinite(energy).any():
        return []
    best = int(np.nanargmin(np.where(np.isfinite(energy), energy, np.nan)))
    return [(warm[best].label, states[best])]


def _solve(
    assembly: Assembly,
    solver: Solver,
    starts: Sequence[tuple[int, str, Array]],
    until: float = np.inf,
) -> tuple[Found, ...]:
    which = np.array([i for i, _, _ in starts])
    initial = np.stack([state for _, _, state in starts])
    solutions = solver.solve(assembly, initial, which, until)
    return tuple(
        Found(i, label, solution) for (i, label, _), solution in zip(starts, solutions, strict=True)
    )


def _score(assembly: Assembly, found: Found) -> float:
    return found.solution.energy - assembly.models[found.which].log_normalizer_own


def _bound(assembly: Assembly, i: int) -> float:
    """No optimum of a hypothesis has a lower energy: potentials are never negative, and what is
    left is quadratic."""
    which = np.array([i])
    diagonal, upper = assembly.linear_hessian(which)
    gradient = np.where(assembly.free, assembly.gradient[i], 0.0)
    assembly.hold_fixed(diagonal, upper)
    factor = factorize(diagonal[0], upper[0])
    if factor is None:
        return -np.inf
    lowest = assembly.constant[i] - 0.5 * np.vdot(gradient, factor.solve(gradient))
    return float(lowest - assembly.models[i].log_normalizer_own)


def _unended(found: Sequence[Found]) -> frozenset[int]:
    return frozenset(f.which for f in found if f.solution.stop is Stop.DEADLINE)
