"""`python -m benchmarks.optimum`: the gap of a plan's energy to the best known.

The best known of a scene comes from 64 random starts of each hypothesis with two optimisers, and
from all the plans compared. A plan is made cold, warm (after a plan one step before), and under
deadlines of 20, 50 and 100 ms. What is known is kept beside the result and not computed again.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from benchmarks.optimum.best import STARTS
from benchmarks.optimum.measure import Row, best_of_all, made, rows_of, summary, write_rows
from benchmarks.optimum.scenes import Scene, random_scene, recorded_scenes

RECORDINGS = Path(__file__).resolve().parents[3] / "shared" / "data" / "pedestrians"
"""Where the recordings are looked for, beside the repository."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and report."""
    options = _parser().parse_args(arguments)
    notes = Console(stderr=True, highlight=False)
    scenes = _scenes(options, notes)
    rows = _rows(scenes, options, notes)
    write_rows(options.csv, rows, list(rows[0]))
    result = summary(rows)
    if options.json:
        text = json.dumps(result, indent=2, allow_nan=False) + "\n"
        if options.json == "-":
            sys.stdout.write(text)
        else:
            Path(options.json).write_text(text, encoding="utf-8")
    if options.json != "-":
        Console(width=None if sys.stdout.isatty() else 120, highlight=False).print(_table(result))
    notes.print(f"{options.csv} written")


def _scenes(options: argparse.Namespace, notes: Console) -> list[Scene]:
    random, recorded = (3, 2) if options.short else (200, 100)
    random = random if options.random is None else options.random
    recorded = recorded if options.recorded is None else options.recorded
    scenes = [random_scene(seed) for seed in range(random)]
    if recorded and not (options.recordings / "cases.csv").is_file():
        notes.print("recorded scenes left out: no cases.csv found; --recordings names the folder")
    elif recorded:
        scenes += recorded_scenes(options.recordings, recorded)
    return scenes


def _rows(scenes: Sequence[Scene], options: argparse.Namespace, notes: Console) -> list[Row]:
    """Plans first, by themselves, since they are timed; then the searches, in parallel."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    starts = 4 if options.short else STARTS
    with Progress(*columns, TimeElapsedColumn(), console=notes, transient=True) as bar:
        planning = bar.add_task("plans", total=len(scenes))
        searching = bar.add_task("best known", total=len(scenes))
        planned = {}
        for scene in scenes:
            planned[scene.name] = made(scene)
            bar.advance(planning)
        cache = options.csv.with_name(f"{options.csv.stem}-best.csv")
        now = {name: scenario for name, (scenario, _) in planned.items()}
        known = best_of_all(now, starts, cache, options.jobs, lambda: bar.advance(searching))
    return [
        row
        for name, (scenario, plans) in planned.items()
        for row in rows_of(name, scenario, plans, known[name])
    ]


def _table(rows: Sequence[Row]) -> Table:
    headings = ("scenes", "mode", "count", "close", "gap p50", "gap p95", "stops in vain", "p50 ms")
    shown = Table(*headings, "late p99 ms", box=None, pad_edge=False)
    for column in shown.columns:
        column.justify = "left" if column.header in {"scenes", "mode"} else "right"
    for row in rows:
        numbers = [_number(row[key], 4) for key in ("gap_p50", "gap_p95")]
        times = [_number(row[key], 1) for key in ("p50_ms", "late_p99_ms")]
        counts = [str(row["count"]), f"{100 * row['close']:.0f} %"]
        shown.add_row(
            row["scenes"], row["mode"], *counts, *numbers, str(row["stops_in_vain"]), *times
        )
    return shown


def _number(value: Any, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.optimum",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--json", metavar="FILE", help="write the summary to FILE; - is standard output")
    add("--csv", type=Path, default=Path("out/optimum.csv"), help="default: %(default)s")
    add("--short", action="store_true", help="few scenes, four random starts: below a minute")
    add("--random", type=int, metavar="N", help="random scenes, 200 by default")
    add("--recorded", type=int, metavar="N", help="recorded scenes, 100 by default")
    folder = Path(os.environ.get("FGPLAN_PEDESTRIANS", RECORDINGS))
    add("--recordings", type=Path, default=folder, help="folder of recordings")
    add("--jobs", type=int, default=os.cpu_count() or 1, help="processes; default: %(default)s")
    return parser


if __name__ == "__main__":
    main()
