"""The last word before anything moves: the command that will be executed, checked in tiers.

What is checked is not the plan but what the robot will do: the plan followed within its limits,
then, from the end of the control period, a stop. A command is *clear* when its trajectory touches
nobody over the look-ahead, and *stoppable* when, after one period, the robot can come to rest
before it touches a wall or anybody, each person grown by two standard deviations of where they may
be by then.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import Belief, heading
from fgplan.safety import People
from fgplan.scenario import Scenario
from fgplan.trajectory import Trajectory, hermite

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Tier(IntEnum):
    """How safe a command is, best first."""

    CLEAR = 0
    """A margin is kept over the look-ahead, and the robot can stop."""
    TOUCHING_NOBODY = 1
    """Nobody is touched over the look-ahead, and the robot can stop."""
    AVOIDING = 2
    """The same, by another command than the plan's: the nearest one, of those that keep the margin
    if any does."""
    LATEST_CONTACT = 3
    """Nothing is clear: the command whose contact comes latest, and is the slightest."""


@dataclass(frozen=True)
class Guard:
    """What is asked of a command.

    Args:
        ahead: How far commands are followed [s].
        margin: Clearance from people that the first tier keeps [m].
        spacing: Between two looks along a trajectory [s].
        sigmas: By how many standard deviations of where they may be people grow while the robot
            brakes.
        most: But by no more than this [m].
        turn: Another command than the plan's is tried with a change to a third one after this [s]:
            there is often no straight way out of a crowd.
    """

    ahead: float = 1.5
    margin: float = 0.1
    spacing: float = 0.05
    sigmas: float = 2.0
    most: float = 0.3
    turn: float = 0.5


@dataclass(frozen=True, eq=False)
class Guarded:
    """The command that is safe to give.

    Args:
        trajectory: What the robot does: the command, carried on over the look-ahead.
        step: Index of the end of the control period in it.
        tier: How safe it is.
        contact: When it touches somebody or something, inf if never [s].
    """

    trajectory: Trajectory
    step: int
    tier: Tier
    contact: float


@dataclass(frozen=True, eq=False)
class _Fan:
    """What M commands meet: the smallest gap to a person [m], the first contact [s], whether the
    robot can stop after a period, and whether the margin is kept; each (M,)."""

    gap: Array
    contact: Array
    stoppable: Mask
    keeps: Mask


def guard(
    scenario: Scenario,
    belief: Belief,
    plan: Trajectory,
    planned: People,
    period: float,
    settings: Guard,
    lag: float = 0.5,
) -> Guarded:
    """The plan's command, if it is safe, else the safest one.

    Args:
        scenario: Map, robot and limits.
        belief: The people now.
        plan: What is wanted.
        planned: Where people are in that plan.
        period: Until the next command [s].
        settings: See `Guard`.
        lag: Share of a period's change of velocity that the position lags behind: ½ when it is
            reached evenly, 0 when at once.
    """
    robot, model = scenario.robot, scenario.robot.model
    now = model.state(robot, heading(scenario))
    times, steps = _looks(period, settings)
    own = _followed(scenario, plan, times, steps, lag)
    found = _look(scenario, belief, own, times, steps, planned, settings)
    tier = _tier(found)
    if tier <= Tier.TOUCHING_NOBODY:
        return _guarded(scenario, own[0], times, steps, tier, np.inf)

    predicted = People(times, belief.predict(times)[0], belief.radii)
    wishes = _wishes(model.commands(robot, now), times, settings)
    states = model.driven(robot, now, wishes, times, lag)
    others = _look(scenario, belief, states, times, steps, predicted, settings)
    first = np.linalg.norm(_reached(states, steps) - _reached(own, steps), axis=1)
    clear = others.stoppable & np.isinf(others.contact)
    if clear.any():
        keeping = clear & others.keeps
        best = int(np.argmin(np.where(keeping if keeping.any() else clear, first, np.inf)))
        return _guarded(scenario, states[best], times, steps, Tier.AVOIDING, np.inf)
    states, first = np.concatenate([own, states]), np.append(0.0, first)
    contact = np.append(found.contact, others.contact)
    gap, stops = np.append(found.gap, others.gap), np.append(found.stoppable, others.stoppable)
    # Contact latest; of those, who can stop, then who keeps the larger gap, then the plan's.
    order = np.lexsort((first, -np.round(gap, 2), ~stops, -np.round(contact, 1)))
    best = int(order[0])
    return _guarded(scenario, states[best], times, steps, Tier.LATEST_CONTACT, float(contact[best]))


def tier_of(
    scenario: Scenario,
    belief: Belief,
    plan: Trajectory,
    planned: People,
    period: float,
    settings: Guard,
    lag: float = 0.5,
) -> Tier:
    """How safe a plan's own command is; `AVOIDING` where another one must be looked for.

    Args: as of `guard`.
    """
    times, steps = _looks(period, settings)
    own = _followed(scenario, plan, times, steps, lag)
    return _tier(_look(scenario, belief, own, times, steps, planned, settings))


def _wishes(fan: Array, times: Array, settings: Guard) -> Array:
    """Commands over the look-ahead: each alone, and each with every fourth after a turn; shape
    (M, S − 1, 2)."""
    then = fan[::4]
    first = np.concatenate([fan, np.repeat(fan, len(then), axis=0)])
    second = np.concatenate([fan, np.tile(then, (len(fan), 1))])
    early = times[:-1, None] < settings.turn - 1e-9
    return np.where(early, first[:, None], second[:, None])


def _looks(period: float, settings: Guard) -> tuple[Array, int]:
    """The times that are looked at, and the index of the end of the period among them."""
    steps = max(1, round(period / settings.spacing))
    dt = period / steps
    return dt * np.arange(max(steps, round(settings.ahead / dt)) + 1, dtype=float), steps


def _followed(scenario: Scenario, plan: Trajectory, times: Array, steps: int, lag: float) -> Array:
    """What the robot does when it follows a plan, with one command in the first period; states
    (1, S, dim)."""
    robot, model = scenario.robot, scenario.robot.model
    # Reached evenly, a command is the velocity at the end of a step; reached at once, the mean one.
    early = 0.5 - lag
    start = plan.times[0]
    wanted = model.commands_of(plan.resampled(start + times[1:] - early * times[1]))
    first = plan.resampled(start + np.array([0.0, (1 - early) * times[steps]]))
    wanted[:steps] = model.commands_of(first)[1]
    now = model.state(robot, heading(scenario))
    return model.driven(robot, now, wanted[None], times, lag)


def _tier(found: _Fan) -> Tier:
    if not found.stoppable[0] or np.isfinite(found.contact[0]):
        return Tier.AVOIDING
    return Tier.CLEAR if found.keeps[0] else Tier.TOUCHING_NOBODY


def _reached(states: Array, step: int) -> Array:
    """The commands (M, 2) that are reached at the end of the period: the end of a state."""
    return states[:, step, -2:]


def _guarded(
    scenario: Scenario, states: Array, times: Array, step: int, tier: Tier, contact: float
) -> Guarded:
    trajectory = scenario.robot.model.trajectory(times, states)
    return Guarded(trajectory, step, tier, contact)


def _look(
    scenario: Scenario,
    belief: Belief,
    states: Array,
    times: Array,
    steps: int,
    people: People,
    settings: Guard,
) -> _Fan:
    """What M trajectories (M, S, dim) meet, and whether each can stop after a period."""
    gaps = _gaps(scenario, states[..., :2], times, people)
    wall = _walls(scenario, states[..., :2])
    allowed = np.minimum(gaps[:, :1], 0.0) - 1e-6
    touching = np.any(gaps < allowed, axis=-1) if gaps.shape[-1] else np.zeros(wall.shape, bool)
    touching |= wall < np.minimum(wall[:, :1], 0.0) - 1e-6
    contact = np.where(touching.any(axis=1), times[np.argmax(touching, axis=1)], np.inf)
    nearest = gaps.min(axis=(1, 2), initial=np.inf)
    margin = np.minimum(settings.margin, gaps[:, :1]) if gaps.shape[-1] else gaps[:, :1]
    keeps = np.isinf(contact) & np.all(gaps >= margin - 1e-6, axis=(1, 2))

    stoppable = _stoppable(scenario, belief, states, times, steps, settings)
    return _Fan(nearest, contact, stoppable, keeps)


def _stoppable(
    scenario: Scenario, belief: Belief, states: Array, times: Array, steps: int, settings: Guard
) -> Mask:
    """Whether M robots, after one period, come to rest before they touch anybody, shape (M,).

    Who stands is not at fault: contact counts while the robot moves.
    """
    robot = scenario.robot
    still = np.zeros((len(states), len(times) - 1, 2))
    stop = robot.model.driven(robot, states[:, steps], still, times, 0.5)
    path = np.concatenate([states[:, : steps + 1, :2], stop[:, 1:, :2]], axis=1)
    when = np.append(times[: steps + 1], times[steps] + times[1:])
    moved = np.linalg.norm(np.diff(path, axis=1), axis=-1) > 1e-4
    moving = np.concatenate([moved[:, :1], moved], axis=1)
    mean, covariance = belief.predict(when)
    variance = np.maximum(covariance[..., 0, 0] - covariance[0, :, 0, 0], 0.0)
    grown = belief.radii + np.minimum(settings.sigmas * np.sqrt(variance), settings.most)
    apart = np.linalg.norm(path[:, :, None] - mean[None, :, :, :2], axis=-1)
    reach = apart - (robot.radius + grown)
    hit = np.any(reach < np.minimum(reach[:, :1], 0.0) - 1e-6, axis=-1)
    wall = _walls(scenario, path)
    hit |= wall < np.minimum(wall[:, :1], 0.0) - 1e-6
    return np.asarray(~np.any(hit & moving, axis=1))


def _gaps(scenario: Scenario, path: Array, times: Array, people: People) -> Array:
    """Between M robots (M, S, 2) and n people, shape (M, S, n) [m]."""
    if not people.states.shape[1]:
        return np.full((*path.shape[:2], 0), np.inf)
    where, _ = hermite(people.times, people.states[..., :2], people.states[..., 2:], times)
    apart = np.linalg.norm(path[:, :, None] - where[None], axis=-1)
    return np.asarray(apart - (scenario.robot.radius + people.radii))


def _walls(scenario: Scenario, path: Array) -> Array:
    """Gap to the map along M paths (M, S, 2), shape (M, S) [m]."""
    if scenario.grid is None:
        return np.full(path.shape[:2], np.inf)
    return scenario.grid.clearance(path, scenario.robot.radius)
