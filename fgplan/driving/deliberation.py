"""Is another route better, or does it only look so for a moment?

The energy of an optimum is one noisy sample: people are predicted at constant velocity, and which
optimum is found changes from step to step. What is compared between routes is therefore the
advantage over the route that is followed, averaged over the last steps with exponential
forgetting. Lasting evidence counts in full, strong evidence at once: an advantage of a nats above
a commitment of c nats is taken after −τ log(1 − c/a). Nor is the robot committed at once to a
route that it took on one sample: the commitment grows with the time it has been followed, as
c (1 − exp(−t/τ)). Of people who are seen for the first time not even the velocity is known.

Reference:
    Kulhavý and Zarrop, On a general concept of forgetting, Int. J. Control 58(4), 1993.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fgplan.driving.proposals import route_of
from fgplan.mixture import Component

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Deliberation:
    """The advantages of routes over the one that is followed, commitment apart, averaged.

    Args:
        followed: The route they are compared with; None before the first.
        since: When it was taken [s].
        of: Advantage by route [nats].
        when: Until when they are averaged [s].
    """

    followed: str | None = None
    since: float = -np.inf
    of: Mapping[str, float] = field(default_factory=dict)
    when: float = -np.inf

    def commitment(self, full: float, now: float, over: float) -> float:
        """What leaving the followed route costs now [nats]: in the end `full`."""
        return full * _share(now - self.since, over)

    def heard(
        self,
        components: Sequence[Component],
        scores: Array,
        now: float,
        commitment: float,
        over: float,
    ) -> Deliberation:
        """With the scores of one more plan.

        Who was not there before begins at 0, or below: it must last, too. A route that may not be
        driven stays as it was; where the followed one may not, there is nothing to compare with,
        and all do.

        Args:
            components: The plan's.
            scores: Of them, commitment included [nats], shape (K,).
            now: When it was made [s].
            commitment: What each route but the followed one has paid in them [nats].
            over: τ, the time averaged over [s]; 0 hears the last plan alone.
        """
        best = self._best(components, scores)
        here = best.pop(self.followed or "", -np.inf)
        if not np.isfinite(here):
            return self
        share = _share(now - self.when, over)
        of = {}
        for name, score in best.items():
            seen = score - here + commitment
            if np.isfinite(seen):
                known = self.of.get(name, min(seen, 0.0))
                of[name] = known + share * (seen - known)
        return replace(self, of={**self.of, **of}, when=now)

    def steadied(self, components: Sequence[Component], scores: Array, commitment: float) -> Array:
        """Scores in which each route has the advantage that it had on average, shape (K,)."""
        best = self._best(components, scores)
        here = best.get(self.followed or "", -np.inf)
        if not np.isfinite(here):
            return scores
        shift = np.zeros(len(scores))
        for k, component in enumerate(components):
            name = route_of(component.label, self.followed)
            if name in self.of and np.isfinite(best[name]):
                shift[k] = self.of[name] - commitment - (best[name] - here)
        return scores + shift

    def branched(self, names: Collection[str]) -> Deliberation:
        """Where these names mean something new from now on."""
        of = {name: value for name, value in self.of.items() if name not in names}
        return replace(self, of=of)

    def following(self, name: str, now: float) -> Deliberation:
        """What it comes to when this route is followed from now on."""
        if name == self.followed:
            return self
        if self.followed is None or name not in self.of:
            return Deliberation(name, now, {}, now)
        to = self.of[name]
        of = {other: value - to for other, value in self.of.items() if other != name}
        return Deliberation(name, now, {**of, self.followed: -to}, self.when)

    def _best(self, components: Sequence[Component], scores: Array) -> dict[str, float]:
        """The best score of each route that may be driven."""
        best: dict[str, float] = {}
        for component, score in zip(components, scores.tolist(), strict=True):
            name = route_of(component.label, self.followed)
            usable = score if component.feasible else -np.inf
            best[name] = max(best.get(name, -np.inf), usable)
        return best


def _share(time: float, over: float) -> float:
    """How much of what is averaged over a time constant is newer than `time` ago [s]."""
    return 1.0 if over <= 0 else float(1 - np.exp(-time / over))
