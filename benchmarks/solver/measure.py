"""Times of all solvers, interleaved scene by scene: what slows the machine slows all of them."""

from __future__ import annotations

from argparse import ArgumentTypeError
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.memory import resident
from benchmarks.scenes import DENSE, World, smooth
from benchmarks.solver.peers import FLOORS, PEERS, Native, Peer, floor
from benchmarks.solver.problem import Problem, cold, warm
from fgplan.hypothesis import Start
from fgplan.planner import plan
from fgplan.solver import SecondOrder
from fgplan.trajectory import Trajectory

Array = NDArray[np.float64]

PLAN = "fgplan.plan"
"""The public function, in the table."""
TWELVE = 12
"""Starts of one hypothesis among people held at their prediction."""


Clock = Callable[[], float]


@dataclass(frozen=True)
class Size:
    """n people, T steps, K plans; `density` in people per square metre, None for the usual one."""

    n: int
    T: int
    K: int
    crowd: Literal["joint", "predicted"] = "joint"
    density: float | None = None


@dataclass(frozen=True)
class Effort:
    """How long to measure.

    Args:
        scenes: At most.
        least: Scenes that a solver gets in any case, unless one takes longer than `most`.
        seconds: After this a solver gets no more scenes of a size [s].
        most: A solver one of whose scenes takes longer gets no more [s].
        clock: `time.process_time` for a machine that has other things to do.
    """

    scenes: int = 30
    least: int = 3
    seconds: float = 15.0
    most: float = 60.0
    clock: Clock = perf_counter


@dataclass(frozen=True)
class Sample:
    """One plan made: time [s], linear systems (or steps of the method), lowest energy [nats]."""

    seconds: float
    iterations: float
    energy: float


@dataclass
class Record:
    """Samples of one solver and start, and what it took to prepare them [s]."""

    samples: list[Sample] = field(default_factory=list)
    build: list[float] = field(default_factory=list)


Records = dict[tuple[str, str], Record]
Row = dict[str, Any]
Tell = Callable[[str], None]
Tick = Callable[[], None]


def rows_of(size: Size, effort: Effort, tell: Tell, tick: Tick) -> list[Row]:
    """All rows of one size.

    Args:
        size: The size.
        effort: How long to measure.
        tell: Is given the reason wherever something is left out.
        tick: Is called after every scene.
    """
    records: Records = defaultdict(Record)
    if size.crowd == "predicted":
        _measure_twelve(size, effort, records, tick)
    else:
        _measure_plans(size, effort, records, tell, tick)
    own = {start: records["fgplan", start].samples for start in ("cold", "warm")}
    return [
        _row(size, solver, start, record, own[start])
        for (solver, start), record in records.items()
        if record.samples
    ]


class _Budget:
    """Who still gets scenes of a size."""

    def __init__(self, effort: Effort, where: str, tell: Tell) -> None:
        self._effort, self._where, self._tell = effort, where, tell
        self._spent: dict[str, list[float]] = defaultdict(list)

    def allows(self, name: str) -> bool:
        spent, effort = self._spent[name], self._effort
        if spent and max(spent) > effort.most:
            return False
        return len(spent) < effort.least or sum(spent) < effort.seconds

    @contextmanager
    def scene(self, name: str) -> Iterator[None]:
        began = perf_counter()
        yield
        spent = self._spent[name]
        spent.append(perf_counter() - began)
        if not self.allows(name):
            reason = f"{sum(spent):.0f} s are spent"
            self._tell(f"{self._where}: {name} ends after {len(spent)} scenes, {reason}")


