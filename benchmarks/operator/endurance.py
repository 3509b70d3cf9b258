"""An hour of a stick: what is kept of it, and what a step costs, must not grow."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from time import process_time
from typing import Any

import numpy as np

from fgplan import Level, Robot, Scenario
from fgplan.driving import GoalInference, Observation
from fgplan.inference import Progress
from fgplan.shared_control import Candidate, JoySample, Stick

PERIOD = 0.1
"""Between two messages [s]."""
ROUND = 60.0
"""For one round by hand on a circle [s]."""
RADIUS = 3.0
STICK = Stick(deadman=None, frame="map")
PARTS = 6
"""Rows that are printed."""


def held(minutes: float, progress: Progress | None = None) -> Iterator[dict[str, Any]]:
    """Drive round and round by hand among five candidates; yields a row for each part of the time,
    for plans without a width and with one."""
    for sigma in (0.0, 0.5):
        yield from _held(minutes, sigma, progress)


def _held(minutes: float, sigma: float, progress: Progress | None) -> Iterator[dict[str, Any]]:
    rng = np.random.default_rng(6)
    angles = 2 * np.pi * np.arange(5) / 5
    candidates = [
        Candidate(f"{i}", 6.0 * np.array([np.cos(a), np.sin(a)])) for i, a in enumerate(angles)
    ]
    scenario = Scenario(Robot(np.zeros(2)), levels=(Level(sigma=sigma),))
    listener = GoalInference(scenario, candidates)
    steps = round(60 * minutes / PERIOD)
    spent: list[float] = []
    for k in range(steps):
        angle = 2 * np.pi * k * PERIOD / ROUND
        ahead = np.array([-np.sin(angle), np.cos(angle)])
        speed = 2 * np.pi * RADIUS / ROUND
        wish = np.clip(speed * ahead + rng.normal(0, 0.1, 2), -1, 1)
        said = STICK.wish(JoySample(k * PERIOD, (wish[1], wish[0]), ()), 0.0, PERIOD)
        place = RADIUS * np.array([np.cos(angle), np.sin(angle)])
        began = process_time()
        listener.step(Observation(k * PERIOD, place, speed * ahead, operator=said))
        spent.append(process_time() - began)
        if progress is not None:
            progress(f"stick held, sigma {sigma:g}", k + 1, steps)
        if (k + 1) % (steps // PARTS) == 0:
            operated = listener.operated
            yield {
                "case": "held",
                "sigma": sigma,
                "minutes": (k + 1) * PERIOD / 60,
                "readings_kept": sum(len(m.readings) for m in operated.data),
                "plans_kept": sum(len(past.plans) for past in operated.past.of.values()),
                "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
                "step_ms_p50": 1e3 * float(np.median(spent)),
                "step_ms_p99": 1e3 * float(np.quantile(spent, 0.99)),
            }
            spent.clear()
