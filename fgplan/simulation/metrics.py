"""What a run comes to in numbers, and what many runs come to, with confidence intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgplan.mixture import finite
from fgplan.simulation.episode import End, Episode
from fgplan.simulation.gaps import nearest

Array = NDArray[np.float64]
Row = dict[str, Any]

STANDING = 0.1
"""Slower than this is stopped [m/s]."""
NEAR = 1.0
"""Who stands this near the goal is not stopped on the way [m]."""
CONFIDENCE = 0.95
RESAMPLED = 2000


def row(episode: Episode) -> Row:
    """One run in numbers; None where a number does not exist.

    `time` and `path_ratio` are of runs that reach the goal, the latter where there is a way to go;
    `success` is the goal without any
    contact. Distances are in metres, times in seconds, shares from 0 to 1.
    """
    reached = episode.end is End.GOAL
    touched = begins(episode.gaps < 0)
    walls = begins(episode.blocked)
    steps = np.linalg.norm(np.diff(episode.robot[:, :2], axis=0), axis=1)
    period = float(episode.times[1]) if len(episode.times) > 1 else 1.0
    away = np.linalg.norm(episode.robot[:-1, :2] - episode.goal, axis=1)
    stopped = (steps / period < STANDING) & ~(away <= NEAR)
    apart = separations(episode)
    # Where no goal is stated there is nothing left to go.
    length = float(
        steps.sum() + np.nan_to_num(np.linalg.norm(episode.robot[-1, :2] - episode.goal))
    )
    times = 1e3 * np.percentile(episode.seconds, [50, 95, 99]) if len(steps) else np.zeros(3)
    return {
        "world": episode.name,
        "end": str(episode.end),
        "mission": str(episode.mission),
        "success": bool(reached and not touched and not walls),
        "collisions": touched + walls,
        "wall_contacts": walls,
        "time": float(episode.times[-1]) if reached else None,
        "path_ratio": length / episode.reference if reached and episode.reference > 0 else None,
        "min_separation": finite(float(apart.min(initial=np.inf))),
        "min_clearance": finite(float(episode.gaps.min(initial=np.inf))),
        "stopped_fraction": float(stopped.mean()) if len(steps) else 0.0,
        "switches": switches(episode.labels),
        "revisits": sum(max(0, count - 1) for count in episode.entries),
        "discomfort": float(np.mean(episode.gaps < episode.discomfort)) if len(steps) else 0.0,
        "people_delay": float(episode.delays.mean()) if len(episode.delays) else None,
        "unsafe": episode.unsafe,
        "steps": len(steps),
        "step_ms_p50": float(times[0]),
        "step_ms_p95": float(times[1]),
        "step_ms_p99": float(times[2]),
        "error": episode.error,
    }


def separations(episode: Episode) -> Array:
    """Least distance between the centres of robot and anybody during each step, shape (S,) [m],
    when all moved evenly; inf where nobody was there at both ends of it."""
    offset = episode.people - episode.robot[:, None, :2]
    apart = nearest(offset[:-1], np.diff(offset, axis=0))
    return np.asarray(np.where(np.isnan(apart), np.inf, apart).min(axis=1, initial=np.inf))


def switches(labels: Sequence[str | None]) -> int:
    """How often the hypothesis that is followed became another one; steps that follow none do not
    count."""
    named = [label for label in labels if label is not None]
    return sum(a != b for a, b in pairwise(named))


def wilson(successes: int, count: int) -> tuple[float, float]:
    """Confidence interval of a rate.

    Reference:
        Wilson, Journal of the American Statistical Association 22, 1927.
    """
    if count == 0:
        return 0.0, 1.0
    from scipy.stats import binomtest

    interval = binomtest(successes, count).proportion_ci(CONFIDENCE, method="wilson")
    return float(interval.low), float(interval.high)


def bootstrap(values: Sequence[float], seed: int = 0) -> tuple[float, float]:
    """Confidence interval of a mean, by the percentiles of resampled means."""
    data = np.asarray(values, dtype=float)
    if len(data) == 0:
        return np.nan, np.nan
    rng = np.random.default_rng(seed)
    means = data[rng.integers(len(data), size=(RESAMPLED, len(data)))].mean(axis=1)
    low, high = np.quantile(means, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)


RATES = ("success",)
MEANS = (
    "collisions", "time", "path_ratio", "min_separation", "stopped_fraction", "switches",
    "revisits", "discomfort", "people_delay", "step_ms_p50", "step_ms_p95", "step_ms_p99",
)  # fmt: skip


def summary(rows: Sequence[Row]) -> Row:
    """Runs of one planner in one kind of world: rates and means, each with its interval as
    `NAME_ci`; None where no run has the number."""
    line: Row = {"episodes": len(rows)}
    for name in RATES:
        count = sum(bool(r[name]) for r in rows)
        line[name] = count / len(rows) if rows else None
        line[f"{name}_ci"] = list(wilson(count, len(rows)))
    for name in MEANS:
        values = [r[name] for r in rows if r[name] is not None]
        line[name] = float(np.mean(values)) if values else None
        line[f"{name}_ci"] = list(bootstrap(values)) if values else None
    line["errors"] = sum(bool(r["error"]) for r in rows)
    return line


def paired(
    rows: Sequence[Row], others: Sequence[Row], number: Callable[[Row], float | None]
) -> list[float]:
    """How much more the rows have of a number than the others, over the seeds at which both have
    it."""
    known = {other["seed"]: number(other) for other in others}
    pairs = [(number(own), known.get(own["seed"])) for own in rows]
    return [mine - other for mine, other in pairs if mine is not None and other is not None]


def begins(flags: NDArray[np.bool_]) -> int:
    """How often a row of flags begins to be true."""
    return int(np.sum(flags & ~np.concatenate([[False], flags[:-1]])))
