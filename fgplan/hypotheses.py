"""scenario → hypotheses: weighted, timed global plans with starts for each."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import Belief
from fgplan.hypothesis import Hypothesis
from fgplan.routes import find_routes
from fgplan.scenario import Scenario
from fgplan.starts import coast, starts
from fgplan.timing import path_length, timed
from fgplan.validation import MOST_STEPS

Array = NDArray[np.float64]


class _Path(NamedTuple):
    """A global plan before it has a weight: label, vertices (N, 2) [m], stated weight."""

    label: str
    vertices: Array
    weight: float | None


def hypothesise(scenario: Scenario, belief: Belief) -> tuple[Hypothesis, ...]:
    """The K global plans of a scenario: the user's, and the shortest of distinct homotopy classes.

    w_i = softmax(−beta J_i) with J_i the length of path i over the preferred speed. A stated
    weight replaces exp(−beta (J_i − min J)), so 1 is as good as the shortest path. Without goal
    and plans there is one hypothesis with no plan: the robot's prior alone.

    Raises:
        NoRoute: a goal is stated and nothing leads there.
    """
    paths = _paths(scenario)
    if not paths:
        return (_no_goal(scenario, belief),)
    robot, d = scenario.robot, scenario.density
    costs = np.array([path_length(path.vertices) for path in paths]) / robot.preferred_speed
    score = -d.beta * (costs - costs.min())
    for i, path in enumerate(paths):
        if path.weight is not None:
            with np.errstate(divide="ignore"):  # a weight of 0 excludes a plan
                score[i] = np.log(path.weight)
    log_prior = score - np.logaddexp.reduce(score)
    found = []
    for path, weight, cost in zip(paths, log_prior.tolist(), costs.tolist(), strict=True):
        if weight == -np.inf:
            continue
        follow = partial(
            timed,
            path.vertices,
            speed=robot.preferred_speed,
            acceleration=robot.max_acceleration,
            velocity=robot.velocity,
        )
        plan = follow(times=d.times)
        course = follow(times=_beyond(scenario, cost)) if scenario.data else None
        tries = starts(scenario, belief, plan, path.vertices)
        found.append(Hypothesis(path.label, weight, plan, cost, tries, path.vertices, course))
    return tuple(found)


def _beyond(scenario: Scenario, cost: float) -> Array:
    """Times from now to the end of a plan that takes about `cost` [s]: data may lie beyond the
    horizon. Four times as fine as the steps, and among them all steps."""
    d = scenario.density
    start_and_stop = 2 * scenario.robot.preferred_speed / scenario.robot.max_acceleration
    steps = max(d.steps, min(MOST_STEPS, int(np.ceil((cost + start_and_stop) / d.dt))))
    return np.concatenate(
        [(d.dt * np.arange(steps)[:, None] + d.dt / 4 * np.arange(4)).ravel(), [d.dt * steps]]
    )


def _no_goal(scenario: Scenario, belief: Belief) -> Hypothesis:
    """The robot's prior alone; it may still wait for people, or pass them on either side."""
    straight = coast(scenario)
    ahead = straight.positions[[0, -1]]
    return Hypothesis("no goal", 0.0, None, 0.0, starts(scenario, belief, straight, ahead))


def _paths(scenario: Scenario) -> list[_Path]:
    here = scenario.robot.position
    paths = []
    for given in scenario.plans:
        vertices = np.asarray(given.path, dtype=float)
        if not np.allclose(vertices[0], here, atol=1e-9):
            vertices = np.vstack([here, vertices])
        paths.append(_Path(given.label, vertices, given.weight))
    if scenario.goal is not None and scenario.count > 0:
        routes = find_routes(
            scenario.grid, here, scenario.goal, scenario.robot.radius, scenario.count
        )
        paths += [_Path(route.label, route.path, None) for route in routes]
    return paths
