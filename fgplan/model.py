"""scenario + hypothesis → the joint density: its terms, its GTSAM graph, its initial values.

Every line of `_shared_terms` and `_hypothesis_terms` is one factor of the density in the order of
`docs/density.md`. A term applies one residual to many time steps, so that a solver may evaluate
them in one call while GTSAM sees one factor a step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from operator import attrgetter

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.contact import Contact
from factors.coupling import coupling, coupling_to
from factors.flat import velocity_of_positions
from factors.gp_prior import (
    GPPrior,
    gaussian,
    isotropic_prior,
    matern_first,
    matern_prior,
    whitened,
)
from factors.interaction import Interaction
from factors.obstacle import InterpolatedObstacle, Obstacle
from factors.pairwise import CrowdPairs, PredictedPairs
from factors.residual import Residual, whiteners
from fgplan import keys
from fgplan.conditioning import LevelData, curved_pieces, on_level, robot_pieces
from fgplan.crowd import Belief, heading
from fgplan.gating import Gate, gate
from fgplan.hypothesis import Hypothesis, Start
from fgplan.robots import Piece
from fgplan.scenario import Density, Level, Scenario
from fgplan.stack import coupling_name, links
from fgplan.trajectory import Trajectory

Array = NDArray[np.float64]

OBSTACLE_SPACING = 0.25
"""Largest distance between two obstacle checks at full speed [m]."""


@dataclass(frozen=True)
class Variable:
    """A random trajectory: one GTSAM variable of size `dim` per time step."""

    name: str
    dim: int
    key: Callable[[int], int]


@dataclass(frozen=True, eq=False)
class Term:
    """One residual at every step of a range; `variables` are (name, offset from the step)."""

    name: str
    residual: Residual
    variables: tuple[tuple[str, int], ...]
    steps: range
    robots_own: bool = False
    """Whether it says how the robot moves: its prior and its limits."""


@dataclass(frozen=True, eq=False)
class Model:
    """The density given one hypothesis.

    States of all variables are one array (..., T + 1, D), variables side by side; `columns` says
    where each is.

    Args:
        times: t_k, shape (T + 1,) [s].
        variables: The random trajectories.
        shared: Terms that are the same for every hypothesis.
        own: Terms of this hypothesis: its plan.
        fixed: States known without error: (variable, step) → value.
        reference: A typical trajectory of all variables, shape (T + 1, D).
        lift: From a guess of the robot's trajectory to its states.
        read: From times and the robot's states to its trajectory, as it is driven.
        kinematic: From a count to draws of the robot's states from its own prior within its
            limits, shape (count, T + 1, dim); None where the robot has no model.
        within: Which of many trajectories of the robot's states (N, T + 1, dim) it can drive, shape
            (N,): what is sampled keeps its limits. None where the density has none.
        gate: Who is planned and who is held.
        people: Names of those in the crowd variable, in its order.
        extra: The user's own GTSAM factors.
    """

    times: Array
    variables: tuple[Variable, ...]
    shared: tuple[Term, ...]
    own: tuple[Term, ...]
    fixed: dict[tuple[str, int], Array]
    reference: Array
    lift: Callable[[Trajectory], Array] = attrgetter("states")
    read: Callable[[Array, Array], Trajectory] = Trajectory.from_states
    kinematic: Callable[[int, np.random.Generator], Array] | None = None
    within: Callable[[Array], NDArray[np.bool_]] | None = None
    gate: Gate | None = None
    people: tuple[str, ...] = ()
    extra: tuple[gtsam.NonlinearFactor, ...] = ()

    @cached_property
    def columns(self) -> dict[str, slice]:
        """Where each variable is in a state."""
        ends = np.cumsum([v.dim for v in self.variables])
        pairs = zip(self.variables, ends, strict=True)
        return {v.name: slice(int(end) - v.dim, int(end)) for v, end in pairs}

    @property
    def terms(self) -> tuple[Term, ...]:
        """All terms."""
        return self.shared + self.own

    @cached_property
    def keys(self) -> dict[tuple[str, int], int]:
        """GTSAM key of each (variable, step)."""
        steps = range(len(self.times))
        return {(v.name, k): v.key(k) for v in self.variables for k in steps}

    @cached_property
    def log_normalizer(self) -> float:
        """Σ of the log normalisers of all Gaussian densities in the product."""
        return sum(term.residual.log_normalizer * len(term.steps) for term in self.terms)

    @cached_property
    def log_normalizer_own(self) -> float:
        """The part of it that belongs to this hypothesis: that of p(η | i)."""
        return sum(term.residual.log_normalizer * len(term.steps) for term in self.own)

    def graph(self) -> gtsam.NonlinearFactorGraph:
        """The factor graph; its error is −log of the unnormalised density."""
        graph = gtsam.NonlinearFactorGraph()
        for term in self.terms:
            for i, k in enumerate(term.steps):
                on = [self.keys[name, k + offset] for name, offset in term.variables]
                graph.push_back(term.residual.at(i).on(*on))
        for (name, k), value in self.fixed.items():
            exact = gtsam.noiseModel.Constrained.All(len(value))
            graph.push_back(gtsam.PriorFactorVector(self.keys[name, k], value, exact))
        for factor in self.extra:
            graph.push_back(factor)
        return graph

    def values(self, state: Array) -> gtsam.Values:
        """A state (T + 1, D) as GTSAM values."""
        values = gtsam.Values()
        for (name, k), key in self.keys.items():
            values.insert(key, state[k, self.columns[name]])
        return values

    def state(self, values: gtsam.Values) -> Array:
        """GTSAM values as a state (T + 1, D)."""
        state = np.empty_like(self.reference)
        for (name, k), key in self.keys.items():
            state[k, self.columns[name]] = values.atVector(key)
        return state

    def trajectory(self, state: Array, name: str = "robot") -> Trajectory:
        """The robot's trajectory as it is driven, that of a random level, or that of a planned
        person by name, in a state (T + 1, D).

        Raises:
            ValueError: none of them has that name.
        """
        if name == "robot":
            return self.read(self.times, state[:, self.columns["robot"]])
        if name in self.people:
            n, i = len(self.people), self.people.index(name)
            flat = state[:, self.columns["crowd"]].reshape(len(self.times), 2, n, 2)
            return Trajectory(self.times, flat[:, 0, i], flat[:, 1, i])
        if name in self.columns and name != "crowd":
            return Trajectory.from_states(self.times, state[:, self.columns[name]])
        known = [v for v in self.columns if v != "crowd"] + list(self.people)
        raise ValueError(f"{name!r} is none of {known}")

    def initial(self, start: Start) -> Array:
        """The state to start from: the guess, and everything else as it is expected."""
        state = self.reference.copy()
        state[:, self.columns["robot"]] = self.lift(start.robot)
        n = len(self.people)
        for i, name in enumerate(self.people):
            if name in start.crowd:
                at = self.columns["crowd"].start + 2 * i
                state[:, at : at + 2] = start.crowd[name].positions
                state[:, at + 2 * n : at + 2 * n + 2] = start.crowd[name].velocities
        for (name, k), value in self.fixed.items():
            state[k, self.columns[name]] = value
        return state


def build(
    scenario: Scenario,
    belief: Belief,
    hypotheses: Sequence[Hypothesis],
    factors: Iterable[gtsam.NonlinearFactor] = (),
) -> tuple[Model, ...]:
    """One model per hypothesis; they share every term that does not depend on it.

    Args:
        scenario: What is known now.
        belief: The people in the density.
        hypotheses: Global plans.
        factors: The user's own GTSAM factors on `fgplan.keys`, added to every hypothesis.
    """
    extra = tuple(factors)
    if touches_crowd(extra, scenario.density.steps):
        # The user counts on all people being in the crowd variable.
        density = replace(scenario.density, reach=np.inf)
        scenario = scenario.replace(density=density)
    gate_ = gate(scenario, belief, hypotheses)
    planned, held = belief.select(gate_.planned), belief.select(gate_.held)
    vehicle = scenario.robot.model
    now = vehicle.state(scenario.robot, heading(scenario))
    lift = partial(vehicle.lift, scenario.robot, now)
    kinematic = partial(_kinematic, scenario, now)
    limited = np.isfinite(scenario.density.limit_sigma)
    within = partial(vehicle.within, scenario.robot, scenario.density.times) if limited else None
    robot = Variable("robot", vehicle.dim, keys.robot)
    crowd = (Variable("crowd", 4 * planned.count, keys.crowd),) if planned.count else ()
    shared = tuple(_shared_terms(scenario, planned, held, gate_))
    if all(h.plan is not None for h in hypotheses):
        shared += tuple(_curved_data(scenario))
    fixed = {}
    if scenario.robot.covariance is None:
        fixed["robot", 0] = now

    measured = {
        index: on_level(scenario, index, hypotheses)
        for index, level in enumerate(scenario.levels)
        if level.sigma > 0 and all(h.plan is not None for h in hypotheses)
    }
    models = []
    for i, hypothesis in enumerate(hypotheses):
        levels = _level_variables(scenario.levels, hypothesis)
        variables = (*levels.values(), robot, *crowd)
        parts = [_states(hypothesis, scenario.levels[index]) for index in levels]
        parts.append(lift(hypothesis.starts[0].robot))
        if planned.count:
            parts.append(_expected_crowd(planned, scenario.density.times))
        data = {index: of_level[i] for index, of_level in measured.items()}
        own = tuple(_hypothesis_terms(scenario, hypothesis, levels, data))
        reference, names = np.hstack(parts), planned.names
        read, times = vehicle.trajectory, scenario.density.times
        given = (times, variables, shared, own, fixed, reference, lift, read, kinematic)
        models.append(Model(*given, within, gate_, names, extra))
    return tuple(models)


def _kinematic(scenario: Scenario, now: Array, count: int, rng: np.random.Generator) -> Array:
    """Draws from the robot's own prior within its limits, from a state drawn where it is uncertain,
    shape (count, T + 1, dim)."""
    robot = scenario.robot
    if robot.covariance is not None:
        now = rng.multivariate_normal(now, robot.covariance, count, method="cholesky")
    return robot.model.sample(robot, scenario.density, now, count, rng)


def touches_crowd(factors: Iterable[gtsam.NonlinearFactor], steps: int) -> bool:
    """Whether some of the user's factors are on the people."""
    crowd = {keys.crowd(k) for k in range(steps + 1)}
    return any(key in crowd for factor in factors for key in factor.keys())


