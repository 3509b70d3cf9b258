"""Solved starts → components: distinct optima, the hard check, evidence, merging."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from fgplan.assembly import Assembly
from fgplan.crowd import Belief
from fgplan.gating import left_out_energy
from fgplan.hypothesis import Hypothesis
from fgplan.inference.base import Inference, Inferred, Progress
from fgplan.inference.laplace import QUICK
from fgplan.labels import JOINED
from fgplan.mixture import Component
from fgplan.model import Model
from fgplan.safety import Check, Checker, People, check
from fgplan.scenario import Scenario
from fgplan.search import Found
from fgplan.solver import Solution, Stop
from fgplan.trajectory import Trajectory

Array = NDArray[np.float64]

SAME = 0.02
"""Two optima closer than this in every coordinate [m, m/s] are one."""
NEARBY = 2.0
"""A side is reported for people who come closer than this [m]."""


@dataclass(frozen=True, eq=False)
class Solved:
    """A component, and the state of all its variables (T + 1, D)."""

    component: Component
    state: Array


@dataclass(frozen=True, eq=False)
class Solving:
    """What the optima of one hypothesis are read with; after `until`, on the clock of
    `time.perf_counter`, only the best one is checked [s]."""

    scenario: Scenario
    belief: Belief
    assembly: Assembly
    which: int
    finished: bool = True
    inference: Inference = QUICK
    seed: int = 0
    progress: Progress | None = None
    checker: Checker = check
    until: float = np.inf
    checks: dict[Solution, Check] = field(default_factory=dict)
    robots: dict[Solution, Trajectory] = field(default_factory=dict)

    def infer(self, label: str, optima: list[Found]) -> Inferred:
        """Trajectories and evidence; each hypothesis has its own stream of random numbers."""

        def tell(what: str, done: int, total: int) -> None:
            if self.progress is not None:
                self.progress(f"{label}: {what}", done, total)

        solutions = [optimum.solution for optimum in optima]
        seed = (self.seed, self.which)
        return self.inference.infer(self.assembly, self.which, solutions, seed, tell)

    @property
    def model(self) -> Model:
        return self.assembly.models[self.which]

    def robot(self, solution: Solution) -> Trajectory:
        """f^R in the plane, made once."""
        if solution not in self.robots:
            states = solution.state[:, self.model.columns["robot"]]
            model = self.scenario.robot.model
            self.robots[solution] = model.trajectory(self.model.times, states)
        return self.robots[solution]

    def level(self, solution: Solution, name: str) -> Trajectory:
        """A level that is a variable."""
        return Trajectory.from_states(self.model.times, solution.state[:, self.model.columns[name]])

    def people(self, solution: Solution) -> People:
        """Where people are planned, and predicted where they are not variables."""
        model, times = self.model, self.model.times
        states = self.belief.expected(times)
        if "crowd" in model.columns and model.gate is not None:
            n = len(model.people)
            flat = solution.state[:, model.columns["crowd"]].reshape(len(times), 2, n, 2)
            states[:, model.gate.planned] = np.concatenate([flat[:, 0], flat[:, 1]], axis=-1)
        return People(times, states, self.belief.radii)

    def check(self, solution: Solution) -> Check:
        """The hard check, made once."""
        if solution not in self.checks:
            robot, people = self.robot(solution), self.people(solution)
            self.checks[solution] = self.checker(self.scenario, robot, people)
        return self.checks[solution]

    def left_out(self, people: People) -> float:
        """What the density leaves out at these people's trajectories [nats]."""
        if self.model.gate is None:
            return 0.0
        return left_out_energy(self.scenario, self.model.gate, people.states)


