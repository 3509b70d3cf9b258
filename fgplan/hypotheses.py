"""scenario → hypotheses: weighted, timed global plans with starts for each."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import Belief
from fgplan.errors import NoMissionRoute
from fgplan.hypothesis import Hypothesis
from fgplan.mission import Itinerary, Mission, itineraries
from fgplan.regions import word_along
from fgplan.routes import find_routes
from fgplan.scenario import Scenario
from fgplan.starts import coast, starts
from fgplan.timing import path_length, timed
from fgplan.trajectory import Trajectory
from fgplan.validation import MOST_STEPS

Array = NDArray[np.float64]


class _Path(NamedTuple):
    """A global plan before it has a weight.

    Args:
        label: Its name.
        vertices: Shape (N, 2) [m].
        weight: As stated; None: from its cost.
        stop: Index of the vertex at which it comes to rest: the first stop of a mission.
    """

    label: str
    vertices: Array
    weight: float | None
    stop: int | None = None


def log_weights(costs: Any, beta: float, stated: Sequence[float | None] = ()) -> Array:
    """log w_i of w = softmax(−beta J); a stated weight replaces exp(−beta (J_i − min J)).

    Args:
        costs: J_i, shape (K,) [s].
        beta: Nats per second.
        stated: A weight, or None, for each; empty: for none. 0 excludes.
    """
    costs = np.asarray(costs, dtype=float)
    score = -beta * (costs - costs.min())
    for i, weight in enumerate(stated):
        if weight is not None:
            with np.errstate(divide="ignore"):
                score[i] = np.log(weight)
    return np.asarray(score - np.logaddexp.reduce(score))


def hypothesise(
    scenario: Scenario, belief: Belief, until: float = np.inf
) -> tuple[Hypothesis, ...]:
    """The K global plans of a scenario: the user's, and the shortest of distinct homotopy classes.

    w_i = softmax(−beta J_i) with J_i the length of path i over the preferred speed. A stated
    weight replaces exp(−beta (J_i − min J)), so 1 is as good as the shortest path. Without goal
    and plans there is one hypothesis with no plan: the robot's prior alone.

    With a mission they are its K best itineraries: J_i is the time of all that is still to do, and
    the timed plan comes to rest at the first stop, where the mission will be read again. A stated
    plan that the mission does not accept has weight 0.

    Args:
        scenario: What is known now.
        belief: The people.
        until: As of `find_routes`; itineraries of a mission are not broken off.

    Raises:
        NoRoute: a goal is stated and nothing leads there; `NoMissionRoute` where nothing on this
            map does what the mission still requires.
        MissionError: a name in the mission is no region or fact.
    """
    paths = _paths(scenario, until)
    if not paths:
        return (_no_goal(scenario, belief),)
    if all(path.weight == 0 for path in paths):
        raise NoMissionRoute(
            f"every stated plan that does what the mission requires has weight 0: "
            f"{[path.label for path in paths]}; give one of them a weight, or ask for a count"
        )
    robot, d = scenario.robot, scenario.density
    costs = np.array([path_length(path.vertices) for path in paths]) / robot.preferred_speed
    log_prior = log_weights(costs, d.beta, [path.weight for path in paths])
    found = []
    for path, weight, cost in zip(paths, log_prior.tolist(), costs.tolist(), strict=True):
        if weight == -np.inf:
            continue
        ahead = path.vertices if path.stop is None else path.vertices[: path.stop + 1]
        end_speed = scenario.goal_speed if path.stop is None else 0.0
        plan, course = driven_along(scenario, ahead, cost, end_speed)
        tries = starts(scenario, belief, plan, ahead)
        found.append(Hypothesis(path.label, weight, plan, cost, tries, path.vertices, course))
    return tuple(found)


def driven_along(
    scenario: Scenario, path: Array, cost: float, end_speed: float = 0.0
) -> tuple[Trajectory, Trajectory | None]:
    """A path (N, 2) as the robot would drive it: at the steps, and at the times of data where there
    is any. It takes about `cost` [s] and is left with `end_speed` [m/s]."""
    robot = scenario.robot
    follow = partial(
        timed,
        path,
        speed=robot.preferred_speed,
        acceleration=robot.max_acceleration,
        velocity=robot.velocity,
        end_speed=end_speed,
    )
    course = follow(times=times_of_data(scenario, cost)) if scenario.data else None
    return follow(times=scenario.density.times), course


def times_of_data(scenario: Scenario, cost: float) -> Array:
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


def _paths(scenario: Scenario, until: float) -> list[_Path]:
    here = scenario.robot.position
    paths = []
    for given in scenario.plans:
        vertices = np.asarray(given.path, dtype=float)
        if not np.allclose(vertices[0], here, atol=1e-9):
            vertices = np.vstack([here, vertices])
        if scenario.mission is None or _accepted(scenario, scenario.mission, vertices):
            paths.append(_Path(given.label, vertices, given.weight))
    if scenario.mission is not None and (scenario.count > 0 or not paths):
        paths += [_visiting(one) for one in itineraries_of(scenario, max(scenario.count, 1))]
    elif scenario.goal is not None and scenario.count > 0:
        routes = find_routes(
            scenario.grid, here, scenario.goal, scenario.robot.radius, scenario.count, until
        )
        paths += [_Path(route.label, route.path, None) for route in routes]
    return paths


def _accepted(scenario: Scenario, mission: Mission, path: Array) -> bool:
    """Whether a mission is done at the end of a path."""
    for letter in word_along(scenario.regions, path):
        mission = mission.advance(letter)
    return mission.done


def _visiting(itinerary: Itinerary) -> _Path:
    stop = itinerary.ends[0] if itinerary.ends else None
    return _Path(itinerary.label, itinerary.path, None, stop)


def itineraries_of(
    scenario: Scenario, count: int, first: int | None = None
) -> tuple[Itinerary, ...]:
    """At most `count` itineraries of a scenario with a mission, from where the robot is; `first` as
    in `fgplan.mission.itineraries`.

    Raises:
        NoMissionRoute, MissionError: as `hypothesise`.
        ValueError: the scenario has no mission.
    """
    if scenario.mission is None:
        raise ValueError(f"scenario {scenario.name!r} has no mission")
    return itineraries(
        scenario.mission,
        scenario.grid,
        scenario.regions,
        scenario.robot.position,
        scenario.robot.radius,
        count,
        scenario.goal,
        first,
    )
