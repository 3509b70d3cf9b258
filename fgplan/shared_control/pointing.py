"""New hypotheses where the operator points and none leads.

Data only weighs the hypotheses there are, and bends them within their width. Where a waypoint lies
off all of them, or a stick points where none of them goes, the operator wants something that is
not there yet: a route through the waypoint, the straight continuation of the stick. Where that
meets a wall it slides along it: the safe motion that is nearest to what is asked. The new
hypothesis is priced like any other; people in its way are the density's concern.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from factors.residual import whitener
from fgplan.crowd import Belief
from fgplan.errors import NoRoute
from fgplan.hypotheses import driven_along
from fgplan.hypothesis import Hypothesis
from fgplan.measuring import Reading
from fgplan.occupancy import OccupancyGrid
from fgplan.routes import find_routes
from fgplan.scenario import Scenario
from fgplan.starts import coast, starts
from fgplan.timing import arc_length, path_length, timed
from fgplan.trajectory import Trajectory

Array = NDArray[np.float64]
Source = Callable[[Scenario, Belief], Sequence[Hypothesis]]

STICK, ON, VIA = "stick", "on", "via waypoints"
"""Labels: the stick's straight continuation; on as now, where no goal is known; the route."""

LEADS = np.deg2rad(30)
"""A plan within this angle of the stick leads where it points."""
SPACING = 0.05
"""Of the points of a path along walls [m]."""
CLEARANCE = 0.05
"""What it keeps from them [m]."""
STILL = 1e-6
"""Who is slower than this rests [m/s]."""
SLOWEST = 0.1
"""A stick that asks for less than this share of the preferred speed points nowhere."""


class Lead(NamedTuple):
    """A hypothesis that is there already: its path (N, 2) [m] and its cost to go [s]."""

    path: Array
    cost: float


def operated(source: Source) -> Source:
    """A source of hypotheses, and beside its own those that the operator points at.

    Without data, and where no plans are to be generated (`Scenario.count` = 0 beside plans that
    are given), it is the source itself.
    """

    def hypotheses(scenario: Scenario, belief: Belief) -> Sequence[Hypothesis]:
        known = tuple(source(scenario, belief))
        if not scenario.data or (scenario.count == 0 and scenario.plans):
            return known
        known = tuple(h for h in known if h.plan is not None)
        leads = [Lead(h.route, h.cost) for h in known if h.route is not None]
        best = max((h.log_prior for h in known), default=0.0)
        via = path_via(scenario, leads)
        new = [
            replace(h, log_prior=h.log_prior + best) for h in pointed(scenario, belief, leads, via)
        ]
        found = (*known, *new)
        total = np.logaddexp.reduce([h.log_prior for h in found])
        return tuple(replace(h, log_prior=float(h.log_prior - total)) for h in found)

    return hypotheses


def pointed(
    scenario: Scenario, belief: Belief, leads: Sequence[Lead], via: Array | None
) -> tuple[Hypothesis, ...]:
    """Hypotheses for what the operator says and none of the known ones leads to.

    Their `log_prior` is −β (J − min J of the known ones), not normalised. Without a goal nothing
    is known: then going on as now is one more hypothesis.

    Args:
        scenario: What is known now, data among it.
        belief: The people.
        leads: What is known already.
        via: A path through the waypoints, as `path_via` finds it, where none of these is one.
    """
    found = []
    if scenario.goal is None and not leads:
        found.append(_going_on(scenario, belief))
    if via is not None:
        found.append(_followed(scenario, belief, VIA, via, _beyond_best(scenario, via, leads)))
    stick = stick_velocity(scenario)
    if stick is not None and not _leads(scenario, stick, leads):
        found.append(_continued(scenario, belief, stick, leads))
    return tuple(found)


def path_via(scenario: Scenario, leads: Sequence[Lead]) -> Array | None:
    """The shortest path through the waypoints that lie ahead, and on to the goal; None where
    there are none, a known path passes them all, or nothing leads there."""
    places = waypoints(scenario)
    if not places or any(_passes(lead.path, places) for lead in leads):
        return None
    stops = [*(np.asarray(place.value, dtype=float) for place in places)]
    if scenario.goal is not None:
        stops.append(scenario.goal)
    parts, here = [scenario.robot.position[None]], scenario.robot.position
    for stop in stops:
        try:
            route = find_routes(scenario.grid, here, stop, scenario.robot.radius, 1)[0]
        except NoRoute:  # reported where the data is admitted
            return None
        parts.append(route.path[1:])
        here = parts[-1][-1]
    return np.vstack(parts)


def waypoints(scenario: Scenario) -> tuple[Reading, ...]:
    """Positions ahead: those with a time from now on, by time, then those without one."""
    places = [
        reading
        for measurement in scenario.data
        for reading in measurement.readings
        if reading.quantity == "position"
    ]
    timed_ones = [p for p in places if p.time is not None and p.time >= scenario.now]
    return (
        *sorted(timed_ones, key=lambda p: p.time or 0.0),
        *(p for p in places if p.time is None),
    )


def stick_velocity(scenario: Scenario) -> Array | None:
    """The velocity that is wished for now, shape (2,) [m/s]; None where nobody holds a stick."""
    held = [
        reading
        for measurement in scenario.data
        for reading in measurement.readings
        if reading.quantity == "velocity"
        and reading.time is not None
        and reading.time >= scenario.now
    ]
    if not held:
        return None
    information = [np.linalg.inv(reading.covariance) for reading in held]
    pull = sum(
        (w @ reading.value for w, reading in zip(information, held, strict=True)), np.zeros(2)
    )
    velocity = np.linalg.solve(sum(information, np.zeros((2, 2))), pull)
    slow = SLOWEST * scenario.robot.preferred_speed
    return None if np.hypot(*velocity) < slow else np.asarray(velocity)