def _shared_terms(scenario: Scenario, planned: Belief, held: Belief, gate_: Gate) -> Iterable[Term]:
    d = scenario.density
    yield from _robot_prior(scenario)
    if planned.count:
        yield from _crowd_prior(planned, d)
        yield from _planned_people(scenario, planned, gate_)
    if held.count:
        yield from _held_people(scenario, held)
    yield from _obstacles(scenario)
    yield from _limits(scenario)


def _curved_data(scenario: Scenario) -> Iterable[Term]:
    """p(data_l | η_l) of random levels, as far as it is not linear; no hypothesis changes it."""
    for index, level in enumerate(scenario.levels):
        if level.sigma > 0:
            pieces = curved_pieces(scenario, index)
            yield from _along(pieces, scenario.density.steps, f"level {index}")


def _robot_prior(scenario: Scenario) -> Iterable[Term]:
    """p(f^R | z^R)."""
    d, robot = scenario.density, scenario.robot
    if robot.covariance is not None:
        now = gaussian(robot.model.state(robot, heading(scenario)), robot.covariance)
        yield Term("robot now", now, (("robot", 0),), range(1), robots_own=True)
    yield from _robots_own(robot.model.prior(d), d.steps)
    for piece in robot_pieces(scenario):
        on_model = piece._replace(residual=robot.model.on_plane(piece.residual))
        yield from _along((on_model,), d.steps)


