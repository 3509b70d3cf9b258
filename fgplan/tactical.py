"""Tactical data τ: what is known of a level (or of the robot) that is no reading.

Each is a `Measurement`: it goes into `Scenario.data`, or into `[[tactics]]` of a scenario file.
Potentials that hold over a while carry the exponent dt/t_ref of the density's other potentials;
events at one time do not.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from factors.arrival import Arrival
from factors.formation import formation
from factors.keep_in import KeepIn as KeepInFactor
from factors.keep_out import KeepOut as KeepOutFactor
from factors.passing_side import PassingSide
from factors.residual import Residual
from factors.speed_zone import SpeedZone as SpeedZoneFactor
from factors.stay_behind import StayBehind as StayBehindFactor
from fgplan.crowd import Belief
from fgplan.measuring import Measurement, Reading
from fgplan.regions import Region
from fgplan.robots import Piece
from fgplan.scenario import Scenario
from fgplan.trajectory import Trajectory

Array = NDArray[np.float64]

SLOWEST = 0.05
"""Who is slower than this has no direction [m/s]."""


@runtime_checkable
class OfPeople(Measurement, Protocol):
    """A measurement that speaks of somebody, who must be found among the people first."""

    def among(self, belief: Belief, times: Array) -> Measurement:
        """The same with what is known of that person; unchanged where nobody is known."""
        ...


def of_people(scenario: Scenario, belief: Belief) -> Scenario:
    """The scenario with all data that speaks of people bound to their prediction."""
    if not any(isinstance(m, OfPeople) for m in scenario.data):
        return scenario
    times = scenario.density.times
    bound = [m.among(belief, times) if isinstance(m, OfPeople) else m for m in scenario.data]
    return scenario.replace(data=tuple(bound))


@dataclass(frozen=True, eq=False, kw_only=True)
class _Tactic:
    """What all have: no readings, and what they measure."""

    readings: ClassVar[tuple[Reading, ...]] = ()

    on: str | None = None
    sigma: float = 0.1
    t_ref: float | None = 0.4

    def _weight(self, times: Array) -> float:
        dt = float(times[1] - times[0])
        return 1.0 if self.t_ref is None else dt / self.t_ref

    def _name(self) -> str:
        return type(self).__name__

    def _held(
        self, residual: Residual, now: float, times: Array, begins: float, ends: float
    ) -> Iterator[Piece]:
        """One residual at all steps of a while."""
        within = np.flatnonzero((now + times >= begins - 1e-9) & (now + times <= ends + 1e-9))
        within = within[within > 0]  # what is now cannot be changed
        if len(within):
            yield Piece(self._name(), residual, (0,), int(within[0]), int(within[-1]))


@dataclass(frozen=True, eq=False)
class KeepOut(_Tactic):
    """Stay out of a region.

    Args:
        region: Out of which.
        margin: Distance from it, e.g. the robot's radius [m].
        begins, ends: While [s]; by default always.
        on: Of this and of all tactical data: level that is measured, or "robot"; None: the first.
        sigma: The same: how hard it is [m].
        t_ref: The same: as `Density.t_ref` [s].
    """

    region: Region
    margin: float = 0.3
    begins: float = -np.inf
    ends: float = np.inf

    def pieces(self, now: float, times: Array) -> Iterable[Piece]:
        """One factor a step, while it holds."""
        shape = self.region.shape
        residual = KeepOutFactor(shape, self.margin, self.sigma, self._weight(times))
        return self._held(residual, now, times, self.begins, self.ends)


@dataclass(frozen=True, eq=False)
class KeepIn(_Tactic):
    """Stay in a region, `margin` [m] deep; otherwise as `KeepOut`."""

    region: Region
    margin: float = 0.0
    begins: float = -np.inf
    ends: float = np.inf

    def pieces(self, now: float, times: Array) -> Iterable[Piece]:
        """One factor a step, while it holds."""
        shape = self.region.shape
        residual = KeepInFactor(shape, self.margin, self.sigma, self._weight(times))
        return self._held(residual, now, times, self.begins, self.ends)


@dataclass(frozen=True, eq=False)
class SpeedZone(_Tactic):
    """Go no faster than `limit` [m/s] in a region; sigma is in m/s.

    Args:
        region: In which.
        limit: [m/s].
        blend: Width of the rim over which it begins [m].
    """

    region: Region
    limit: float
    blend: float = 0.2

    def pieces(self, now: float, times: Array) -> Iterable[Piece]:
        """One factor a step."""
        weight = self._weight(times)
        residual = SpeedZoneFactor(self.region.shape, self.limit, self.blend, self.sigma, weight)
        return self._held(residual, now, times, -np.inf, np.inf)


@dataclass(frozen=True, eq=False)
class Deadline(_Tactic):
    """Be in a region at a time, and, with `opens`, not before another one: a time window.

    A deadline beyond the horizon asks to be near enough at its end: within what is left of the
    time at `speed`. One that has passed says nothing any more.

    Args:
        region: In which.
        time: Of the deadline, on the clock of `Scenario.now` [s].
        opens: Before this the region is kept out of [s].
        margin: How deep inside to be [m].
        speed: Of the robot, for deadlines beyond the horizon [m/s].
    """

    region: Region
    time: float
    opens: float = -np.inf
    margin: float = 0.0
    speed: float = 1.0

    def pieces(self, now: float, times: Array) -> Iterable[Piece]:
        """The event, and the factors of a region that is not open yet."""
        shape = self.region.shape
        closed = KeepOutFactor(shape, 0.0, self.sigma, self._weight(times))
        yield from self._held(closed, now, times, -np.inf, self.opens)
        left, T, dt = self.time - now, len(times) - 1, float(times[1] - times[0])
        if 0 < left <= times[-1]:
            k = min(int(left / dt), T - 1)
            tau = float(np.clip(left - times[k], 0.0, dt))
            residual: Residual = Arrival(shape, dt, tau, self.margin, self.sigma)
            yield Piece("Deadline", residual, (0, 1), k, k)
        elif np.isfinite(left) and left > 0:
            reach = self.speed * (left - times[-1])
            yield Piece("Deadline", KeepInFactor(shape, -reach, self.sigma), (0,), T, T)


@dataclass(frozen=True, eq=False)
class PassOn(_Tactic):
    """Pass a point, or somebody, on the left or on the right (as the robot sees it: "left" means
    that the robot is to the left of them).

    Args:
        side: Where the robot goes.
        point: Shape (2,) [m]; None: see `person`.
        direction: Of travel past it, shape (2,); for somebody: against their own by default.
        person: Name of who is passed.
        gap: Beside them [m].
        length: Over which it counts, abeam of them [m].
        seen: Where they are predicted, from `among`.
    """

    side: Literal["left", "right"]
    point: Array | None = None
    direction: Array | None = None
    person: str | None = None
    gap: float = 0.8
    length: float = 1.0
    seen: Trajectory | None = None

    def among(self, belief: Belief, times: Array) -> Measurement:
        """With the person's prediction, where they walk or a direction is given."""
        find = _walking if self.direction is None else _predicted
        return replace(self, seen=find(self.person, belief, times))

    def pieces(self, now: float, times: Array) -> Iterable[Piece]:
        """One factor a step; none where nobody is known."""
        centre, along = self.point, self.direction
        if self.seen is not None:
            centre = self.seen.positions
            along = -self.seen.velocities if along is None else along
        if centre is None or along is None or not np.all(np.linalg.norm(along, axis=-1) > 0):
            return
        centre = np.broadcast_to(np.asarray(centre, dtype=float), (len(times), 2))
        along = np.broadcast_to(np.asarray(along, dtype=float), (len(times), 2))
        weight = self._weight(times)
        given = self.side, self.gap, self.length, self.sigma, weight
        yield Piece(f"Pass on the {self.side}", PassingSide(centre, along, *given), (0,), 0)


