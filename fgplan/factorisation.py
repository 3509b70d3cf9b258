"""Which couplings of a declared stack its mission needs, and what dropping each one costs.

Two answers side by side. The formal one: the independent parts of what is asked
(`fgplan.mission.parts`), where each lives in the stack, and which couplings lie on its way down to
the robot. The numerical one: the Kullback–Leibler divergence of the density from the one without
that coupling, with a Gaussian at the optimum (exact where everything is linear).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fgplan.assembly import Assembly
from fgplan.crowd import believe, seen
from fgplan.drawing import models
from fgplan.hypotheses import hypothesise
from fgplan.labels import AT_ONCE
from fgplan.measuring import Measurement
from fgplan.mission.parts import parts
from fgplan.model import Model
from fgplan.obeying import obeying, rules_now
from fgplan.scenario import Scenario
from fgplan.solver import SecondOrder
from fgplan.stack import ROBOT, Link, coupling_name, links, name_of, parent

Array = NDArray[np.float64]

GOAL = "the goal"


@dataclass(frozen=True)
class Held:
    """A part of what is asked, and where it lives.

    Args:
        text: The part: conjuncts of the mission, the goal, or a piece of data.
        levels: Names of the levels that hold it, "robot" among them where the robot does.
    """

    text: str
    levels: frozenset[str]


@dataclass(frozen=True)
class Coupling:
    """What one coupling is for.

    Args:
        above, below: Names of the levels it couples, or "robot".
        h: Its variance [m²].
        carries: The parts that come down to the robot through it.
        joins: Those of them that live below it as well: they couple the two levels. What else
            lives below is independent of what comes from above.
        divergence: Of the density from the one without it [nats]; inf where a level would be held
            by nothing, or where the optimum would be none: people and obstacles push away from it.
        divergence_robot: The same for the robot's motion alone [nats].
    """

    above: str
    below: str
    h: float
    carries: tuple[str, ...]
    joins: tuple[str, ...]
    divergence: float
    divergence_robot: float

    @property
    def needed(self) -> bool:
        """Whether what is asked needs it: without it, some part would not reach the robot."""
        return bool(self.carries)


@dataclass(frozen=True)
class Report:
    """A stack as its mission sees it.

    Args:
        hypothesis: Label of the one whose density was looked at.
        held: The independent parts.
        couplings: All of the stack.
    """

    hypothesis: str
    held: tuple[Held, ...]
    couplings: tuple[Coupling, ...]


def factorise(scenario: Scenario, hypothesis: str | None = None) -> Report:
    """The report of a scenario.

    Args:
        scenario: What is known now.
        hypothesis: Label of the hypothesis to look at; None: the first.

    Raises:
        ScenarioError, NoRoute, MissionError: as `fgplan.plan`.
        KeyError: there is no such hypothesis.
    """
    every = models(scenario)
    label = next(iter(every)) if hypothesis is None else hypothesis
    if label not in every:
        raise KeyError(f"hypothesis {label!r} is none of {', '.join(every)}")
    model = every[label]
    start = model.reference.copy()
    for (name, k), value in model.fixed.items():
        start[k, model.columns[name]] = value
    state = SecondOrder().solve(Assembly([model]), start[None], _ONE)[0].state
    held = _held(scenario)
    levels = scenario.levels
    couplings = []
    for link in links(levels):
        above, below = levels[link.above].name, name_of(levels, link.below)
        upper = {levels[i].name for i in _upwards(scenario, link.above)}
        lower = {name_of(levels, i) for i in _downwards(scenario, link)}
        carries = [part for part in held if part.levels & upper]
        both = [part.text for part in carries if part.levels & lower]
        whole, robot = divergence(model, state, coupling_name(levels, link))
        texts = tuple(part.text for part in carries)
        couplings.append(Coupling(above, below, link.h, texts, tuple(both), whole, robot))
    return Report(label, held, tuple(couplings))


def divergence(model: Model, state: Array, term: str) -> tuple[float, float]:
    """KL(p ‖ p without a term) of all variables and of the robot's motion alone [nats].

    Both densities are Gaussian at the given state: the second one after a Newton step, which is
    exact where the density is.

    Args:
        model: The density.
        state: Its optimum, shape (T + 1, D).
        term: Name of the hypothesis's own term to drop; a name that it does not have drops
            nothing.

    Returns:
        inf where no Gaussian is left without the term: nothing holds one of its variables, or the
        density curves the other way, as beside people, who push away.
    """
    without = replace(model, own=tuple(one for one in model.own if one.name != term))
    H, free, _ = _expanded(model, state)
    H2, _, gradient = _expanded(without, state)
    robot = np.zeros_like(model.reference, dtype=bool)
    robot[:, model.columns["robot"]] = True
    robot = robot.ravel()[free]
    linked = np.zeros_like(model.reference, dtype=bool)
    for name in _linked(without):
        linked[:, model.columns[name]] = True
    near = linked.ravel()[free]
    whole = _gaussian(H, H2, gradient)
    S = np.linalg.inv(H)
    rest = np.ix_(near, near)
    try:
        np.linalg.cholesky(H2[rest])
    except np.linalg.LinAlgError:
        return whole, np.inf
    S2 = np.linalg.inv(H2[rest])
    moved = -(S2 @ gradient[near])[robot[near]]
    one = np.ix_(robot, robot)
    two = np.ix_(robot[near], robot[near])
    P2 = np.linalg.inv(S2[two])
    return whole, _divergence(S[one], P2, moved)


_ONE = np.zeros(1, dtype=np.intp)


def _gaussian(H: Array, H2: Array, gradient: Array) -> float:
    try:
        np.linalg.cholesky(H2)
    except np.linalg.LinAlgError:
        return np.inf
    S, moved = np.linalg.inv(H), -np.linalg.solve(H2, gradient)
    return _divergence(np.asarray(S, dtype=float), H2, np.asarray(moved, dtype=float))


def _divergence(S: Array, P2: Array, moved: Array) -> float:
    """KL of N(μ, S) from N(μ + moved, P2⁻¹)."""
    product = P2 @ S
    log_ratio = float(np.linalg.slogdet(product)[1])
    square = float(moved @ P2 @ moved)
    return max(0.0, 0.5 * (float(np.trace(product)) - len(S) + square - log_ratio))


def _expanded(model: Model, state: Array) -> tuple[Array, NDArray[np.bool_], Array]:
    """True Hessian and gradient over what is not known exactly, and which coordinates those are."""
    assembly = Assembly([model])
    q = assembly.expand(state[None], _ONE)
    diagonal, upper = q.diagonal[0], q.upper[0]
    steps, D, _ = diagonal.shape
    H = np.zeros((steps, D, steps, D))
    for k in range(steps):
        H[k, :, k] = diagonal[k]
        if k + 1 < steps:
            H[k, :, k + 1], H[k + 1, :, k] = upper[k], upper[k].T
    free = assembly.free.ravel()
    size = steps * D
    return H.reshape(size, size)[np.ix_(free, free)], free, q.gradient[0].ravel()[free]


def _linked(model: Model) -> set[str]:
    """Variables that some chain of terms joins to the robot."""
    pairs = [{name for name, _ in term.variables} for term in model.terms]
    pairs += [
        {name for (name, _), key in model.keys.items() if key in set(factor.keys())}
        for factor in model.extra
    ]
    found = {"robot"}
    while new := {name for pair in pairs if pair & found for name in pair} - found:
        found |= new
    return found


def _upwards(scenario: Scenario, index: int) -> set[int]:
    """A level and all that guide it."""
    found, here = {index}, parent(scenario.levels, index)
    while here is not None:
        found.add(here)
        here = parent(scenario.levels, here)
    return found


def _downwards(scenario: Scenario, link: Link) -> set[int | None]:
    """What a coupling leads to: a level and all that it guides, the robot among them."""
    found: set[int | None] = {link.below}
    every = links(scenario.levels)
    while new := {other.below for other in every if other.above in found} - found:
        found |= new
    return found


def _held(scenario: Scenario) -> tuple[Held, ...]:
    """The independent parts of what is asked, and who holds them."""
    first = scenario.levels[0].name
    data = [(m.on or first, _subject(m)) for m in obeying(scenario).data]
    found: list[Held] = []
    told: set[str] = set()
    if scenario.mission is not None:
        shut = set() if scenario.grid is None else set(rules_now(scenario).forbidden)
        d = scenario.density
        belief = believe(seen(scenario), scenario.now, d.Qc_people, d.sigma_track, d.sigma_speed)
        visited = {name for h in hypothesise(scenario, belief) for name in _stops(h.label)}
        for part in parts(scenario.mission.formula):
            levels = {on for on, subject in data if subject in part.atoms}
            if part.atoms & visited:
                levels.add(first)
            if part.atoms & shut:  # an obstacle of the robot's
                levels.add(ROBOT)
            found.append(Held(str(part), frozenset(levels)))
            told |= part.atoms
    if scenario.goal is not None:
        found.append(Held(GOAL, frozenset([first])))
    plans = [level for level in scenario.levels[1:] if level.plans]
    found += [Held(f"the plans of {level.name}", frozenset([level.name])) for level in plans]
    rest: dict[str, set[str]] = {}
    for m in scenario.data:
        if _subject(m) not in told:
            rest.setdefault(_named(m), set()).add(m.on or first)
    return (*found, *(Held(text, frozenset(levels)) for text, levels in rest.items()))


def _stops(label: str) -> Sequence[str]:
    """The stops of an itinerary, by its label."""
    return [name for stop in label.split(" #")[0].split(">") for name in stop.split(AT_ONCE)]


def _subject(measurement: Measurement) -> str | None:
    """Name of the region that a piece of data speaks of."""
    region = getattr(measurement, "region", None)
    return None if region is None else region.name


def _named(measurement: Measurement) -> str:
    subject, kind = _subject(measurement), type(measurement).__name__
    return kind if subject is None else f"{kind} of {subject}"