def _crowd_prior(belief: Belief, d: Density) -> Iterable[Term]:
    """p(f | z^f): one GP an agent, conditioned on its track."""
    n = belief.count
    mean = np.concatenate([belief.mean[:, :2].ravel(), belief.mean[:, 2:].ravel()])
    person = np.arange(2 * n).reshape(n, 2)
    index = np.hstack([person, person + 2 * n])
    W = np.zeros((4 * n, 4 * n))
    W[index[:, :, None], index[:, None]] = whiteners(belief.covariance)
    yield Term("crowd now", whitened(mean, W), (("crowd", 0),), range(1))
    prior = isotropic_prior(d.dt, belief.Qc, 2 * n)
    yield Term("crowd prior", prior, (("crowd", 0), ("crowd", 1)), range(d.steps))


def _planned_people(scenario: Scenario, planned: Belief, gate_: Gate) -> Iterable[Term]:
    """ψ_int(f^R, f) and ψ_contact(f^R, f)."""
    d, n = scenario.density, planned.count
    on, steps = (("robot", 0), ("crowd", 0)), range(d.steps + 1)
    if d.alpha > 0:
        interaction = Interaction(d.alpha, d.h_c, d.exponent)
        pairs = CrowdPairs(interaction, n, gate_.pairs, scenario.robot.model.dim)
        yield Term("interaction", pairs, on, steps)
    if np.isfinite(d.contact_sigma):
        contact = _contact(scenario, planned)
        pairs = CrowdPairs(contact, n, "robot", scenario.robot.model.dim)
        yield Term("contact", pairs, on, steps)


