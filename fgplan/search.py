"""How the starts of all hypotheses are spent: warm ones first, and only where they can matter."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from fgplan.assembly import Assembly
from fgplan.block_tridiagonal import factorize
from fgplan.crowd import Belief
from fgplan.hypothesis import Hypothesis, Start
from fgplan.mixture import Mixture
from fgplan.scenario import Scenario
from fgplan.sketch import sketched
from fgplan.solver import Solution, Solver, Stop
from fgplan.trajectory import Trajectory, hermite

Array = NDArray[np.float64]

SKETCHING = 0.5
"""Share of what is left of the time that may be spent on sketches."""
AT_ONCE = 8
"""Hypotheses solved together when many are bounded."""


@dataclass(frozen=True, eq=False)
class Found:
    """Where one start of one hypothesis ended; `rank` is its place among the starts."""

    which: int
    rank: int
    label: str
    solution: Solution


@dataclass(frozen=True, eq=False)
class _Begin:
    """A start, or where one is to go on: its hypothesis, place, label and state (T + 1, D)."""

    which: int
    rank: int
    label: str
    state: Array


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
    usable: Callable[[int, Solution], bool] = lambda which, solution: True,
    held: Assembly | None = None,
) -> Search:
    """Solve the starts of all hypotheses.

    Without a deadline all starts are solved together. With one they are solved in turns: first
    the most promising start of each hypothesis (a warm one, if any), so that there is something
    to compare; then, while time is left, more and more of those that can still win. Whoever was
    given up for a better start is followed after all where no better one is of use.

    Args:
        assembly: The density, one model per hypothesis.
        hypotheses: With their starts.
        solver: How a start is solved.
        warm: Starts from the previous plan; each hypothesis takes the best of them.
        until: When to stop, on the clock of `time.perf_counter` [s].
        usable: Whether an optimum of a hypothesis may be followed, as far as the caller knows.
        held: The density with all people held at their prediction: starts are solved there first
            (`fgplan.sketch`), and only their distinct ends, and the plan itself, are solved among
            people who react. The others are where nothing else is of use.
    """
    indices, limited = range(len(hypotheses)), bool(np.isfinite(until))
    found: list[Found] = []
    dropped: set[int] = set()

    def ended(i: int) -> list[Solution]:
        """Where starts of a hypothesis ended, the lowest first."""
        own = (f.solution for f in found if f.which == i)
        over = [s for s in own if s.stop not in (Stop.GIVEN_UP, Stop.MERGED)]
        return sorted(over, key=lambda solution: solution.energy)

    def served(i: int) -> bool:
        """Whether one of them may be followed, or it is too late to find out."""
        return any(usable(i, solution) or perf_counter() >= until for solution in ended(i))

    def best_served(i: int) -> bool:
        """Whether the lowest one may be followed."""
        return any(usable(i, solution) for solution in ended(i)[:1])

    def wanting(served: Callable[[int], bool]) -> list[_Begin]:
        """Starts that were given up or only sketched, of hypotheses in which nothing is of use."""
        more = [] if held is None else _untried(assembly, hypotheses, found, served, dropped)
        return _needed(found, served) + more

    late: set[int] = set()
    for turn, queue in enumerate(_turns(assembly, hypotheses, warm, until, held)):
        starts = [start for i in indices if i not in dropped for start in queue[i]]
        if turn > 0 and perf_counter() >= until:
            late = {start.which for start in starts}
            break
        if starts:
            found = _joined(found, _solve(assembly, solver, starts + _best(found, dropped), until))
        if turn == 0 and limited and len(hypotheses) > 1 and perf_counter() < until:
            scores = (
                hypotheses[f.which].log_prior - _score(assembly, f)
                for f in found
                if usable(f.which, f.solution)
            )
            best = max(scores, default=-np.inf)
            dropped = {i for i in indices if hypotheses[i].log_prior - _bound(assembly, i) < best}
    while perf_counter() < until and (again := wanting(served)):
        found = _joined(found, _solve(assembly, solver, again, until))
    if perf_counter() >= until:
        late |= {start.which for start in wanting(best_served)}
    return Search(tuple(found), frozenset(dropped), _unended(found) | late)


def _turns(
    assembly: Assembly,
    hypotheses: Sequence[Hypothesis],
    warm: Sequence[Start],
    until: float,
    held: Assembly | None,
) -> Iterator[list[list[_Begin]]]:
    """Which starts of each hypothesis are solved together: all, or 1, 3 and then the rest."""
    limited = np.isfinite(until)
    warmest = [_warmest(assembly, i, warm) for i in range(len(hypotheses))]
    queue = warmest
    if held is None:
        queue = [w + _own(assembly, i, hypotheses[i], len(w)) for i, w in enumerate(warmest)]
    else:
        if limited and any(warmest):
            yield warmest
            queue = [[] for _ in hypotheses]
        now = perf_counter()
        ends = sketched(assembly, held, hypotheses, now + SKETCHING * (until - now))
        queue = [
            before
            + [_Begin(i, 1 + rank, end.label, end.state) for rank, end in enumerate(ends[i])]
            + _own(assembly, i, h, 1 + len(h.starts))[:1]
            for i, (before, h) in enumerate(zip(queue, hypotheses, strict=True))
        ]
    longest = max(map(len, queue))
    for a, b in pairwise([0, 1, 4, longest] if limited else [0, longest]):
        if a < longest:
            yield [own[a:b] for own in queue]


def worth_solving(
    assembly: Assembly,
    hypotheses: Sequence[Hypothesis],
    solver: Solver,
    margin: float,
    until: float = np.inf,
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
        until: When to end, on the clock of `time.perf_counter` [s]: what is known by then excludes.
    """
    reach = [h.log_prior - _bound(assembly, i) for i, h in enumerate(hypotheses)]
    order = sorted(range(len(hypotheses)), key=lambda i: -reach[i])
    best = -np.inf
    for at in range(0, len(order), AT_ONCE):
        some = [i for i in order[at : at + AT_ONCE] if reach[i] >= best]
        if not some or perf_counter() >= until:
            break
        starts = [_own(assembly, i, hypotheses[i])[0] for i in some]
        for f in _solve(assembly, solver, starts, until):
            score = hypotheses[f.which].log_prior - _score(assembly, f)
            best = max(best, score if np.isfinite(score) else -np.inf)
    return [i for i in range(len(hypotheses)) if reach[i] >= best - margin]


