"""The operator while driving: what was said, what of it is remembered, and what it comes to.

What a stick said at a fork keeps counting for the way it pointed at, however the robot has moved
since: each datum is compared with the plan that a hypothesis, known by its name, had when it was
said.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from factors.residual import whitener
from fgplan.driving.observation import Intent
from fgplan.driving.proposals import route
from fgplan.driving.routing import Routing, Way, joined
from fgplan.hypothesis import Course, Hypothesis
from fgplan.measuring import Measurement, Reading
from fgplan.mixture import Mixture
from fgplan.scenario import Scenario
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

LENGTHS = 6.0
"""Correlation times of the longest level after which data is forgotten: by then it moves a level
by less than 4e-4 of what it did."""
NEAR = 0.3
"""How far ahead of the robot the way through the waypoints is joined [m]."""
MOST = 400
"""Readings that are remembered: the latest."""
CERTAIN = 0.9
"""From this probability on it is known what the operator wants."""


@dataclass(frozen=True, eq=False)
class Operated:
    """What is remembered of the operator.

    Args:
        data: What was said, each item once.
        plans: Of each hypothesis by the name of its route: when it was made [s], and the plan.
        met: Names of waypoints that were reached.
        via: The way through the waypoints, for which of them, and when it was searched [s].
        closest: When the robot was nearest to each place without a time [s], and how near, in
            standard deviations.
        noted: When plans were looked at last [s].
        best: What the operator most probably wants, and since when it has been certain [s].
    """

    data: tuple[Measurement, ...] = ()
    plans: Mapping[str, tuple[tuple[float, Trajectory], ...]] = field(default_factory=dict)
    met: tuple[str, ...] = ()
    via: tuple[Way | None, bytes, float] = (None, b"", -np.inf)
    closest: Mapping[tuple[int, int], tuple[float, float]] = field(default_factory=dict)
    noted: float = -np.inf
    best: tuple[str, float] | None = None

    def hear(
        self, said: Iterable[Measurement], scenario: Scenario
    ) -> tuple[Operated, tuple[str, ...]]:
        """With new data, without what is over, and what was refused or cannot be done."""
        admitted = admit(said, scenario)
        horizon = LENGTHS * max(level.length for level in scenario.levels)
        closest = self._approach(scenario, (*self.data, *admitted.data))
        data, met = [], []
        for measurement in (*self.data, *admitted.data):
            if _over(measurement, closest, scenario.now - horizon):
                continue
            if isinstance(measurement, Waypoint) and _is_met(measurement, scenario):
                met.append(measurement.name)
            else:
                data.append(measurement)
        while sum(len(m.readings) for m in data) > MOST:
            data.pop(0)
        notes = (*admitted.notes, *(f"{name} is reached" for name in met))
        plans = self.plans if data else {}
        heard = replace(self, data=tuple(data), plans=plans, closest=closest)
        return replace(heard, met=(*self.met, *met)), notes

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

    def recall(self, hypothesis: Hypothesis, now: float, followed: str | None) -> Hypothesis:
        """A hypothesis with its course so far. What was not there then shares the past of what was
        followed: it branches off from there."""
        name = route(hypothesis.label)
        known = self.plans.get(name) or (self.plans.get(followed) if followed else None)
        if not known or hypothesis.plan is None:
            return hypothesis
        ahead = hypothesis.along.plans[-1]
        starts = np.array([start - now for start, _ in known] + [0.0])
        course = Course(starts, (*(plan for _, plan in known), ahead))
        return replace(hypothesis, course=course)

    def note(
        self, hypotheses: Sequence[Hypothesis], scenario: Scenario, followed: str | None
    ) -> Operated:
        """With the plans of this step, as long as there is data that they may be compared with."""
        now = scenario.now
        said = [t for m in self.data for r in m.readings if (t := _said(r)) is not None]
        if not (self.closest or any(t > self.noted for t in said)):
            return replace(self, noted=now)
        oldest = min([now, *said, *(time for time, _ in self.closest.values())])
        plans = dict(self.plans)
        for h in hypotheses:
            name = route(h.label)
            if h.plan is None or name != h.label:
                continue  # who waits on a route is on that route
            before = plans.get(name) or plans.get(followed or "") or ()
            recent = tuple(one for one in before if one[0] < now)
            # The one plan in force at the oldest datum is still needed.
            first = max(sum(start <= oldest + 1e-6 for start, _ in recent) - 1, 0)
            plans[name] = (*recent[first:], (now, h.plan))
        return replace(self, plans=plans, noted=now)

    def understand(
        self, mixture: Mixture, scenario: Scenario, driven: Trajectory
    ) -> tuple[Operated, Intent | None]:
        """What the operator wants, as far as it is known, and what the plan leaves of it."""
        if not self.data and self.best is None:
            return self, None
        probability: dict[str, float] = {}
        for component, p in zip(mixture.components, mixture.probability_height, strict=True):
            name = route(component.label.split("+")[0])  # merged hypotheses are one plan
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


def _over(
    measurement: Measurement, closest: Mapping[tuple[int, int], tuple[float, float]], oldest: float
) -> bool:
    """Whether all it says is of before a time: of a place without one, when the robot was nearest
    to it."""
    times = [
        closest[id(measurement), j][0] if reading.time is None else reading.time
        for j, reading in enumerate(measurement.readings)
    ]
    return bool(times) and max(times) < oldest


def _said(reading: Reading) -> float | None:
    """When it was said [s]; None for a place without a time."""
    return reading.time if reading.said is None else reading.said


def _is_met(waypoint: Waypoint, scenario: Scenario) -> bool:
    """Whether the robot is within a standard deviation of a place that has no time."""
    if waypoint.time is not None:
        return False
    off = scenario.robot.position - waypoint.position
    return bool(off @ np.linalg.solve(waypoint.covariance, off) <= 1)
