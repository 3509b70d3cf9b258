"""The last word before anything moves: the command that will be executed, checked in tiers.

What is checked is not the plan but what the robot will do: the plan followed within its limits,
then, from the end of the control period, a stop. A command is *clear* when its trajectory touches
nobody over the look-ahead, and *stoppable* when, after one period, the robot can come to rest
before it touches a wall or anybody, each person grown by two standard deviations of where they may
be by then. The *room* of a command is by how many they can grow. Who stands is not at fault: that
is passive safety (Bouraine, Fraichard, Salhi, Autonomous Robots 32, 2012).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import Belief, heading
from fgplan.driving.meeting import gaps_of, moving, walls_of
from fgplan.safety import TOLERANCE, Check, People, allowed, check, contacts
from fgplan.scenario import Scenario
from fgplan.trajectory import Trajectory, length

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Tier(IntEnum):
    """How safe a command is, best first."""

    CLEAR = 0
    """A margin is kept along the whole plan, and the robot can stop."""
    TOUCHING_NOBODY = 1
    """Nobody is touched for as long as an escape is followed, and the robot can stop."""
    AVOIDING = 2
    """The same, by the nearest clear command that is stoppable, of those that keep the margin if
    any does; where none is stoppable, by the clear one with the most room, carried on or not."""
    PASSING = 3
    """No stop is clear, but to go on is: somebody is close behind or beside, or comes straight at
    the robot."""
    YIELDING = 4
    """No command keeps the margin, but the robot can be at rest before it is touched: of those with
    enough room the one whose contact would come latest, and after it a stop."""
    LATEST_CONTACT = 5
    """Nothing is clear: the command whose contact comes latest, and is the slightest; of those that
    leave room to stop before a wall, if any: people may make way, a wall will not."""


@dataclass(frozen=True)
class Guard:
    """What is asked of a command.

    Args:
        ahead: How far a plan is followed [s], at most to its end.
        escape: How far another command is followed, and a contact on the plan's own refuses it [s]:
            the next plan comes sooner.
        margin: Clearance from people that the first tier keeps [m].
        spacing: Between two looks along a trajectory [s].
        sigmas: The room that is asked for: by how many standard deviations of where they may be
            people grow while the robot brakes.
        most: But by no more than this [m].
        turn: Another command than the plan's is tried with a change to a third one after this [s]:
            there is often no straight way out of a crowd.
    """

    ahead: float = 5.0
    escape: float = 1.5
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
    """What M commands meet: the smallest gap to a person [m], the first contact [s], the room of
    a stop after a period (negative where somebody is touched who is where they are expected, −inf
    where a wall is in its way), and whether the margin is kept; each (M,)."""

    gap: Array
    contact: Array
    room: Array
    keeps: Mask


@dataclass(frozen=True, eq=False)
class _Own:
    """What the robot does when it follows a plan, states (1, S, dim), what it meets, and how safe
    that is."""

    states: Array
    found: _Fan
    tier: Tier


@dataclass(frozen=True, eq=False)
class Judge:
    """Judges the plans of one moment by what will be executed of them.

    Args:
        scenario: Map, robot and limits.
        belief: The people now.
        period: Until the next command [s].
        settings: See `Guard`.
        lag: Share of a period's change of velocity that the position lags behind: ½ when it is
            reached evenly, 0 when at once.
    """

    scenario: Scenario
    belief: Belief
    period: float
    settings: Guard = Guard()
    lag: float = 0.5
    _judged: dict[Trajectory, _Own] = field(default_factory=dict, repr=False)
    _commanded: dict[Trajectory, Guarded] = field(default_factory=dict, repr=False)

    def check(self, scenario: Scenario, robot: Trajectory, people: People) -> Check:
        """The hard check of a plan; its grade is the tier of its command: a `Checker`."""
        found = check(self.scenario, robot, people)
        return replace(found, grade=int(self._own(robot, people).tier))

    def command(self, plan: Trajectory, planned: People) -> Guarded:
        """The plan's command, if it is safe, else the safest one.

        Args:
            plan: What is wanted.
            planned: Where people are in that plan.
        """
        if plan not in self._commanded:
            own = self._own(plan, planned)
            if own.tier < Tier.AVOIDING:
                contact = float(own.found.contact[0])
                found = self._guarded(own.states[0], self._looks[0], own.tier, contact)
            else:
                found = self._escape(own)
            self._commanded[plan] = found
        return self._commanded[plan]

    def clear(self, way: Trajectory) -> Guarded | None:
        """A way among people as they are predicted, if all of it is clear as it would be driven:
        one for a robot that moves in any direction, as near to it as this one comes."""
        times, model = self._looks[0], self.scenario.robot.model
        people = People(times, self.belief.expected(times), self.belief.radii)
        lifted = model.lift(self.scenario.robot, self._now, way)
        states = self._followed(model.trajectory(way.times, lifted))
        if np.isfinite(self._look(states, times, people).contact[0]):
            return None
        return self._guarded(states[0], times, Tier.AVOIDING)

    def _escape(self, own: _Own) -> Guarded:
        """Another command than the plan's: the nearest clear one, else the least bad one."""
        whole, steps = self._looks
        times = whole[: max(steps, round(self.settings.escape / whole[1])) + 1]
        robot, model = self.scenario.robot, self.scenario.robot.model
        wishes = _wishes(model.commands(robot, self._now), times, self.settings)
        fan = model.driven(robot, self._now, wishes, times, self.lag)
        states = np.concatenate([own.states[:, : len(times)], fan])
        among = self._among(states, times)
        predicted = People(times, among.belief.expected(times), among.belief.radii)
        found = among._look(states, times, predicted)
        # By where they lead: a first velocity is soon nearer to none than to a detour's.
        apart = length(states[..., :2] - states[0, :, :2]).mean(axis=1)
        clear = np.isinf(found.contact)
        stoppable = clear & (found.room >= self.settings.sigmas)
        if stoppable.any():
            keeping = stoppable & found.keeps
            best = int(np.argmin(np.where(keeping if keeping.any() else stoppable, apart, np.inf)))
            return self._guarded(states[best], times, Tier.AVOIDING)
        tier, rest = self._left(found, clear)
        if tier is Tier.AVOIDING:
            gap = gaps_of(self.scenario, states[rest, :, :2], times, predicted)
            room = np.minimum(found.room[rest], among._room(gap, states[rest, :, :2], times))
            order = np.lexsort((apart[rest], -np.round(room, 1)))
        else:
            late = np.round(found.contact[rest], 1)
            # More room than enough is not worth a detour.
            enough = np.round(np.minimum(found.gap[rest], self.settings.most), 2)
            order = np.lexsort((apart[rest], -enough, -late))
        best = int(rest[order[0]])
        taken = states[best]
        if tier is Tier.YIELDING:
            still = np.zeros((1, len(times) - 1 - steps, 2))
            ahead = times[steps:] - times[steps]
            taken[steps:] = model.driven(robot, taken[None, steps], still, ahead, self.lag)[0]
        return self._guarded(taken, times, tier, float(found.contact[best]))

    def _left(self, found: _Fan, clear: Mask) -> tuple[Tier, NDArray[np.intp]]:
        """How safe a command can be where none is clear and stoppable, and which ones are that."""
        most = min(self.settings.sigmas, found.room.max())
        tiers = (
            (Tier.AVOIDING, clear & (found.room >= 0)),
            (Tier.PASSING, found.keeps),
            (Tier.YIELDING, found.room >= max(most, 0.0)),
            (Tier.PASSING, clear),
            (Tier.LATEST_CONTACT, found.room > -np.inf),
            (Tier.LATEST_CONTACT, np.ones_like(clear)),
        )
        return next((tier, np.flatnonzero(among)) for tier, among in tiers if among.any())

    def _among(self, states: Array, times: Array) -> Judge:
        """The same among those people alone whom M trajectories (M, S, dim), or stops on their
        way, can come near enough to that it matters."""
        robot, asked = self.scenario.robot, self.settings
        fastest = float(length(states[..., -2:]).max())
        stopped = self.period + fastest / robot.max_acceleration + 2 * times[1]
        until = np.arange(0.0, max(times[-1], stopped) + times[1], times[1])
        away = np.linalg.norm(self.belief.expected(until)[..., :2] - robot.position, axis=-1)
        gap = away - fastest * until[:, None] - (robot.radius + self.belief.radii)
        near = (gap < max(asked.margin, asked.most)).any(axis=0)
        return replace(self, belief=self.belief.select(np.flatnonzero(near)))

    @cached_property
    def _now(self) -> Array:
        return self.scenario.robot.model.state(self.scenario.robot, heading(self.scenario))

    @cached_property
    def _looks(self) -> tuple[Array, int]:
        """The times that are looked at, and the index of the end of the period among them."""
        steps = max(1, round(self.period / self.settings.spacing))
        dt = self.period / steps
        ahead = min(self.settings.ahead, float(self.scenario.density.times[-1]))
        last = max(steps, round(ahead / dt))
        return dt * np.arange(last + 1, dtype=float), steps

    def _own(self, plan: Trajectory, planned: People) -> _Own:
        """Judged once: what is checked is what will be commanded."""
        if plan not in self._judged:
            states = self._followed(plan)
            found = self._look(states, self._looks[0], planned)
            tier = Tier.CLEAR if found.keeps[0] else Tier.TOUCHING_NOBODY
            # Later contacts are for the hard check: following blindly drifts off the plan.
            stoppable = found.room[0] >= self.settings.sigmas
            if not stoppable or found.contact[0] <= self.settings.escape:
                tier = Tier.AVOIDING
            self._judged[plan] = _Own(states, found, tier)
        return self._judged[plan]

    def _followed(self, plan: Trajectory) -> Array:
        """What the robot does when it follows a plan, with one command in the first period; states
        (1, S, dim)."""
        robot, (times, steps) = self.scenario.robot, self._looks
        # Reached evenly, a command is the velocity at the end of a step; at once, the mean one.
        early = 0.5 - self.lag
        start = plan.times[0]
        wanted = robot.model.commands_of(plan.resampled(start + times[1:] - early * times[1]))
        first = plan.resampled(start + np.array([0.0, (1 - early) * times[steps]]))
        wanted[:steps] = robot.model.commands_of(first)[1]
        return robot.model.driven(robot, self._now, wanted[None], times, self.lag)

    def _guarded(self, states: Array, times: Array, tier: Tier, contact: float = np.inf) -> Guarded:
        trajectory = self.scenario.robot.model.trajectory(times, states)
        return Guarded(trajectory, self._looks[1], tier, contact)

    def _look(self, states: Array, times: Array, people: People) -> _Fan:
        """What M trajectories (M, S, dim) meet, and whether each can stop after a period."""
        gaps = gaps_of(self.scenario, states[..., :2], times, people)
        wall = walls_of(self.scenario, states[..., :2])
        touching = contacts(gaps).any(axis=-1) | contacts(wall[..., None])[..., 0]
        contact = np.where(touching.any(axis=1), times[np.argmax(touching, axis=1)], np.inf)
        nearest = gaps.min(axis=(1, 2), initial=np.inf)
        most = self.settings.margin
        margin = np.minimum(most, gaps[:, :1]) if gaps.shape[-1] else gaps[:, :1]
        keeps = np.isinf(contact) & np.all(gaps >= margin - 1e-6, axis=(1, 2))
        return _Fan(nearest, contact, self._room_to_stop(states), keeps)

    def _room_to_stop(self, states: Array) -> Array:
        """The room of M commands, shape (M,): of the stop after one period; −inf where a wall is
        in its way."""
        begun = states[:, : self._looks[1] + 1]
        _, first, alike = np.unique(
            begun.reshape(len(begun), -1), axis=0, return_index=True, return_inverse=True
        )
        return self._room_after(begun[first])[alike.ravel()]  # most differ only later

    def _room_after(self, states: Array) -> Array:
        """The room of the stop after each of M ways to drive one period (M, steps + 1, dim)."""
        times, steps = self._looks
        braked, stop = self._stops(states[:, steps])
        path = np.concatenate([states[:, : steps + 1, :2], stop[:, 1:, :2]], axis=1)
        when = np.append(times[: steps + 1], times[steps] + braked[1:])
        people = People(when, self.belief.expected(when), self.belief.radii)
        wall = walls_of(self.scenario, path)
        shut = contacts(wall[..., None])[..., 0] & moving(path)
        room = self._room(gaps_of(self.scenario, path, when, people), path, when)
        return np.where(shut.any(axis=1), -np.inf, room)

    def _stops(self, states: Array) -> tuple[Array, Array]:
        """Stops from M states (M, dim), until all are at rest, however long that takes: times (B,)
        from now on, and states (M, B, dim)."""
        robot, dt = self.scenario.robot, self._looks[0][1]
        # A state ends with the velocity, or with (v, ω): its length is the speed or more.
        braking = float(length(states[:, -2:]).max()) / robot.max_acceleration
        count = 2 + int(np.ceil(braking / dt))
        while True:
            times = dt * np.arange(count, dtype=float)
            still = np.zeros((len(states), count - 1, 2))
            stop = robot.model.driven(robot, states, still, times, 0.5)
            if not moving(stop[:, -2:, :2]).any():
                return times, stop
            count *= 2  # a car brakes no faster than its wheels straighten

    def _room(self, gap: Array, path: Array, times: Array) -> Array:
        """By how many standard deviations people may be nearer than expected before M robots on
        paths (M, S, 2) touch them, shape (M,); negative where they are touched as expected.

        Who stands is not at fault: contact counts while the robot moves. Nobody is asked for more
        than `Guard.most`, and nobody for more than there is now: to lead away from somebody near
        is always allowed, and who is in contact already must not come nearer.

        Args:
            gap: To the people, shape (M, S, n) [m].
        """
        covariance = self.belief.predict(times)[1]
        variance = covariance[..., 0, 0] - covariance[0, :, 0, 0]
        spread = np.sqrt(np.maximum(variance, 1e-12))
        least = allowed(gap)
        free = gap - least + TOLERANCE
        asked = np.maximum(np.minimum(gap[:, :1], self.settings.most), least)
        nearer = gap < asked - TOLERANCE
        room = np.where(nearer, free / spread, np.inf)
        nearest = room.min(axis=-1, initial=np.inf)
        return np.asarray(np.where(moving(path), nearest, np.inf).min(axis=1))


def _wishes(fan: Array, times: Array, settings: Guard) -> Array:
    """Commands over the look-ahead: each alone, and each with every fourth after a turn; shape
    (M, S − 1, 2)."""
    then = fan[::4]
    first = np.concatenate([fan, np.repeat(fan, len(then), axis=0)])
    second = np.concatenate([fan, np.tile(then, (len(fan), 1))])
    early = times[:-1, None] < settings.turn - 1e-9
    return np.where(early, first[:, None], second[:, None])