def _measure_plans(size: Size, effort: Effort, records: Records, tell: Tell, tick: Tick) -> None:
    where = f"n={size.n} T={size.T} K={size.K}"
    budget = _Budget(effort, where, tell)
    # Sizes at a density of their own are for the exponent of the first alone.
    peers = PEERS if size.density is None else PEERS[:1]
    for peer in peers:
        if size.n > peer.most_people:
            tell(f"{where}: {peer.name} left out, it is for up to {peer.most_people} people")
    peers = tuple(peer for peer in peers if size.n <= peer.most_people)
    for seed in range(effort.scenes):
        problems = problems_of(size, seed)
        for peer in peers:
            if budget.allows(peer.name):
                with budget.scene(peer.name):
                    _solve_both(peer, problems, records, effort.clock, first=seed == 0)
        if size.density is None and budget.allows(PLAN):
            with budget.scene(PLAN):
                _plan_both(size, seed, records, effort.clock)
        tick()


def problems_of(size: Size, seed: int) -> dict[str, Problem]:
    """A cold problem and, one step later, a warm one: the same for all solvers."""
    world = World.random(seed, size.n, size.density)
    arguments = {"T": size.T, "K": size.K}
    first = cold(world.scenario(**arguments))
    solutions = SecondOrder().solve(first.assembly, first.initial, first.which)
    states = np.stack([solution.state for solution in solutions])
    return {"cold": first, "warm": warm(world, first, states, **arguments)}


def _solve_both(
    peer: Peer, problems: dict[str, Problem], records: Records, clock: Clock, first: bool
) -> None:
    for start, problem in problems.items():
        record = records[peer.name, start]
        began = clock()
        prepared = peer.prepare(problem)
        record.build.append(clock() - began)
        if first and start == "cold":
            peer.solve(problem, prepared)  # caches fill, code is paged in
        sample = _timed(peer, problem, prepared, clock)
        record.samples.append(sample)
        if peer.name == "fgplan":
            _add_floor(problem, start, sample, records, clock)


def _timed(peer: Peer, problem: Problem, prepared: Any, clock: Clock) -> Sample:
    problem.initial  # noqa: B018 - computed once, outside of the time
    began = clock()
    states, iterations = peer.solve(problem, prepared)
    seconds = clock() - began
    return Sample(seconds, iterations, float(problem.energies(states).min()))


def _add_floor(
    problem: Problem, start: str, sample: Sample, records: Records, clock: Clock
) -> None:
    """What `fgplan` would take if everything but the linear systems were free."""
    ends = SecondOrder().solve(problem.assembly, problem.initial, problem.which)
    pairs = zip(problem.which.tolist(), ends, strict=True)
    converged = [(end.state, which) for which, end in pairs if end.converged]
    for name, backend in FLOORS.items():
        for state, which in converged[:1]:
            one = floor(problem, state, which, backend, clock)
            reached = replace(sample, seconds=sample.iterations * one)
            records[name, start].samples.append(reached)


def _plan_both(size: Size, seed: int, records: Records, clock: Clock) -> None:
    """The public function with all its starts, twice: the second time it knows the first plan."""
    world = World.random(seed, size.n)
    before = None
    for start in ("cold", "warm"):
        scenario = world.scenario(size.T, size.K)
        began = clock()
        mixture = plan(scenario, warm=before)
        seconds = clock() - began
        iterations = sum(c.iterations for c in mixture.components)
        energy = min(c.energy for c in mixture.components)
        records[PLAN, start].samples.append(Sample(seconds, iterations, energy))
        before, world = mixture, world.moved(mixture.trajectory.states[1])


def _measure_twelve(size: Size, effort: Effort, records: Records, tick: Tick) -> None:
    """Twelve starts of one hypothesis: all followed to their end, or as `plan` follows them for
    the most probable plan, which gives up those that cannot win or meet others."""
    every = Native("fgplan predicted x12", SecondOrder(meeting=0.0, patience=np.inf))
    best = Native("fgplan predicted x12, best", SecondOrder(margin=0.0))
    arguments = {"T": size.T, "K": size.K, "crowd": size.crowd}
    for seed in range(effort.scenes):
        world = World.random(seed, size.n)
        first = twelve(cold(world.scenario(**arguments)), seed)
        if seed == 0:
            every.solve(first, None)
        states, _ = every.solve(first, None)
        after = warm(world, first, states, **arguments)
        lowest = after.starts[int(np.argmin(first.energies(states)))]
        fresh = twelve(replace(after, starts=(lowest,)), seed)
        for peer in (every, best):
            problems = {(peer.name, "cold"): first, (peer.name, "warm"): after}
            problems[f"{peer.name}, 1 warm", "warm"] = fresh
            for key, problem in problems.items():
                records[key].samples.append(_timed(peer, problem, None, effort.clock))
        tick()


