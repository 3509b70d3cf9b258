"""What an operator said a while ago, without the data: it counts on, and nothing of it is kept.

A datum that is over is heard once by each hypothesis, on the plan that this had when the datum was
said: it becomes a number of nats against the hypothesis and, of levels that are random, a density
of their state (`fgplan.conditioning.heard`). That is exact, so an hour of a stick weighs as much as
it said, and takes as much room and time as a few seconds.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgplan.conditioning import heard
from fgplan.driving.proposals import route
from fgplan.hypothesis import Course, Heard, Hypothesis
from fgplan.measuring import Measurement, Reading, Readings
from fgplan.robots import Piece
from fgplan.scenario import Scenario
from fgplan.trajectory import Trajectory

Array = NDArray[np.float64]


class Past(NamedTuple):
    """Of one hypothesis.

    Args:
        plans: When each was made [s], increasing, and the plan.
        energy: What data that is not kept says against it [nats], up to a constant of all.
        states: What it says of random levels, by name.
    """

    plans: tuple[tuple[float, Trajectory], ...] = ()
    energy: float = 0.0
    states: Mapping[str, Heard] = {}


@dataclass(frozen=True, eq=False)
class Recollection:
    """The past of each hypothesis by the name of its route.

    Args:
        of: Name to past.
        until: Readings from before this are in it and are not kept [s].
        patience: Who has not been proposed for this long has no past any more [s].
    """

    of: Mapping[str, Past] = field(default_factory=dict)
    until: float = -np.inf
    patience: float = np.inf

    @property
    def weighs(self) -> bool:
        """Whether there is anything in it that tells hypotheses apart."""
        energies = [past.energy for past in self.of.values()]
        return any(past.states for past in self.of.values()) or bool(
            energies and max(energies) > min(energies)
        )

    def past_of(self, name: str, followed: str | None) -> Past:
        """The past of a hypothesis. Who was not there shares that of what was followed, from which
        it branches off; else of what fits the data best."""
        known = self.of.get(name) or (self.of.get(followed) if followed else None)
        if known is None and self.of:
            known = min(self.of.values(), key=lambda past: past.energy)
        return Past() if known is None else known

    def branched(self, names: Iterable[str], followed: str | None) -> Recollection:
        """Where these names mean something new from now on."""
        new = set(names) & set(self.of)
        if not new:
            return self
        past = self.past_of(followed or "", None)
        return replace(self, of={**self.of, **dict.fromkeys(new, past)})

    def noted(
        self,
        hypotheses: Sequence[Hypothesis],
        now: float,
        oldest: float,
        followed: str | None,
    ) -> Recollection:
        """With the plans of a step; those that nothing since `oldest` [s] is compared with go."""
        of = {
            name: past
            for name, past in self.of.items()
            if past.plans and now - past.plans[-1][0] <= self.patience
        }
        for h in hypotheses:
            if h.plan is None or route(h.label) != h.label:
                continue  # who waits on a route is on that route
            past = self.past_of(h.label, followed)
            before = tuple(one for one in past.plans if one[0] < now)
            # The one plan in force at the oldest datum is still needed.
            first = max(sum(start <= oldest + 1e-6 for start, _ in before) - 1, 0)
            of[h.label] = past._replace(plans=(*before[first:], (now, h.plan)))
        return replace(self, of=of)

    def heard(
        self, readings: Mapping[str | None, list[Reading]], scenario: Scenario
    ) -> Recollection:
        """With readings of each level, all from before `scenario.now`, to which it goes on."""
        now = scenario.now
        told = tuple(Readings(tuple(some), on) for on, some in readings.items() if some)
        if not told or not self.of:
            return self
        known = [_as_hypothesis(name, past, now) for name, past in self.of.items() if past.plans]
        found = heard(scenario.replace(data=told), known)
        least = min(-h.log_prior for h in found)
        of = {
            h.label: self.of[h.label]._replace(energy=-h.log_prior - least, states=h.heard)
            for h in found
        }
        return replace(self, of=of, until=now)

    def recalled(
        self, hypotheses: Sequence[Hypothesis], now: float, followed: str | None
    ) -> tuple[Hypothesis, ...]:
        """Hypotheses with their course so far and what they have heard."""
        pasts = [self.past_of(route(h.label), followed) for h in hypotheses]
        score = np.array([h.log_prior - p.energy for h, p in zip(hypotheses, pasts, strict=True)])
        if len(score) and self.weighs:
            score -= np.logaddexp.reduce(score)
        return tuple(
            replace(h, log_prior=weight, course=_course(h, past, now), heard=past.states)
            if past.plans and h.plan is not None
            else h
            for h, past, weight in zip(hypotheses, pasts, score.tolist(), strict=True)
        )


@dataclass(frozen=True, eq=False)
class Rest:
    """What is left of a measurement when some of its readings are over."""

    whole: Measurement
    readings: tuple[Reading, ...]

    @property
    def on(self) -> str | None:
        """As of the whole."""
        return self.whole.on

    def pieces(self, now: float, times: Array) -> Iterable[Piece]:
        """As of the whole."""
        return self.whole.pieces(now, times)


def rest_of(measurement: Measurement, readings: Iterable[Reading]) -> Rest:
    """The same measurement with these of its readings."""
    whole = measurement.whole if isinstance(measurement, Rest) else measurement
    return Rest(whole, tuple(readings))


def _course(hypothesis: Hypothesis, past: Past, now: float) -> Course:
    ahead = hypothesis.along.plans[-1]
    starts = np.array([start - now for start, _ in past.plans] + [0.0])
    return Course(starts, (*(plan for _, plan in past.plans), ahead))


def _as_hypothesis(name: str, past: Past, now: float) -> Hypothesis:
    """As it was, for data that came when its plans were made."""
    starts, plans = np.array([start - now for start, _ in past.plans]), past.plans
    course = Course(starts, tuple(plan for _, plan in plans))
    return Hypothesis(name, -past.energy, plans[-1][1], 0.0, (), None, course, {}, past.states)
