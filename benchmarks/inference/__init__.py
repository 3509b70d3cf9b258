"""Accuracy against cost of every inference method.

Cost is CPU time from the assembled density on, with the time of the solver for those methods that
need optima. Errors are root mean squares over seeds, against a grid or a long run of HMC:

- mean: of the robot's positions, in their own posterior standard deviations;
- mode: energy of the best trajectory above that of the best one known [nats];
- evidence: of log Z [nats].
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from benchmarks.inference.cases import Case, Reference, cases, reference
from fgplan.inference import HMC, MAP, EllipticalSlice, Importance, Inference, Laplace, Progress

BUDGETS = (0.01, 0.1, 1.0, 10.0, 100.0)
"""[s of CPU]"""
SEEDS = 2


@dataclass(frozen=True)
class Row:
    """One method with one setting on one case; errors over seeds, None where there is no number.

    `trusted` says whether no seed came with a warning; `reference_error` is the standard error of
    the log evidence that all are compared with, and `reference_doubts` what that run warned of.
    """

    case: str
    method: str
    draws: int
    seconds: float
    mean_error: float | None
    mode_error: float | None
    evidence_error: float | None
    ess: float | None
    trusted: bool
    reference_error: float
    reference_doubts: tuple[str, ...] = ()


def methods(short: bool) -> Iterator[tuple[str, Inference, bool]]:
    """Name, method, and whether it needs optima."""
    yield "MAP", MAP(), True
    yield "Laplace", Laplace(check=0), True
    yield "Laplace, checked", Laplace(), True
    for draws in (256, 4096) if short else (256, 1024, 4096, 16384):
        yield "importance from prior", Importance(draws, "prior"), False
        yield "importance from linear part", Importance(draws, "linear"), False
        yield "importance around optima", Importance(draws), True
    for draws in (25,) if short else (50, 200):
        yield "elliptical slices", EllipticalSlice(draws=draws, warmup=draws * 2), True
    for draws in (25,) if short else (50,):
        yield "HMC", HMC(draws=draws, warmup=max(50, min(draws, 300))), True


def run(
    short: bool = False, recorded: Path | None = None, progress: Progress | None = None
) -> Iterator[Row]:
    """All cases by all methods."""
    seeds = 1 if short else SEEDS
    for case in cases(short, recorded):
        truth = reference(case, short, progress)
        tried = list(methods(short))
        for i, (name, method, solves) in enumerate(tried):
            if progress is not None:
                progress(f"{case.name}: methods", i, len(tried))
            yield measure(case, truth, name, method, solves, seeds)
        if progress is not None:
            progress(f"{case.name}: methods", len(tried), len(tried))


def measure(
    case: Case, truth: Reference, name: str, method: Inference, solves: bool, seeds: int
) -> Row:
    """One method over some seeds."""
    began = process_time()
    results = [
        method.infer(case.assembly, case.which, case.optima, seed) for seed in range(1, seeds + 1)
    ]
    seconds = (process_time() - began) / seeds + (case.solving if solves else 0.0)
    some = all(r.diagnostics.ess != 0 for r in results)  # else nothing that was drawn can be
    off = [(r.mean[:, case.plane] - truth.mean) / truth.spread for r in results]
    gaps = [max(0.0, float(r.energies.min()) - truth.energy) for r in results]
    log_z = [r.log_evidence for r in results if r.log_evidence is not None]
    sizes = [r.diagnostics.ess for r in results if r.diagnostics.ess is not None]
    return Row(
        case=case.name,
        method=name,
        draws=results[0].diagnostics.draws,
        seconds=seconds,
        mean_error=_rms(np.concatenate(off, axis=None)) if some else None,
        mode_error=_rms(gaps) if some else None,
        evidence_error=_rms([z - truth.log_z for z in log_z]) if len(log_z) == seeds else None,
        ess=float(np.mean(sizes)) if sizes else None,
        trusted=not any(r.warnings for r in results),
        reference_error=truth.error,
        reference_doubts=truth.warnings,
    )


def winners(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """The method with the least error within each budget, by case."""
    table = []
    for case in dict.fromkeys(row.case for row in rows):
        for budget in BUDGETS:
            within = [r for r in rows if r.case == case and r.seconds <= budget]
            if not within:
                continue
            line: dict[str, Any] = {"case": case, "budget_s": budget}
            for what in ("mean", "mode", "evidence"):
                best = _least(within, f"{what}_error")
                line[what] = None if best is None else best.method
                line[f"{what}_error"] = None if best is None else getattr(best, f"{what}_error")
            table.append(line)
    return table


def table(rows: Sequence[Row]) -> list[str]:
    """The winners in Markdown, as the README shows them; without lines that name nobody, or only
    repeat the one before with a larger budget."""
    lines = ["| case | CPU time | best mean [sd] | best log evidence [nats] |", "|---|---|---|---|"]
    before: tuple[str, str, str] | None = None
    for line in winners(rows):
        if line["mean"] is None and line["evidence"] is None:
            continue
        mean, evidence = (
            "–" if line[what] is None else f"{line[what]}: {line[f'{what}_error']:.2g}"
            for what in ("mean", "evidence")
        )
        if (line["case"], mean, evidence) != before:
            lines.append(f"| {line['case']} | {line['budget_s']:g} s | {mean} | {evidence} |")
        before = (line["case"], mean, evidence)
    return lines


def _least(rows: Sequence[Row], key: str) -> Row | None:
    """The row with the least error, the cheapest of equals; none where no row has that number."""
    known = [row for row in rows if getattr(row, key) is not None]
    return min(known, key=lambda row: (getattr(row, key), row.seconds), default=None)


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
