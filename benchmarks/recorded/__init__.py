"""Plans among recorded people: every case of a tier, at three moments of the case each.

It answers whether `plan` copes with real input, and what it costs there: time, iterations, how
many plans consist of converged optima only, how many are feasible.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from fgplan import plan
from fgplan.recordings import Case, Recording, load_cases

MOMENTS = (0.0, 1 / 3, 2 / 3)
"""Shares of a case's duration at which it is planned."""
PERCENTILES = (0, 50, 90, 95, 100)

Row = dict[str, Any]


def run(
    folder: Path,
    tier: str = "core",
    every: int = 1,
    crowd: str = "joint",
    progress: Callable[[Iterable[Case]], Iterable[Case]] = iter,
) -> list[Row]:
    """One row per case and moment.

    Args:
        folder: Recordings, in the layout of `fgplan.recordings`.
        tier: Stratum of the cases.
        every: Take every so manieth case.
        crowd: "joint" or "predicted".
        progress: Wraps the cases, e.g. in a progress bar.
    """
    recordings: dict[str, Recording] = {}
    rows = []
    cases = [case for case in load_cases(folder) if case.tier == tier][::every]
    for case in progress(cases):
        if case.recording not in recordings:
            recordings[case.recording] = Recording.load(folder, case.recording)
        for share in MOMENTS:
            at = share * case.duration
            scenario = recordings[case.recording].scenario(case, at).replace(crowd=crowd)
            rows.append(_row(case, at, plan(scenario)))
    return rows


def _row(case: Case, at: float, mixture: Any) -> Row:
    components = mixture.components
    return {
        "case": case.identity,
        "at_s": at,
        "people": len(components[0].crowd),
        "hypotheses": len(components),
        "iterations": sum(c.iterations for c in components),
        "time_ms": 1e3 * mixture.timing["total"],
        "hypotheses_ms": 1e3 * mixture.timing["hypotheses"],
        "solver_ms": 1e3 * mixture.timing["solver"],
        "selected_converged": mixture.best is not None and mixture.best.converged,
        "all_converged": all(c.converged for c in components),
        "feasible": mixture.selected is not None,
        "action": mixture.action.kind,
        "safe": mixture.action.safe,
        "reason": mixture.action.reason,
    }


def summary(rows: list[Row]) -> list[Row]:
    """Distribution of each number, and the share of each yes."""
    lines = []
    for name in ("people", "hypotheses", "iterations", "time_ms", "hypotheses_ms", "solver_ms"):
        values = np.percentile([row[name] for row in rows], PERCENTILES)
        named = zip(PERCENTILES, values.tolist(), strict=True)
        lines.append({"name": name, **{f"p{p}": value for p, value in named}})
    yes = ("selected_converged", "all_converged", "feasible", "safe")
    shares = [{"name": name, "share": float(np.mean([row[name] for row in rows]))} for name in yes]
    return lines + shares
