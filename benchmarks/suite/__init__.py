"""S1 to S11 in closed loop: fgplan beside the layered stacks, and beside itself without the feature
that each scenario is about. Every planner drives the same seeds.

A scenario has a measure of its own; a run that does not arrive counts with the time limit. The
hindsight oracle of S1, S3 and S5 is fgplan told which corridor to take, the better of the two seed
by seed; what is lost to it is the overhead. S5 is also one scenario: who does not know how long the
aisle is blocked is judged by what they lose to the oracle over all its durations.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fgplan.inference import Progress
from fgplan.simulation import metrics
from fgplan.simulation.batch import Job, run_all
from fgplan.simulation.file import FromFile

DATA = Path(__file__).parents[2] / "data" / "simulations"
LAYERED = ("layered", "layered-global")
Row = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """A scenario of the suite.

    Args:
        file: Its simulation file, without suffix.
        measure: What it is about, a number of `metrics.row`.
        without: fgplan without the features responsible.
        changes: Of keys of the file.
        corridors: Ways by name that the oracle is told, as vertices [m].
    """

    file: str
    measure: str
    without: tuple[str, ...] = ()
    changes: tuple[tuple[str, str], ...] = ()
    corridors: tuple[tuple[str, str], ...] = ()

    @property
    def setup(self) -> FromFile:
        """Makes its worlds."""
        return FromFile(DATA / f"{self.file}.toml", self.changes)

    @property
    def name(self) -> str:
        """Of the scenario."""
        return self.setup.name

    def told(self, corridor: str, path: str) -> FromFile:
        """Its worlds for a planner that is told the way."""
        plan = f"[{{label = '{corridor}', path = {path}}}]"
        changes = (*self.changes, ("plans.count", "0"), ("plans.given", plan))
        return FromFile(DATA / f"{self.file}.toml", changes)


ROUND_S1 = (
    ("A", "[[0.7, 3.0], [19.3, 3.0]]"),
    ("B", "[[0.7, 3.0], [2.4, 7.4], [17.6, 7.4], [19.3, 3.0]]"),
)
ROUND_S3 = (
    ("above", "[[1.0, 4.0], [3.9, 4.85], [10.1, 4.85], [13.0, 4.0]]"),
    ("below", "[[1.0, 4.0], [3.9, 3.15], [10.1, 3.15], [13.0, 4.0]]"),
)
ROUND_S5 = (
    ("aisle", "[[2.0, 2.0], [16.0, 2.0]]"),
    ("round", "[[2.0, 2.0], [3.4, 14.4], [14.6, 14.4], [16.0, 2.0]]"),
)
BLOCKED = "world.people[{}].begins"
DENSER = "world.people[0].count"
"""18 people in the 20 m of S4, and three who are about to come in."""

SUITE = (
    Case("s1_corridors", "time", ("fgplan-one-hypothesis",), corridors=ROUND_S1),
    Case("s1_corridors_human_like", "time", ("fgplan-one-hypothesis",), corridors=ROUND_S1),
    Case("s2_trap", "path_ratio", ("fgplan-one-hypothesis",)),
    Case("s2_trap_unseen", "path_ratio", ("fgplan-one-hypothesis",)),
    Case("s3_twins", "switches", ("fgplan-no-commitment",), corridors=ROUND_S3),
    Case("s4_counterflow", "stopped_fraction", ("fgplan-predicted", "fgplan-no-contact")),
    Case("s4_counterflow", "time", ("fgplan-predicted",), ((DENSER, "21"),)),
    Case("s4_counterflow_heedless", "stopped_fraction", ("fgplan-no-way-out", "fgplan-no-contact")),
    Case("s5_aisle", "time", ("fgplan-no-wait",), corridors=ROUND_S5),
    *(
        Case(
            "s5_aisle",
            "time",
            ("fgplan-no-wait",),
            tuple((BLOCKED.format(i), str(seconds)) for i in (0, 1)),
            ROUND_S5,
        )
        for seconds in (3, 60)
    ),
    *(Case(f"s7_doorway_{width}", "success") for width in (0.6, 0.7, 0.8, 0.9)),
    Case("s8_missed_waypoint", "revisits"),
    Case("s10_discs", "time"),
    Case("s11_goal_change", "stopped_fraction"),
)
SHORT = (Case("s7_doorway_0.8", "success", ("fgplan-one-hypothesis",)),)
MORE_IS_BETTER = ("success",)


def spoilt(case: Case, share: float) -> Case:
    """The case with a share of its observations spoilt."""
    return replace(case, changes=(*case.changes, ("world.faults", str(share))))


def drive(
    cases: Sequence[Case],
    seeds: range,
    planners: Sequence[str] | None = None,
    executor: Executor | None = None,
    store: Path | None = None,
    progress: Progress | None = None,
) -> dict[tuple[str, str], list[Row]]:
    """Rows of runs by scenario and planner; the oracle's corridors are planners, too.

    Args:
        cases: Of the suite.
        seeds: The same for all.
        planners: Who drives; None is everybody the cases name.
        executor, store, progress: As `fgplan.simulation.batch.run_all` takes them.
    """
    jobs: dict[tuple[str, str], list[Job]] = {}
    for case in cases:
        everybody = ("fgplan", *LAYERED, *case.without)
        for name in everybody if planners is None else planners:
            setup = case.setup
            jobs[case.name, name] = [Job(setup, case.name, name, s, setup.version) for s in seeds]
        for corridor, path in case.corridors if planners is None else ():
            made = case.told(corridor, path)
            told = f"{case.name} told {corridor}"
            jobs[case.name, f"told {corridor}"] = [
                Job(made, told, "fgplan", s, made.version) for s in seeds
            ]
    flat = [job for every in jobs.values() for job in every]
    rows = {r["key"]: r for r in run_all(flat, executor, store, progress=progress)}
    return {key: [rows[job.key] for job in every] for key, every in jobs.items()}


def lines(case: Case, driven: dict[tuple[str, str], list[Row]]) -> Iterable[Row]:
    """Yields a row a planner: success and the case's measure with their intervals, and how much
    more of the measure than fgplan on the same seeds."""
    own = {name: rows for (scenario, name), rows in driven.items() if scenario == case.name}
    limit = case.setup(0).rules.time_limit
    if oracle := _oracle(own, limit):
        own["oracle"] = oracle
    ours = own.get("fgplan", [])
    for name, rows in own.items():
        known = [n for n in (value(r, case.measure, limit) for r in rows) if n is not None]
        successes = sum(bool(r["success"]) for r in rows)
        apart = metrics.paired(rows, ours, partial(value, name=case.measure, limit=limit))
        yield {
            "scenario": case.name,
            "planner": name,
            "episodes": len(rows),
            "success": successes / len(rows),
            "success_ci": list(metrics.wilson(successes, len(rows))),
            "collisions": float(np.mean([r["collisions"] for r in rows])),
            "measure": case.measure,
            "value": float(np.mean(known)) if known else None,
            "value_ci": _interval(case.measure, known) if known else None,
            "more_than_fgplan": float(np.mean(apart)) if apart else None,
            "more_than_fgplan_ci": list(metrics.bootstrap(apart)) if apart else None,
            "time": _mean(value(r, "time", limit) for r in rows),
            "path_ratio": _mean(r["path_ratio"] for r in rows),
            "stopped_fraction": float(np.mean([r["stopped_fraction"] for r in rows])),
            "switches": float(np.mean([r["switches"] for r in rows])),
            "most_switches": max(r["switches"] for r in rows),
            "people_delay": _mean(r["people_delay"] for r in rows),
            "unsafe": sum(r["unsafe"] for r in rows),
            "step_ms_p50": _mean(r["step_ms_p50"] for r in rows),
        }


def regrets(cases: Sequence[Case], driven: dict[tuple[str, str], list[Row]]) -> Iterable[Row]:
    """Yields a row a planner and file with an oracle: the time lost to it [s], the mean over the
    file's cases, seed by seed."""
    files = {case.file: [c for c in cases if c.file == case.file] for case in cases}
    for file, alike in files.items():
        lost: dict[str, list[list[float]]] = {}
        for case in alike:
            own = {name: rows for (scenario, name), rows in driven.items() if scenario == case.name}
            limit = case.setup(0).rules.time_limit
            best = _oracle(own, limit)
            for name, rows in own.items() if best else ():
                behind = metrics.paired(rows, best, partial(_time, limit=limit))
                lost.setdefault(name, []).append(behind)
        for name, runs in lost.items():
            numbers = np.mean(runs, axis=0).tolist()
            yield {
                "scenario": f"{file}, all {len(runs)}" if len(runs) > 1 else file,
                "planner": name,
                "episodes": len(numbers),
                "measure": "regret",
                "value": float(np.mean(numbers)),
                "value_ci": list(metrics.bootstrap(numbers)),
            }


