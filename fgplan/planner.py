"""plan: from what is known now to a mixture of solved hypotheses, and the action."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from time import perf_counter

import gtsam
import numpy as np
from numpy.typing import NDArray

from fgplan import selection
from fgplan.assembly import Assembly
from fgplan.components import Solving, component_of, merge
from fgplan.conditioning import reweigh
from fgplan.crowd import Belief, believe, heading, seen
from fgplan.deadline import Deadline
from fgplan.errors import NoPlan
from fgplan.hypotheses import hypothesise
from fgplan.hypothesis import Hypothesis
from fgplan.inference import MAP, Inference, Progress, named
from fgplan.inference.laplace import QUICK
from fgplan.mixture import Action, Component, Mixture
from fgplan.model import build, touches_crowd
from fgplan.obeying import obeying
from fgplan.products import crossed
from fgplan.safety import Checker, People, brake, check
from fgplan.scenario import Scenario
from fgplan.search import Search, search, shifted, worth_solving
from fgplan.shared_control import operated
from fgplan.solver import SecondOrder, Solver
from fgplan.tactical import of_people
from fgplan.trajectory import Trajectory, length
from fgplan.validation import validate

Array = NDArray[np.float64]

NEGLIGIBLE = 30.0
"""Combinations of levels that are surely this much less probable than the best are left out [nats]:
exp(−30) is 1e-13."""


def plan(
    scenario: Scenario,
    *,
    belief: Belief | None = None,
    factors: Iterable[gtsam.NonlinearFactor] = (),
    solver: Solver | None = None,
    select: selection.Rule = selection.height,
    hypotheses: Callable[[Scenario, Belief], Sequence[Hypothesis]] | None = None,
    warm: Mixture | None = None,
    deadline: float | None = None,
    inference: Inference | str = QUICK,
    seed: int = 0,
    progress: Progress | None = None,
    check: Checker = check,
) -> Mixture:
    """The most probable plan under the joint density of plans, robot and people.

    Args:
        scenario: What is known now.
        belief: The people now, from a tracker of yours; None derives it from the tracks of those
            whom the robot sees.
        factors: Your own GTSAM factors on the variables of `fgplan.keys`.
        solver: `SecondOrder()` by default, which follows optima that could win or, where the
            inference gives an evidence, be a part of it; or `GtsamLM()`, GTSAM's own optimiser.
        select: `selection.height` (default) or `selection.mass`; both are always reported.
        hypotheses: Where the global plans come from; by default the routes to the goal, of which
            those are known that time allows to find, and what the operator points at and none of
            them leads to.
        warm: The previous plan, of an earlier `scenario.now`: its components, shifted in time,
            are starts beside the cold ones.
        deadline: Seconds from the call after which the best plan so far is returned; it says
            which hypotheses were finished and which were dropped.
        inference: What gives each hypothesis its evidence, and with it `probability_mass`: a
            method of `fgplan.inference`, or its name ("map", "laplace", "importance", "mcmc",
            "hmc") for its default settings. The deadline is for the solver and not for a sampler.
        seed: Of a sampler.
        progress: Told (what, done, total) by a sampler.
        check: The hard check of a trajectory: what no energy can buy.

    Returns:
        All hypotheses solved, the one to follow, and its next step. The result is the best local
        optimum found, not a proof of a global one.

    Raises:
        ScenarioError: the scenario makes no sense; all mistakes are named.
        NoRoute: a goal is stated and nothing leads there.
        NoPlan: no hypothesis has a finite posterior.
        ValueError: the deadline is negative or no number; no inference has that name, or it gives
            no evidence, by which to select was asked; the belief or a factor of yours makes no
            sense.
    """
    time = Deadline.until(deadline)
    inference = named(inference)
    if isinstance(inference, MAP) and select is selection.mass:
        raise ValueError("inference 'map' gives no evidence to select by; take another, or height")
    if solver is None:
        solver = SecondOrder(margin=0.0) if isinstance(inference, MAP) else SecondOrder()
    validate(scenario)
    d = scenario.density
    if belief is None:
        belief = believe(seen(scenario), scenario.now, d.Qc_people, d.sigma_track, d.sigma_speed)
    notes = [*_touched(scenario, belief)]
    if hypotheses is None:
        stated = tuple(operated(partial(hypothesise, until=time.routes))(scenario, belief))
        notes += _routes_missed(scenario, stated, time.routes)
    else:
        stated = tuple(hypotheses(scenario, belief))
    if not stated:
        raise NoPlan(f"hypotheses, {hypotheses!r}, gave none for {scenario.name!r}")
    scenario = of_people(obeying(scenario), belief)
    proposed = reweigh(scenario, crossed(scenario, stated))
    ready = perf_counter()

    assembly = Assembly(build(scenario, belief, proposed, factors))
    if (every := len(proposed)) > len(stated):  # a product of levels
        kept = worth_solving(assembly, proposed, solver, NEGLIGIBLE, time.end)
        proposed = tuple(proposed[i] for i in kept)
        assembly = Assembly([assembly.models[i] for i in kept])
    before = shifted(warm, scenario, belief) if warm is not None else ()
    modelled = perf_counter()
    solving = [
        Solving(scenario, belief, assembly, i, checker=check, until=time.end)
        for i in range(len(proposed))
    ]
    searched = search(
        assembly,
        proposed,
        solver,
        before,
        time.solving,
        lambda i, solution: solving[i].check(solution).fine,
        _held(scenario, belief, assembly, proposed),
    )
    solved = perf_counter()

    weighing = [replace(own, inference=inference, seed=seed, progress=progress) for own in solving]
    components = _components(weighing, proposed, searched, solved - modelled, time.weighing)
    if not components:
        labels = [h.label for h in proposed]
        raise NoPlan(f"none of {labels} has a finite posterior", searched.found)
    weighed = perf_counter()
    timing = {
        "hypotheses": ready - time.began,
        "model": modelled - ready,
        "solver": solved - modelled,
        "evidence": weighed - solved,
        "total": weighed - time.began,
    }
    scores, doubts = _scored(components, select, inference)
    mixture = _decide(scenario, belief, components, scores, timing)
    notes += _left(proposed, searched, every)
    return replace(mixture, warnings=(*sorted(notes), *doubts, *mixture.warnings))


def _routes_missed(scenario: Scenario, stated: Sequence[Hypothesis], until: float) -> Iterable[str]:
    """Whether the time for routes was over before as many were found as were asked for."""
    found, asked = len(stated) - len(scenario.plans), scenario.count
    if perf_counter() >= until and found < asked:
        yield f"{found} of {asked} routes found in the time for it"


def _left(proposed: Sequence[Hypothesis], searched: Search, every: int) -> Iterable[str]:
    """What was not followed to its end, in words.

    Args:
        proposed: What was solved.
        searched: How far.
        every: How many there were before bounds excluded some.
    """
    for i in searched.dropped:
        yield f"{proposed[i].label}: dropped, its bound cannot win"
    for i in searched.unfinished:
        yield f"{proposed[i].label}: not finished in time"
    if every > len(proposed):
        bound = f"their bounds are over {NEGLIGIBLE:g} nats below the best"
        yield f"{every - len(proposed)} of {every} combinations left out: {bound}"


def _components(
    solving: Sequence[Solving],
    hypotheses: Sequence[Hypothesis],
    searched: Search,
    seconds: float,
    until: float,
) -> list[Component]:
    """The hypotheses that have a finite posterior, those with one optimum as one.

    Args:
        solving: One per hypothesis.
        hypotheses: The same ones.
        searched: What was solved.
        seconds: That took [s].
        until: Evidence that is not begun by then is left out, on `time.perf_counter` [s].
    """
    total = sum(f.solution.iterations for f in searched.found) or 1
    incomplete = searched.unfinished | searched.dropped
    components = []
    for i, hypothesis in enumerate(hypotheses):
        own = [f for f in searched.found if f.which == i and np.isfinite(f.solution.energy)]
        if own:
            share = seconds * sum(f.solution.iterations for f in own) / total
            weigh = solving[i].inference if perf_counter() < until else MAP()
            reading = replace(solving[i], finished=i not in incomplete, inference=weigh)
            components.append(component_of(reading, hypothesis, own, share))
    return merge(components)


def _touched(scenario: Scenario, belief: Belief) -> Iterable[str]:
    """Whom the robot touches now: that no plan can avoid, nor does the hard check count it."""
    robot = scenario.robot
    gap = length(belief.mean[:, :2] - robot.position) - belief.radii - robot.radius
    for i in np.flatnonzero(gap < 0):
        yield f"in contact with {belief.names[i]} now, by {-gap[i]:.2f} m"


def _scored(
    components: Sequence[Component], select: selection.Rule, inference: Inference
) -> tuple[Array, tuple[str, ...]]:
    """Log scores of all, and what is to be said of them: by height where somebody has none because
    no time was left for their evidence."""
    scores = select(components)
    late = [
        c.label
        for c, score in zip(components, scores, strict=True)
        if not np.isfinite(score) and c.inferred is not None and c.inferred.method != inference.name
    ]
    if not late:
        return scores, ()
    return selection.height(components), (f"chosen by height: no time for the evidence of {late}",)


def _held(
    scenario: Scenario, belief: Belief, assembly: Assembly, hypotheses: Sequence[Hypothesis]
) -> Assembly | None:
    """The density with people held at their prediction, where people are variables, some
    hypothesis has starts to choose from, and no factor of the user's is on the people."""
    model = assembly.models[0]
    if "crowd" not in model.columns or all(len(h.starts) == 1 for h in hypotheses):
        return None
    if touches_crowd(model.extra, scenario.density.steps):
        return None
    return Assembly(build(scenario.replace(crowd="predicted"), belief, hypotheses, model.extra))


