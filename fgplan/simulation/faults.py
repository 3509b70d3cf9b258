"""Observations that are spoilt on their way to the planner."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgplan.driving import Detection, Observation

STREAM = 6
"""Of the seed's random numbers, so that faults change nothing else of a world."""
JUMP = 8.0
"""How far a detection teleports [m]."""
KINDS = ("dropped", "late", "duplicated", "not a number", "teleported")


class Faults:
    """Spoils a share of the observations: no detections, the last observation again, somebody
    twice, somebody at no place, somebody far away.

    News of goal, map and operator in an observation that is replaced come with the next one.

    Args:
        share: Of the observations, each in one way.
        seed: Which ones, and how.
    """

    def __init__(self, share: float, seed: int) -> None:
        self.share = share
        self._rng = np.random.default_rng([seed, STREAM])
        self._last: Observation | None = None
        self._owed: Observation | None = None

    def __call__(self, observation: Observation) -> Observation:
        last, self._last = self._last, observation
        if self._owed is not None:
            observation = _with_news(observation, self._owed)
            self._owed = None
        if self.share <= 0 or self._rng.random() >= self.share:
            return observation
        kind = KINDS[self._rng.integers(len(KINDS))]
        if kind == "late" and last is not None:
            self._owed = observation if _has_news(observation) else None
            return replace(last, goal=None, grid=None, operator=(), facts={})
        detections = observation.detections
        if not detections or kind in ("dropped", "late"):
            return replace(observation, detections=None)
        i = int(self._rng.integers(len(detections)))
        return replace(observation, detections=self._spoilt(kind, detections, i))

    def _spoilt(
        self, kind: str, detections: tuple[Detection, ...], i: int
    ) -> tuple[Detection, ...]:
        one = detections[i]
        if kind == "duplicated":
            return (*detections, one)
        if kind == "not a number":
            wrong = replace(one, position=np.full(2, np.nan))
        else:
            angle = self._rng.uniform(0, 2 * np.pi)
            jump = JUMP * np.array([np.cos(angle), np.sin(angle)])
            wrong = replace(one, position=one.position + jump)
        return (*detections[:i], wrong, *detections[i + 1 :])


def _has_news(observation: Observation) -> bool:
    """Whether it says more than what is sensed at its time."""
    news = observation.goal is not None or observation.grid is not None
    return news or bool(observation.operator or observation.facts)


def _with_news(observation: Observation, owed: Observation) -> Observation:
    """With what an earlier observation had to say, unless this one knows better."""
    return replace(
        observation,
        goal=owed.goal if observation.goal is None else observation.goal,
        grid=owed.grid if observation.grid is None else observation.grid,
        operator=(*owed.operator, *observation.operator),
        facts={**owed.facts, **observation.facts},
    )