def _held_people(scenario: Scenario, held: Belief) -> Iterable[Term]:
    """The same with people held at their prediction: what is not known of them widens ψ_int."""
    d, dim = scenario.density, scenario.robot.model.dim
    on, steps = (("robot", 0),), range(d.steps + 1)
    mean, covariance = held.predict(d.times)
    where = mean[..., :2]
    if d.alpha > 0:
        variance = np.trace(covariance[..., :2, :2], axis1=-2, axis2=-1) / 2
        interaction = Interaction(d.alpha, d.h_c, d.exponent, variance)
        pairs = PredictedPairs(interaction, where, dim)
        yield Term("interaction held", pairs, on, steps)
    if np.isfinite(d.contact_sigma):
        pairs = PredictedPairs(_contact(scenario, held), where, dim)
        yield Term("contact held", pairs, on, steps)


def _contact(scenario: Scenario, people: Belief) -> Contact:
    d = scenario.density
    reach = scenario.robot.radius + people.radii + d.contact_margin
    return Contact(reach, d.contact_sigma, d.exponent)


def _obstacles(scenario: Scenario) -> Iterable[Term]:
    """ψ_obs(f^R), at the states and between them."""
    d, robot = scenario.density, scenario.robot
    if scenario.grid is None or not np.isfinite(d.obstacle_sigma):
        return
    field = scenario.grid.distance_field
    shape = (field, robot.radius, d.obstacle_margin, d.obstacle_sigma)
    at_states = Obstacle(*shape, weight=d.exponent, dim=robot.model.dim)
    yield Term("obstacle", at_states, (("robot", 0),), range(1, d.steps + 1))
    # One at least, however short a step is: what a wall costs must not depend on dt.
    between = max(1, int(np.ceil(robot.max_speed * d.dt / OBSTACLE_SPACING)) - 1)
    checks = InterpolatedObstacle(*shape, d.dt, between, weight=d.exponent)
    on = (("robot", 0), ("robot", 1))
    yield Term("obstacle between", robot.model.on_plane(checks), on, range(d.steps))


def _limits(scenario: Scenario) -> Iterable[Term]:
    """What the robot can do."""
    d, robot = scenario.density, scenario.robot
    if np.isfinite(d.limit_sigma):
        yield from _robots_own(robot.model.limits(robot, d), d.steps)


def _robots_own(pieces: Iterable[Piece], T: int) -> Iterable[Term]:
    """What a robot model says."""
    for term in _along(pieces, T):
        yield replace(term, robots_own=True)


def _along(pieces: Iterable[Piece], T: int, variable: str = "robot") -> Iterable[Term]:
    """What is said of one trajectory, at the steps of the horizon."""
    for piece in pieces:
        on = tuple((variable, offset) for offset in piece.offsets)
        yield Term(piece.name, piece.residual, on, piece.steps(T))