def component_of(
    solving: Solving, hypothesis: Hypothesis, own: list[Found], seconds: float
) -> Solved:
    """The best feasible optimum of one hypothesis (the best one, if none is feasible)."""
    ended = [f for f in own if f.solution.stop not in (Stop.MERGED, Stop.GIVEN_UP)] or own
    # Rounded, so that of two starts with one optimum the first is named.
    lowest_first = sorted(ended, key=lambda f: round(f.solution.energy, 6))
    found = {f.solution: f for f in lowest_first}
    optima = [found[solution] for solution in distinct(found)]
    best, result, lowest = _followed(solving, optima)
    solution = best.solution
    scenario, model = solving.scenario, solving.model
    robot = solving.robot(solution)
    people = solving.people(solution)
    levels = {}
    for index, level in enumerate(scenario.levels):
        if f"level {index}" in model.columns:
            levels[level.name] = solving.level(solution, f"level {index}")
        elif (plan := hypothesis.plan_of(level.name)) is not None:
            levels[level.name] = plan
    names = solving.belief.names
    inferred = solving.infer(hypothesis.label, optima)
    component = Component(
        label=hypothesis.label,
        log_prior=hypothesis.log_prior,
        cost=hypothesis.cost,
        energy=solution.energy - model.log_normalizer_own,
        lowest=lowest - model.log_normalizer_own,
        log_evidence=inferred.log_evidence,
        converged=solution.converged,
        stop=solution.stop.value,
        iterations=sum(f.solution.iterations for f in own),
        seconds=seconds,
        start=best.label,
        optima=len(optima),
        finished=solving.finished,
        check=result,
        robot=robot,
        crowd={
            name: Trajectory.from_states(people.times, people.states[:, i])
            for i, name in enumerate(names)
        },
        levels=levels,
        left_out=solving.left_out(people),
        displacement=_displacement(solving.belief, people),
        sides=_sides(robot, people, names),
        route=hypothesis.route,
        inferred=inferred,
    )
    return Solved(component, solution.state)


def distinct(optima: Iterable[Solution]) -> list[Solution]:
    """Optima without repetition, in the order given: the first of those within `SAME`."""
    kept: list[Solution] = []
    for new in optima:
        if all(np.abs(new.state - old.state).max() > SAME for old in kept):
            kept.append(new)
    return kept


def _followed(solving: Solving, optima: list[Found]) -> tuple[Found, Check, float]:
    """The optimum to follow, its check, and the energy of the best one: of those that pass the
    hard check, by grade, then energy; of all, by energy, where none passes it and is clear."""
    checked: list[tuple[Found, Check]] = []
    for optimum in optima:
        if checked and perf_counter() >= solving.until:
            break
        checked.append((optimum, solving.check(optimum.solution)))
        if checked[-1][1].fine:
            break
    followed, result = min(checked, key=lambda pair: pair[1].grade if pair[1].clear else np.inf)
    passed = [optimum for optimum, check in checked if check.feasible]
    best = passed[0] if passed else followed
    return followed, result, best.solution.energy


def _displacement(belief: Belief, people: People) -> dict[str, float]:
    mean, covariance = belief.predict(people.times)
    moved = people.states[..., :2] - mean[..., :2]
    whitened = np.linalg.solve(covariance[..., :2, :2], moved[..., None])[..., 0]
    distance = np.sqrt(np.maximum(np.einsum("tni,tni->tn", moved, whitened), 0.0))
    worst = distance.max(axis=0) if belief.count else np.zeros(0)
    return dict(zip(belief.names, worst.tolist(), strict=True))


def _sides(robot: Trajectory, people: People, names: tuple[str, ...]) -> dict[str, str]:
    """On which hand of the robot each person near it goes by, from the angle they sweep."""
    apart = people.states[..., :2] - robot.positions[:, None]
    bearing = np.unwrap(np.arctan2(apart[..., 1], apart[..., 0]), axis=0)
    swept = bearing[-1] - bearing[0]
    near = np.linalg.norm(apart, axis=-1).min(axis=0) < NEARBY
    passed = near & (np.abs(swept) > np.pi / 4)
    return {names[i]: "left" if swept[i] > 0 else "right" for i in np.flatnonzero(passed)}


def merge(solved: list[Solved]) -> list[Component]:
    """Hypotheses that ended in one optimum are one: their weights add."""
    merged: list[Solved] = []
    for new in solved:
        twin = next((i for i, old in enumerate(merged) if _is_same(old, new)), None)
        if twin is None:
            merged.append(new)
            continue
        old = merged[twin]
        keep, other = sorted((old, new), key=lambda s: s.component.energy)
        component = replace(
            keep.component,
            label=f"{old.component.label}{JOINED}{new.component.label}",
            log_prior=float(np.logaddexp(old.component.log_prior, new.component.log_prior)),
            cost=min(old.component.cost, new.component.cost),
            lowest=min(old.component.lowest, new.component.lowest),
            iterations=keep.component.iterations + other.component.iterations,
            seconds=keep.component.seconds + other.component.seconds,
        )
        merged[twin] = Solved(component, keep.state)
    return [s.component for s in merged]


def _is_same(a: Solved, b: Solved) -> bool:
    return bool(
        abs(a.component.energy - b.component.energy) < SAME
        and np.abs(a.state - b.state).max() < SAME
    )