def shifted(previous: Mixture, scenario: Scenario, belief: Belief) -> tuple[Start, ...]:
    """Every component of a previous plan as a start for now: what is left of it, then straight on.

    The robot closes the gap to where it really is over the horizon. A person does what was planned
    for them from where they are now, relative to going straight on as they go now.

    Args:
        previous: The plan that is being driven.
        scenario: What is known now.
        belief: The people now; those held at their prediction are left out.
    """
    return tuple(
        shift(c.robot, c.crowd, previous.now, scenario, belief) for c in previous.components
    )


def shift(
    robot: Trajectory,
    crowd: Mapping[str, Trajectory],
    then: float,
    scenario: Scenario,
    belief: Belief,
) -> Start:
    """One robot and the people around it, planned at time `then` [s], as a start for now."""
    times, elapsed = scenario.density.times, scenario.now - then
    ahead = robot.resampled(times + elapsed)
    gap = scenario.robot.position - ahead.positions[0]
    positions = ahead.positions + gap * (1 - times[:, None] / times[-1])
    people = {} if scenario.crowd == "predicted" else _from_now(crowd, belief, times, elapsed)
    return Start("warm", replace(ahead, times=times, positions=positions), people)


def _from_now(
    crowd: Mapping[str, Trajectory], belief: Belief, times: Array, elapsed: float
) -> dict[str, Trajectory]:
    known = [i for i, name in enumerate(belief.names) if name in crowd]
    if not known:
        return {}
    names = [belief.names[i] for i in known]
    before = [crowd[name] for name in names]
    states = np.stack([person.states for person in before], axis=1)
    ahead = hermite(before[0].times, states[..., :2], states[..., 2:], times + elapsed)
    position, velocity = belief.mean[known, :2], belief.mean[known, 2:]
    change = velocity - ahead[1][0]
    positions = ahead[0] + (position - ahead[0][0]) + times[:, None, None] * change
    velocities = ahead[1] + change
    return {
        name: Trajectory(times, positions[:, i], velocities[:, i]) for i, name in enumerate(names)
    }


