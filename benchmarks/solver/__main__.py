"""`python -m benchmarks.solver`: time of a plan over people, steps and hypotheses.

fgplan's solver, GTSAM's own, CasADi + IPOPT and whitened L-BFGS on the identical density, from the
same starts, in one run. A time holds everything that is done again for every plan: assembling the
density, too. Only what CasADi builds is not in it; that is `build_ms`. "floor" is fgplan's
iterations times one block-tridiagonal factorisation and solve. "fgplan.plan" is the public
function with all its starts and the hard check.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from benchmarks.solver.measure import Effort, Size, asked, rows_of, sizes
from benchmarks.solver.report import draw, findings, table

SHORT = Effort(scenes=3, least=1, seconds=2.0, most=5.0)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and report."""
    options = _parser().parse_args(arguments)
    effort = SHORT if options.short else Effort()
    if options.scenes:
        effort = replace(effort, scenes=options.scenes)
    if options.cpu:
        effort = replace(effort, clock=process_time)
    notes = Console(stderr=True, highlight=False)
    rows = measured(sizes(options.short, options.only), effort, notes)
    if options.json:
        text = json.dumps(rows, indent=2, allow_nan=False) + "\n"
        if options.json == "-":
            sys.stdout.write(text)
        else:
            Path(options.json).write_text(text, encoding="utf-8")
    if options.json != "-":
        wide = None if sys.stdout.isatty() else 140
        Console(width=wide, highlight=False).print(table(rows))
    for line in findings(rows):
        notes.print(line)
    draw(rows, options.picture)
    notes.print(f"{options.picture} written")


def measured(chosen: Sequence[Size], effort: Effort, notes: Console) -> list[dict[str, Any]]:
    """Rows of all sizes, with a progress bar."""
    rows: list[dict[str, Any]] = []
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=notes, transient=True) as bar:
        task = bar.add_task("scenes", total=len(chosen) * effort.scenes)
        for size in chosen:
            bar.update(task, description=f"n={size.n} T={size.T} K={size.K}")
            rows += rows_of(size, effort, notes.print, lambda: bar.advance(task))
    return rows


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.solver",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--json", metavar="FILE", help="write the rows to FILE; - is standard output")
    add("--only", metavar="n,T,K", type=asked, help='one size; or "predicted", or "dense"')
    add("--short", action="store_true", help="a minute: few sizes, few scenes")
    add("--scenes", type=int, metavar="N", help="scenes of a size")
    add("--cpu", action="store_true", help="CPU time, for a machine that does other things")
    add("--picture", type=Path, default=Path("out/solver.png"), help="default: %(default)s")
    return parser


if __name__ == "__main__":
    main()
