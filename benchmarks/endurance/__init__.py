"""What a robot that plans all day needs to know: does memory grow, and is a deadline kept?"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterable
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.memory import resident
from fgplan import GivenPlan, Robot, Scenario, Track, plan

WARM_UP = 200
"""Plans before memory is first read: caches and the allocator's pools are full by then."""

Row = dict[str, float]
Bar = Callable[[Iterable[int]], Iterable[int]]


def scene(seed: int, n: int = 5) -> Scenario:
    """Two plans past n people who walk towards the robot, seen five times."""
    rng = np.random.default_rng(seed)
    t = 0.4 * np.arange(-4, 1)
    tracks = []
    for i in range(n):
        end = np.array([rng.uniform(1.5, 6), rng.uniform(-2, 2)])
        velocity = np.array([-1.0, 0.0]) + 0.3 * rng.normal(size=2)
        seen = end + t[:, None] * velocity + 0.02 * rng.normal(size=(len(t), 2))
        tracks.append(Track(f"p{i}", t, seen))
    paths = tuple(
        GivenPlan(name, np.array([[0.0, 0.0], [4.0, y], [9.0, 0.0]]))
        for name, y in (("left", 1.0), ("right", -1.0))
    )
    return Scenario(Robot(np.zeros(2), np.array([0.8, 0.0])), plans=paths, count=0,
                    tracks=tuple(tracks))  # fmt: skip


def memory(plans: int, bar: Bar = iter) -> list[Row]:
    """Memory after every tenth of `plans` plans, each warm-started from the one before."""
    every, rows, previous = max(1, plans // 10), [], None
    for i in bar(range(WARM_UP + plans)):
        # Changing numbers of people: what is cached by size must not pile up.
        previous = plan(scene(i, n=2 + i % 5), warm=previous if i % 7 else None)
        if i >= WARM_UP and (i - WARM_UP) % every == every - 1:
            gc.collect()
            rows.append({"plans": i + 1 - WARM_UP, "rss_mb": resident()})
    return rows


def growth(rows: list[Row]) -> float:
    """Slope of memory over the whole run [MB]."""
    x = np.array([row["plans"] for row in rows])
    y = np.array([row["rss_mb"] for row in rows])
    return float(np.polyfit(x / x[-1], y, 1)[0]) if len(rows) > 1 else 0.0


def deadlines(
    plans: int, times: tuple[float, ...] = (0.02, 0.05, 0.1), n: int = 10, bar: Bar = iter
) -> list[dict[str, Any]]:
    """By how much plans among n people overshoot their deadline, and how they end."""
    rows = []
    for deadline in times:
        over, finished, following = [], [], []
        for i in bar(range(plans)):
            scenario = scene(i, n)
            began = perf_counter()
            mixture = plan(scenario, deadline=deadline)
            over.append(perf_counter() - began - deadline)
            finished.append(all(c.finished for c in mixture.components))
            following.append(mixture.selected is not None)
        late = 1e3 * np.maximum(over, 0.0)
        rows.append(
            {
                "deadline_ms": 1e3 * deadline,
                "overshoot_p50_ms": float(np.percentile(late, 50)),
                "overshoot_p99_ms": float(np.percentile(late, 99)),
                "overshoot_max_ms": float(late.max()),
                "finished": float(np.mean(finished)),
                "following": float(np.mean(following)),
            }
        )
    return rows