def _own(assembly: Assembly, i: int, hypothesis: Hypothesis, first: int = 0) -> list[_Begin]:
    """The starts of one hypothesis, ranked from `first` on."""
    model = assembly.models[i]
    return [
        _Begin(i, first + rank, start.label, model.initial(start))
        for rank, start in enumerate(hypothesis.starts)
    ]


def _warmest(assembly: Assembly, i: int, warm: Sequence[Start]) -> list[_Begin]:
    """The warm start with the lowest energy under hypothesis i."""
    if not warm:
        return []
    states = np.stack([assembly.models[i].initial(start) for start in warm])
    energy = assembly.energy(states, np.full(len(warm), i))
    if not np.isfinite(energy).any():
        return []
    best = int(np.nanargmin(np.where(np.isfinite(energy), energy, np.nan)))
    return [_Begin(i, 0, warm[best].label, states[best])]


def _solve(
    assembly: Assembly, solver: Solver, starts: Sequence[_Begin], until: float = np.inf
) -> list[Found]:
    which = np.array([start.which for start in starts])
    initial = np.stack([start.state for start in starts])
    solutions = solver.solve(assembly, initial, which, until)
    return [
        Found(s.which, s.rank, s.label, solution)
        for s, solution in zip(starts, solutions, strict=True)
    ]


def _joined(before: Sequence[Found], after: Sequence[Found]) -> list[Found]:
    """What was found before and now; who went on is there once, with all its iterations."""
    joined = {(f.which, f.rank): f for f in before}
    for f in after:
        old = joined.get((f.which, f.rank))
        if old is not None:
            # An optimum stays one, whatever better one was found since.
            end = old.solution if old.solution.converged else f.solution
            spent = old.solution.iterations + f.solution.iterations
            f = replace(f, solution=replace(end, iterations=spent))
        joined[f.which, f.rank] = f
    return list(joined.values())


def _best(found: Sequence[Found], dropped: set[int]) -> list[_Begin]:
    """The best of each hypothesis so far as a start: the next ones are compared with it."""
    best: dict[int, Found] = {}
    for f in found:
        if f.solution.converged and f.which not in dropped:
            old = best.get(f.which)
            if old is None or f.solution.energy < old.solution.energy:
                best[f.which] = f
    return [_resumed(f) for f in best.values()]


def _resumed(found: Found) -> _Begin:
    return _Begin(found.which, found.rank, found.label, found.solution.state)


def _needed(found: Sequence[Found], served: Callable[[int], bool]) -> list[_Begin]:
    """Starts that were given up, of the hypotheses in which nothing else is of use."""
    given_up = [f for f in found if f.solution.stop is Stop.GIVEN_UP]
    wanting = {i for i in {f.which for f in given_up} if not served(i)}
    return [_resumed(f) for f in given_up if f.which in wanting]


def _untried(
    assembly: Assembly,
    hypotheses: Sequence[Hypothesis],
    found: Sequence[Found],
    served: Callable[[int], bool],
    dropped: set[int],
) -> list[_Begin]:
    """Starts that were only sketched, of the hypotheses in which nothing else is of use."""
    tried = {(f.which, f.rank) for f in found}
    return [
        start
        for i, hypothesis in enumerate(hypotheses)
        if i not in dropped and not served(i)
        for start in _own(assembly, i, hypothesis, 1 + len(hypothesis.starts))
        if (i, start.rank) not in tried
    ]


def _score(assembly: Assembly, found: Found) -> float:
    return found.solution.energy - assembly.models[found.which].log_normalizer_own


def _bound(assembly: Assembly, i: int) -> float:
    """No optimum of a hypothesis has a lower energy: potentials are never negative, and what is
    left is quadratic."""
    which = np.array([i])
    diagonal, upper = assembly.held_hessian(which)
    gradient = np.where(assembly.free, assembly.gradient[i], 0.0)
    factor = factorize(diagonal[0], upper[0])
    if factor is None:
        return -np.inf
    lowest = assembly.constant[i] - 0.5 * np.vdot(gradient, factor.solve(gradient))
    return float(lowest - assembly.models[i].log_normalizer_own)


def _unended(found: Sequence[Found]) -> frozenset[int]:
    return frozenset(f.which for f in found if f.solution.stop is Stop.DEADLINE)
