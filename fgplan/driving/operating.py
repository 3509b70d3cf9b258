"""The operator while driving: what was said, what of it is remembered, and what it comes to.

What a stick said at a fork keeps counting for the way it pointed at, however the robot has moved
since: each datum is compared with the plan that a hypothesis, known by its name, had when it was
said. Data that is over is heard and not kept (`recollection.py`); it counts on.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from factors.residual import whitener
from fgplan.driving.observation import Intent
from fgplan.driving.proposals import route
from fgplan.driving.recollection import Recollection, rest_of
from fgplan.driving.routing import Routing, Way, joined
from fgplan.hypothesis import Hypothesis
from fgplan.labels import JOINED
from fgplan.measuring import Measurement, Reading
from fgplan.mixture import Mixture
from fgplan.scenario import Level, Scenario
from fgplan.shared_control import (
    VIA,
    Lead,
    Waypoint,
    admit,
    deviation,
    path_via,
    waypoints,
)
from fgplan.trajectory import Trajectory

Array = NDArray[np.float64]

LATE = 1.5
"""Data is kept for this long, since some of it may come late [s]."""
LENGTHS = 6.0
"""Correlation times of the longest level after which a place without a time that was not met is
forgotten: by then it moves a level by less than 4e-4 of what it did."""
NEAR = 0.3
"""How far ahead of the robot the way through the waypoints is joined [m]."""
MOST = 400
"""Readings of the past that are kept: where there are more, the oldest are heard sooner."""
CERTAIN = 0.9
"""From this probability on it is known what the operator wants."""


@dataclass(frozen=True, eq=False)
class Operated:
    """What is remembered of the operator.

    Args:
        data: What was said and is kept, each item once.
        waiting: What is to be heard at the next step.
        past: What was said and is not kept, and the plans of each hypothesis.
        met: Names of waypoints that were reached.
        via: The way through the waypoints, for which of them, and when it was searched [s].
        closest: When the robot was nearest to each place without a time [s], and how near, in
            standard deviations.
        best: What the operator most probably wants, and since when it has been certain [s].
        late: How late data may come [s]; inf keeps it all.
    """

    data: tuple[Measurement, ...] = ()
    waiting: tuple[Measurement, ...] = ()
    past: Recollection = Recollection(patience=LATE)  # noqa: RUF009 - frozen
    met: tuple[str, ...] = ()
    via: tuple[Way | None, bytes, float] = (None, b"", -np.inf)
    closest: Mapping[tuple[int, int], tuple[float, float]] = field(default_factory=dict)
    best: tuple[str, float] | None = None
    late: float = LATE

    def on_new_clock(self) -> Operated:
        """What was said of places without a time."""
        data = tuple(m for m in self.data if all(r.time is None for r in m.readings))
        past = Recollection(patience=self.past.patience)
        return Operated(data, self.waiting, past, self.met, late=self.late)

    def hear(
        self, said: Iterable[Measurement], scenario: Scenario
    ) -> tuple[Operated, tuple[str, ...]]:
        """With new data, without what is over, and what was refused or cannot be done."""
        known, admitted = admit(self.waiting, scenario), admit(said, scenario)
        # What the scenario says of its past is as old as it says.
        new, notes = self._in_time(known.data, scenario.now, self.past.until)
        since = max(self.past.until, scenario.now - self.late)
        fresh, late = self._in_time(admitted.data, scenario.now, since)
        new, notes = [*new, *fresh], [*known.notes, *admitted.notes, *notes, *late]
        closest = self._approach(scenario, (*self.data, *new))
        data, met = [], []
        for measurement in (*self.data, *new):
            if isinstance(measurement, Waypoint) and _is_met(measurement, scenario):
                met.append(measurement.name)
            else:
                data.append(measurement)
        notes += [f"{name} is reached" for name in met]
        past = self.past
        if past.of:
            kept, past = self._over(data, closest, scenario)
        else:  # nobody is there yet who could hear it
            kept, lost = _newest(data, scenario.now)
            notes += lost
        operated = replace(self, data=kept, waiting=(), past=past, closest=closest)
        return replace(operated, met=(*self.met, *met)), tuple(notes)

    def _in_time(
        self, data: Iterable[Measurement], now: float, since: float
    ) -> tuple[list[Measurement], list[str]]:
        """Data of moments from `since` on [s], and what came too late."""
        kept, notes = [], []
        for measurement in data:
            times = [r.time for r in measurement.readings if r.time is not None]
            if times and min(times) < since:
                late = f"{now - min(times):.2f} s late"
                notes.append(f"operator data ({_name(measurement)}) came {late}: refused")
            else:
                kept.append(measurement)
        return kept, notes

    def _over(
        self,
        data: Iterable[Measurement],
        closest: Mapping[tuple[int, int], tuple[float, float]],
        scenario: Scenario,
    ) -> tuple[tuple[Measurement, ...], Recollection]:
        """Data that is kept, and the past with what is over."""
        data, now = tuple(data), scenario.now
        until = max(now - self.late, self.past.until, _since_most(data, now))
        horizon = now - LENGTHS * max(level.length for level in scenario.levels)
        levels: dict[str | None, Level] = {level.name: level for level in scenario.levels}
        levels[None] = scenario.levels[0]
        kept: list[Measurement] = []
        over: dict[str | None, list[Reading]] = {}
        for measurement in data:
            on, readings = measurement.on, tuple(measurement.readings)
            stamped = [reading.time is not None for reading in readings]
            level = levels.get(on)
            own = level is not None and bool(level.plans)
            if all(stamped):
                # What is known exactly can hear data in any order, and so at once.
                exact = level is not None and level.sigma == 0 and self.late < np.inf
                before = now if exact else until
                before = horizon if own else before
                gone = [r.time is not None and r.time < before for r in readings]
            else:  # of places without a time all are kept, or none
                last = max(closest[id(measurement), j][0] for j, at in enumerate(stamped) if not at)
                gone = [last < horizon] * len(readings)
            if not any(gone):
                kept.append(measurement)
                continue
            if not all(gone):
                rest = [r for r, is_gone in zip(readings, gone, strict=True) if not is_gone]
                kept.append(rest_of(measurement, rest))
            if level is not None and not own:  # a robot's own past is known
                some = [r for r, is_gone in zip(readings, gone, strict=True) if is_gone]
                over.setdefault(on, []).extend(some)
        if not over:
            return tuple(kept), self.past
        return tuple(kept), self.past.heard(over, scenario.replace(now=until))

    def _approach(
        self, scenario: Scenario, data: Iterable[Measurement]
    ) -> dict[tuple[int, int], tuple[float, float]]:
        """`closest` with where the robot is now."""
        found = {}
        for measurement in data:
            for j, reading in enumerate(measurement.readings):
                if reading.time is None:
                    key = (id(measurement), j)
                    off = whitener(reading.covariance) @ (scenario.robot.position - reading.value)
                    here = (scenario.now, float(np.hypot(*off)))
                    known = self.closest.get(key, here)
                    found[key] = here if here[1] <= known[1] else known
        return found

    def seek(self, scenario: Scenario, leads: Sequence[Lead], routing: Routing) -> Operated:
        """With the way through the waypoints from where the robot is, where no known one leads."""
        way, places, searched = self.via
        wanted = b"".join(np.asarray(w.value, dtype=float).tobytes() for w in waypoints(scenario))
        if wanted == places and 0 <= scenario.now - searched < routing.period:
            # Joined further ahead, the way would leave out the place that it is for.
            near = None if way is None else joined(way, scenario, replace(routing, ahead=NEAR))
            if way is None or near is not None:
                return replace(self, via=(near, places, searched))
        path = path_via(scenario, leads)
        found = None if path is None else Way(VIA, path)
        return replace(self, via=(found, wanted, scenario.now))

    def recalled(
        self, hypotheses: Sequence[Hypothesis], now: float, followed: str | None
    ) -> tuple[Hypothesis, ...]:
        """Hypotheses with their course so far, and what they have heard."""
        if not self.data and not self.past.weighs:
            return tuple(hypotheses)
        return self.past.recalled(hypotheses, now, followed)

    def branched(self, ways: Iterable[Way], now: float, followed: str | None) -> Operated:
        """Where names of ways that were found just now mean something new."""
        new = [way.label for way in ways if way.born == now]
        return replace(self, past=self.past.branched(new, followed))

    def note(
        self, hypotheses: Sequence[Hypothesis], scenario: Scenario, followed: str | None
    ) -> Operated:
        """With the plans of this step."""
        now = scenario.now
        said = [t for m in self.data for r in m.readings if (t := _said(r)) is not None]
        oldest = min([now - self.late, *said, *(time for time, _ in self.closest.values())])
        return replace(self, past=self.past.noted(hypotheses, now, oldest, followed))

    def understand(
        self, mixture: Mixture, scenario: Scenario, driven: Trajectory
    ) -> tuple[Operated, Intent | None]:
        """What the operator wants, as far as it is known, and what the plan leaves of it."""
        if not self.data and self.best is None and not self.past.weighs:
            return self, None
        probability: dict[str, float] = {}
        for component, p in zip(mixture.components, mixture.probability_height, strict=True):
            name = route(component.label.split(JOINED)[0])  # merged hypotheses are one plan
            probability[name] = probability.get(name, 0.0) + float(p)
        operated = self.conclude(probability, scenario.now)
        since = None if operated.best is None else operated.best[1]
        asked = scenario.replace(data=self.data)
        return operated, Intent(probability, since, deviation(asked, driven))

    def conclude(self, probability: Mapping[str, float], now: float) -> Operated:
        """With what is certain, and since when."""
        name = max(probability, key=lambda key: probability[key])
        if probability[name] < CERTAIN:
            return replace(self, best=None)
        known = self.best is not None and self.best[0] == name
        return self if known else replace(self, best=(name, now))


def _since_most(data: Iterable[Measurement], now: float) -> float:
    """From when on there are no more than `MOST` readings of the past [s]."""
    stamps = sorted(r.time for m in data for r in m.readings if r.time is not None and r.time < now)
    return stamps[-MOST] if len(stamps) > MOST else -np.inf


def _newest(
    data: Iterable[Measurement], now: float
) -> tuple[tuple[Measurement, ...], tuple[str, ...]]:
    """Data with at most `MOST` readings of the past, and what that leaves out."""
    data = tuple(data)
    since = _since_most(data, now)
    kept: list[Measurement] = []
    count = 0
    for measurement in data:
        readings = tuple(measurement.readings)
        rest = [r for r in readings if r.time is None or r.time >= since]
        count += len(readings) - len(rest)
        if len(rest) == len(readings):
            kept.append(measurement)
        elif rest:
            kept.append(rest_of(measurement, rest))
    if not count:
        return data, ()
    before = f"from before {since:.3f} s, more than {MOST} before there was a plan"
    return tuple(kept), (f"{count} readings of the operator {before}: left out",)


def _name(measurement: Measurement) -> str:
    return str(getattr(measurement, "name", type(measurement).__name__.lower()))


def _said(reading: Reading) -> float | None:
    """When it was said [s]; None for a place without a time."""
    return reading.time if reading.said is None else reading.said


def _is_met(waypoint: Waypoint, scenario: Scenario) -> bool:
    """Whether the robot is within a standard deviation of a place that has no time."""
    if waypoint.time is not None:
        return False
    off = scenario.robot.position - waypoint.position
    return bool(off @ np.linalg.solve(waypoint.covariance, off) <= 1)