def _level_variables(levels: Sequence[Level], hypothesis: Hypothesis) -> dict[int, Variable]:
    """The levels that are random: a level without width is the fixed plan."""
    if hypothesis.plan is None:
        return {}
    return {
        index: Variable(f"level {index}", 4, partial(keys.level, index))
        for index, level in enumerate(levels)
        if level.sigma > 0
    }


def _hypothesis_terms(
    scenario: Scenario,
    hypothesis: Hypothesis,
    variables: dict[int, Variable],
    data: dict[int, LevelData],
) -> Iterable[Term]:
    """Π_l p(η_l | i) p(data_l | η_l) and Π_l ψ(η_l, η_{l+1}), the last with f^R."""
    if hypothesis.plan is None:
        return
    d, T = scenario.density, scenario.density.steps
    for index, variable in variables.items():
        level, name = scenario.levels[index], variable.name
        pair, known = ((name, 0), (name, 1)), data[index].now
        if known is not None:
            yield Term(f"{level.name} now", known, ((name, 0),), range(1))
        yield from _level_prior(level, _states(hypothesis, level), d, pair, known is None)
        yield from _along(data[index].pieces, T, name)
    yield from _couplings(scenario, hypothesis, variables)


def _level_prior(
    level: Level, mean: Array, d: Density, pair: tuple[tuple[str, int], ...], first: bool
) -> Iterable[Term]:
    """p(η_l | i): around its plan, smooth, or flat; `first` asks for the prior of its state now."""
    T, Qc = d.steps, (d.Qc_robot if level.Qc is None else level.Qc) * np.eye(2)
    label = f"{level.name} prior"
    if np.isfinite(level.sigma):
        if first:
            now = matern_first(mean[0], level.sigma, level.length)
            yield Term(f"{level.name} now", now, pair[:1], range(1))
        yield Term(label, matern_prior(mean, d.dt, level.sigma, level.length), pair, range(T))
    elif level.Qc is not None:
        yield Term(label, GPPrior(d.dt, Qc), pair, range(T))
    else:
        yield Term(label, velocity_of_positions(d.dt, Qc), pair, range(T))
        last = velocity_of_positions(d.dt, Qc, last=True)
        yield Term(f"{level.name} last prior", last, pair, range(T - 1, T))


def _couplings(
    scenario: Scenario, hypothesis: Hypothesis, variables: dict[int, Variable]
) -> Iterable[Term]:
    """ψ for every link of the stack; a side without width is its plan. Two fixed sides are a
    constant, which is part of the hypothesis's weight (`fgplan.products`)."""
    d, levels = scenario.density, scenario.levels
    for link in links(levels):
        above = variables.get(link.above)
        below = None if link.below is None else variables.get(link.below)
        size = scenario.robot.model.dim if link.below is None else 4
        steps = range(0, d.steps + 1, link.every)
        weight, chosen = link.every * d.exponent, slice(None, None, link.every)
        label = coupling_name(levels, link)
        free = "robot" if link.below is None else None if below is None else below.name
        if above is not None and free is not None:
            psi = coupling(link.h, (4, size), weight=weight)
            yield Term(label, psi, ((above.name, 0), (free, 0)), steps)
        elif free is not None:
            path = _states(hypothesis, levels[link.above])[chosen, :2]
            yield Term(label, coupling_to(path, link.h, size, weight=weight), ((free, 0),), steps)
        elif above is not None and link.below is not None:
            path = _states(hypothesis, levels[link.below])[chosen, :2]
            psi = coupling_to(path, link.h, 4, weight=weight)
            yield Term(label, psi, ((above.name, 0),), steps)


def _states(hypothesis: Hypothesis, level: Level) -> Array:
    plan = hypothesis.plan_of(level.name)
    assert plan is not None
    return plan.states


def _expected_crowd(belief: Belief, times: Array) -> Array:
    """The people's prediction as crowd states, shape (T + 1, 4n)."""
    mean = belief.expected(times)
    flat = mean.reshape(len(times), belief.count, 2, 2)
    return np.asarray(np.swapaxes(flat, 1, 2).reshape(len(times), -1))