@dataclass(frozen=True, eq=False)
class Formation(_Tactic):
    """Keep a place beside somebody who leads.

    Args:
        leader: Name.
        offset: (ahead, to the left) of the leader [m].
        seen: Where they are predicted, from `among`.
    """

    leader: str
    offset: tuple[float, float] = (-1.0, 0.0)
    seen: Trajectory | None = None

    def among(self, belief: Belief, times: Array) -> Measurement:
        """With the leader's prediction."""
        return replace(self, seen=_walking(self.leader, belief, times))

    def pieces(self, now: float, times: Array) -> Iterable[Piece]:
        """One factor a step; none where nobody is known."""
        if self.seen is None:
            return
        where, way = self.seen.positions, self.seen.velocities
        residual = formation(where, way, np.array(self.offset), self.sigma, self._weight(times))
        yield Piece("Formation", residual, (0,), 0)


@dataclass(frozen=True, eq=False)
class StayBehind(_Tactic):
    """Stay behind somebody who walks on.

    Args:
        person: Name.
        gap: How far behind [m].
        seen: Where they are predicted, from `among`.
    """

    person: str
    gap: float = 1.0
    seen: Trajectory | None = None

    def among(self, belief: Belief, times: Array) -> Measurement:
        """With the person's prediction."""
        return replace(self, seen=_walking(self.person, belief, times))

    def pieces(self, now: float, times: Array) -> Iterable[Piece]:
        """One factor a step; none where nobody is known."""
        if self.seen is None:
            return
        where, way = self.seen.positions, self.seen.velocities
        residual = StayBehindFactor(where, way, self.gap, self.sigma, self._weight(times))
        yield Piece("Stay behind", residual, (0,), 0)


def _predicted(name: str | None, belief: Belief, times: Array) -> Trajectory | None:
    """Somebody's prediction; None for who is not known."""
    if name is None or name not in belief.names:
        return None
    return Trajectory.from_states(times, belief.expected(times)[:, belief.names.index(name)])


def _walking(name: str | None, belief: Belief, times: Array) -> Trajectory | None:
    """Somebody's prediction; None for who is not known, or stands: they have no direction."""
    seen = _predicted(name, belief, times)
    if seen is None or np.linalg.norm(seen.velocities, axis=1).min() < SLOWEST:
        return None
    return seen