def _decide(
    scenario: Scenario,
    belief: Belief,
    components: list[Component],
    scores: Array,
    timing: dict[str, float],
) -> Mixture:
    order = np.argsort(-scores, kind="stable")
    components = [components[i] for i in order]
    probability_height = selection.softmax(selection.height(components))
    probability_mass = selection.softmax(selection.mass(components))
    finite = np.isfinite(scores[order])
    safe = [i for i, c in enumerate(components) if c.feasible and finite[i]]
    if safe:
        selected: int | None = safe[0]
        best = components[safe[0]]
        trajectory = best.robot
        reason = f"hypothesis {best.label}, from the start {best.start!r}"
        action = _action(scenario, "follow", trajectory, True, reason)
    else:
        selected = None
        predicted = People(
            scenario.density.times, belief.expected(scenario.density.times), belief.radii
        )
        trajectory, result = brake(scenario, predicted)
        why = "; ".join(
            f"{c.label}: {', '.join(c.check.problems) or 'no finite score'}" for c in components
        )
        if not result.feasible:
            why += f"; and no stop is clear: {', '.join(result.problems)}"
        reason = f"no hypothesis is safe ({why})"
        action = _action(scenario, "stop", trajectory, result.feasible, reason)
    return Mixture(
        name=scenario.name,
        now=scenario.now,
        components=tuple(components),
        probability_height=probability_height,
        probability_mass=probability_mass,
        selected=selected,
        trajectory=trajectory,
        action=action,
        timing=timing,
        warnings=tuple(_warnings(components, probability_height, probability_mass)),
    )


def _action(
    scenario: Scenario, kind: str, trajectory: Trajectory, safe: bool, reason: str
) -> Action:
    return Action(
        kind,
        float(trajectory.times[1]),
        trajectory.positions[1],
        trajectory.velocities[1],
        scenario.robot.model.twist(trajectory, 1, heading(scenario)),
        safe,
        reason,
    )


def _warnings(components: list[Component], height: Array, mass: Array) -> Iterable[str]:
    for c in components:
        if not c.converged:
            yield f"{c.label}: not a converged local optimum ({c.stop})"
        if c.inferred is not None:
            yield from (f"{c.label}: {c.inferred.method}: {d}" for d in c.inferred.warnings)
    if mass.any() and int(np.argmax(height)) != int(np.argmax(mass)):
        yield (
            f"height prefers {components[int(np.argmax(height))].label}, "
            f"mass prefers {components[int(np.argmax(mass))].label}"
        )