def twelve(problem: Problem, seed: int) -> Problem:
    """The problem with its own start, all of the first hypothesis's and, to make twelve, bent
    ones."""
    hypothesis = problem.hypotheses[0]
    starts = [problem.starts[0], *hypothesis.starts[problem.starts[0] is hypothesis.starts[0] :]]
    rng = np.random.default_rng(seed)
    times = problem.scenario.density.times
    while len(starts) < TWELVE:
        states = hypothesis.starts[0].robot.states + smooth(rng, times, 1.5)
        starts.append(Start("bent", Trajectory.from_states(times, states)))
    return replace(problem, starts=tuple(starts[:TWELVE]), which=np.zeros(TWELVE, dtype=np.intp))


def _row(size: Size, solver: str, start: str, record: Record, own: list[Sample]) -> Row:
    """One row: times in ms, energy in nats, memory in MB.

    `times_fgplan` is the median over scenes of the time in units of fgplan's in the same scene.
    """
    # Some solvers get fewer scenes: always the first ones.
    ratios = [s.seconds / o.seconds for s, o in zip(record.samples, own, strict=False)]
    ms = 1e3 * np.array([sample.seconds for sample in record.samples])
    at = f", {size.density:g} people/m2" if size.density is not None else ""
    return {
        "n": size.n,
        "T": size.T,
        "K": size.K,
        "solver": solver + at,
        "start": start,
        "p50_ms": float(np.median(ms)),
        "p95_ms": float(np.percentile(ms, 95)),
        "max_ms": float(ms.max()),
        "iterations_p50": float(np.median([s.iterations for s in record.samples])),
        "energy_mean": float(np.mean([s.energy for s in record.samples])),
        "rss_mb": resident(),
        "build_ms": float(1e3 * np.median(record.build)) if record.build else 0.0,
        "scenes": len(ms),
        "times_fgplan": float(np.median(ratios)) if ratios else None,
    }


NAMED = {
    "predicted": (Size(10, 24, 1, crowd="predicted"),),
    "dense": tuple(Size(n, 30, 3, density=DENSE) for n in (10, 20, 50, 100)),
}
"""People held at their prediction; and what the exponent of n is fitted to."""


def sizes(short: bool = False, only: Sequence[Size] | None = None) -> tuple[Size, ...]:
    """What is measured, small ones first: the memory of a row includes that of those before."""
    if only is not None:
        return tuple(only)
    if short:
        return (*NAMED["predicted"], Size(0, 20, 1), Size(5, 20, 3), Size(10, 20, 1))
    grid = [Size(n, T, K) for n in (0, 5, 10, 20, 50, 100) for T in (20, 30, 50) for K in (1, 3, 5)]
    return (*NAMED["predicted"], *NAMED["dense"][:2], *grid)


def asked(text: str) -> tuple[Size, ...]:
    """The sizes that a user means: n,T,K or a name of several.

    Raises:
        ArgumentTypeError: it is neither.
    """
    if text in NAMED:
        return NAMED[text]
    names = ", ".join(NAMED)
    try:
        n, T, K = (int(part) for part in text.split(","))
    except ValueError:
        raise ArgumentTypeError(
            f"n,T,K is three whole numbers, or one of {names}, got {text!r}"
        ) from None
    if n < 0 or T < 1 or not 1 <= K <= 5:
        raise ArgumentTypeError(f"n >= 0, T >= 1 and K from 1 to 5, got {text!r}")
    return (Size(n, T, K),)