def _oracle(own: dict[str, list[Row]], limit: float) -> list[Row]:
    """The best run of each seed of those that were told the way; empty where nobody was."""
    told = [rows for name, rows in own.items() if name.startswith("told ")]
    runs = zip(*told, strict=True)
    return [min(run, key=lambda r: _time(r, limit)) for run in runs]


def value(row: Row, name: str, limit: float) -> float | None:
    """A number of a run; the time of one that does not arrive is the limit, and the length of its
    path None."""
    found = row[name]
    if name == "time":
        return _time(row, limit)
    return None if found is None else float(found)


def _time(row: Row, limit: float) -> float:
    return limit if row["time"] is None else float(row["time"])


def beats(ours: Row, theirs: Row) -> bool:
    """Whether intervals do not overlap, on the better side."""
    if ours["value_ci"] is None or theirs["value_ci"] is None:
        return False
    (low, high), (other_low, other_high) = ours["value_ci"], theirs["value_ci"]
    return bool(low > other_high if ours["measure"] in MORE_IS_BETTER else high < other_low)


def _interval(name: str, numbers: Sequence[float]) -> list[float]:
    if name in metrics.RATES:
        return list(metrics.wilson(int(sum(numbers)), len(numbers)))
    return list(metrics.bootstrap(numbers))


def _mean(values: Iterable[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return float(np.mean(known)) if known else None
