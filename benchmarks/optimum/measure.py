"""Plans of a scene under each condition, and the gap of each to the best known."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from hashlib import sha256
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.optimum.best import Score, best_known, gap, score
from benchmarks.optimum.scenes import Scene
from benchmarks.solver.problem import cold
from fgplan.planner import plan
from fgplan.scenario import Scenario

Row = dict[str, Any]

DEADLINES = (0.02, 0.05, 0.1)
"""[s]"""
CLOSE = 0.05
"""A plan this close to the best known is as good [nats]."""


@dataclass(frozen=True)
class Made:
    """One plan.

    Args:
        mode: "cold" or "warm", and the deadline.
        seconds: What it took [s].
        deadline: What it might have taken; None is as long as it likes [s].
        score: What it reached.
        start: The start that the selected plan comes from, "stop" where none is safe.
    """

    mode: str
    seconds: float
    deadline: float | None
    score: Score
    start: str


@dataclass(frozen=True)
class Known:
    """The best known of a scene: its score, what found it, and of which density."""

    score: Score
    found_by: str
    fingerprint: str


def made(scene: Scene) -> tuple[Scenario, list[Made]]:
    """What is known after one step of a plan, planned cold and warm, at leisure and in haste."""
    before = plan(scene.before)
    now = scene.then(before.trajectory.states[1])
    plans = []
    for start, warm in (("cold", None), ("warm", before)):
        for deadline in (None, *DEADLINES):
            began = perf_counter()
            mixture = plan(now, warm=warm, deadline=deadline)
            seconds = perf_counter() - began
            mode = start if deadline is None else f"{start}, {1e3 * deadline:.0f} ms"
            label = "stop" if mixture.best is None else mixture.best.start
            plans.append(Made(mode, seconds, deadline, score(mixture), label))
    return now, plans


def search(name: str, now: Scenario, starts: int) -> tuple[str, Known]:
    """The best known of one scene, for a process of its own."""
    reached, found_by = best_known(now, seed=0, starts=starts)
    return name, Known(reached, found_by, fingerprint(now, starts))


def fingerprint(now: Scenario, starts: int) -> str:
    """Changes with the density and the effort: what is known of another one is of no use."""
    problem, robot = cold(now), now.robot
    energy = float(np.sum(problem.energies(problem.initial)))
    limits = robot.model, robot.radius, robot.max_speed, robot.max_acceleration
    settings = repr((now.density, now.levels, now.crowd, now.pairs, *limits))
    digest = sha256(settings.encode()).hexdigest()[:8]
    return f"{problem.assembly.reference.shape} {energy:.5g} {digest} {starts}"


def best_of_all(
    scenes: Mapping[str, Scenario], starts: int, cache: Path, workers: int, tick: Callable[[], None]
) -> dict[str, Known]:
    """The best known of all scenes; what is in the cache, for the same density, is not redone."""
    kept = read(cache)
    known = {
        name: kept[name]
        for name, now in scenes.items()
        if name in kept and kept[name].fingerprint == fingerprint(now, starts)
    }
    for _ in known:
        tick()
    missing = {name: now for name, now in scenes.items() if name not in known}
    for name, entry in _searched(missing, starts, workers):
        known[name] = entry
        write(cache, kept | known)
        tick()
    return known


def _searched(
    missing: Mapping[str, Scenario], starts: int, workers: int
) -> Iterator[tuple[str, Known]]:
    if workers < 2:
        yield from (search(name, now, starts) for name, now in missing.items())
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        jobs = [pool.submit(search, name, now, starts) for name, now in missing.items()]
        for job in as_completed(jobs):
            yield job.result()


def rows_of(name: str, now: Scenario, plans: Sequence[Made], known: Known) -> list[Row]:
    """One row a plan; energies in nats, times in ms.

    In haste fewer routes may be found, and a route's weight is then one of fewer: such a plan may
    look better than it is, by what the others would have weighed, and is no measure of the best.
    """
    at_leisure = [p.score for p in plans if p.deadline is None]
    best = Score(
        max(known.score.safe, *(score.safe for score in at_leisure)),
        max(known.score.any, *(score.any for score in at_leisure)),
    )
    rows = []
    for p in plans:
        distance = gap(p.score, best)
        rows.append(
            {
                "scene": name,
                "people": len(now.tracks),
                "mode": p.mode,
                "gap": distance if np.isfinite(distance) else None,
                "start": p.start,
                "ms": 1e3 * p.seconds,
                "late_ms": None if p.deadline is None else 1e3 * (p.seconds - p.deadline),
            }
        )
    return rows


def summary(rows: Sequence[Row]) -> list[Row]:
    """One row for each kind of scene and mode: how often a plan is as good as the best known."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        kind = "random" if row["scene"].startswith("random") else "recorded"
        groups.setdefault((kind, row["mode"]), []).append(row)
    return [{"scenes": kind, **_summary_of(own)} for (kind, _), own in groups.items()]


def _summary_of(rows: Sequence[Row]) -> Row:
    gaps = np.array([np.inf if r["gap"] is None else r["gap"] for r in rows])
    late = [r["late_ms"] for r in rows if r["late_ms"] is not None]
    median, p95 = (float(np.quantile(gaps, q, method="higher")) for q in (0.5, 0.95))
    return {
        "mode": rows[0]["mode"],
        "count": len(rows),
        "close": float(np.mean(gaps <= CLOSE)),
        "gap_p50": median if np.isfinite(median) else None,
        "gap_p95": p95 if np.isfinite(p95) else None,
        "stops_in_vain": int(np.isinf(gaps).sum()),
        "p50_ms": float(np.median([r["ms"] for r in rows])),
        "late_p99_ms": float(np.percentile(late, 99)) if late else None,
    }


FIELDS = ("scene", "safe", "any", "found_by", "fingerprint")


def read(path: Path) -> dict[str, Known]:
    """The cache; nothing where there is none."""
    if not path.is_file():
        return {}
    with path.open(newline="", encoding="utf-8") as file:
        return {
            line["scene"]: Known(
                Score(float(line["safe"]), float(line["any"])),
                line["found_by"],
                line["fingerprint"],
            )
            for line in csv.DictReader(file)
        }


def write(path: Path, known: Mapping[str, Known]) -> None:
    """The cache, whole: it is small."""
    rows = [
        {
            "scene": name,
            "safe": k.score.safe,
            "any": k.score.any,
            "found_by": k.found_by,
            "fingerprint": k.fingerprint,
        }
        for name, k in known.items()
    ]
    write_rows(path, rows, FIELDS)


def write_rows(path: Path, rows: Sequence[Row], fields: Sequence[str]) -> None:
    """A CSV file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fields)
        writer.writeheader()
        writer.writerows(rows)