def _passes(path: Array, places: Sequence[Reading]) -> bool:
    """Whether a path comes within one standard deviation of every place."""
    s = arc_length(path)
    at = np.linspace(0.0, s[-1], 2 + int(s[-1] / 0.05))
    points = np.column_stack([np.interp(at, s, path[:, 0]), np.interp(at, s, path[:, 1])])
    for place in places:
        off = (points - place.value) @ whitener(place.covariance).T
        if np.linalg.norm(off, axis=1).min() > 1:
            return False
    return True


def _leads(scenario: Scenario, stick: Array, leads: Sequence[Lead]) -> bool:
    """Whether a known path goes where the stick points, one second's way ahead."""
    return any(_angle(scenario, stick, lead) < LEADS for lead in leads)


def _angle(scenario: Scenario, stick: Array, lead: Lead) -> float:
    s = arc_length(lead.path)
    ahead = min(scenario.robot.preferred_speed, float(s[-1]))
    step = np.array([np.interp(ahead, s, lead.path[:, i]) for i in (0, 1)]) - lead.path[0]
    length = float(np.hypot(*step) * np.hypot(*stick))
    return float(np.arccos(np.clip(step @ stick / length, -1, 1))) if length > 1e-9 else np.pi


def _beyond_best(scenario: Scenario, path: Array, leads: Sequence[Lead]) -> tuple[float, float]:
    """Cost of a path [s], and by how much it exceeds the best known one."""
    cost = path_length(path) / scenario.robot.preferred_speed
    return cost, cost - min((lead.cost for lead in leads), default=cost)


def _going_on(scenario: Scenario, belief: Belief) -> Hypothesis:
    plan, robot = coast(scenario), scenario.robot
    ahead = plan.positions[[0, -1]]
    moves = np.hypot(*robot.velocity) > STILL  # who rests in an obstacle slides along nothing
    grid = scenario.grid
    if moves and grid is not None and np.any(grid.clearance(plan.positions, 0.0) < 0):
        plan, ahead = _slid(scenario, robot.velocity)
    return Hypothesis(ON, 0.0, plan, 0.0, starts(scenario, belief, plan, ahead), ahead)


def _followed(
    scenario: Scenario, belief: Belief, label: str, path: Array, cost: tuple[float, float]
) -> Hypothesis:
    plan, course = driven_along(scenario, path, cost[0])
    score = -scenario.density.beta * cost[1]
    tries = starts(scenario, belief, plan, path)
    return Hypothesis(label, score, plan, cost[0], tries, path, course)


def _continued(
    scenario: Scenario, belief: Belief, stick: Array, leads: Sequence[Lead]
) -> Hypothesis:
    """Straight on where the stick points, at its speed.

    A second of it changes the way to the goal by 1 − cos of the angle to the best known path, to
    first order: that is what it costs beyond that path.
    """
    d = scenario.density
    plan, path = _slid(scenario, stick)
    best = min(leads, key=lambda lead: lead.cost, default=None)
    extra = 0.0 if best is None else 1 - float(np.cos(_angle(scenario, stick, best)))
    cost = extra + (0.0 if best is None else best.cost)
    tries = starts(scenario, belief, plan, path)
    return Hypothesis(STICK, -d.beta * extra, plan, cost, tries, path)


def _slid(scenario: Scenario, velocity: Array) -> tuple[Trajectory, Array]:
    """A velocity that is held for longer than the horizon, and along walls as far as it leads
    along them: the plan, and its path (N, 2)."""
    robot, d, grid = scenario.robot, scenario.density, scenario.grid
    speed = float(np.hypot(*velocity))
    ask = velocity / speed
    length = min(speed, robot.max_speed) * (d.horizon + 1.0)
    if grid is None:
        path = np.vstack([robot.position, robot.position + length * ask])
    else:
        points = [np.asarray(robot.position, dtype=float)]
        for _ in range(int(np.ceil(length / SPACING))):
            step = _free_step(grid, robot.radius, points[-1], SPACING * ask)
            if step is None:
                break
            points.append(points[-1] + step)
        path = np.array(points)
    along = path_length(path)
    # Along a wall it goes at the part of the speed that leads there, and in a corner it stands.
    reached = along >= 0.99 * length
    pace = max(min(speed, robot.max_speed) * min(along / length, 1.0), 0.05)
    end = pace if reached or along > pace * d.horizon else 0.0
    plan = timed(path, d.times, pace, robot.max_acceleration, robot.velocity, end_speed=end)
    return plan, path if len(path) > 1 else np.vstack([path, path])


def _free_step(grid: OccupancyGrid, radius: float, here: Array, step: Array) -> Array | None:
    """A step, or what of it leads along the wall; None where neither is free."""
    gap = grid.clearance(np.array([here, here + step]), radius)
    least = min(CLEARANCE, float(gap[0]))
    if gap[1] >= least:
        return step
    around = here + SPACING * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    east, west, north, south = grid.clearance(around, radius).tolist()
    away = np.array([east - west, north - south])
    if not away.any():
        return None
    away /= np.hypot(*away)
    aside = step - min(float(step @ away), 0.0) * away
    free = float(grid.clearance((here + aside)[None], radius)[0]) >= least - 0.2 * SPACING
    return aside if free and np.hypot(*aside) > 0.02 * SPACING else None
