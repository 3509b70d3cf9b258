"""`python -m benchmarks.inference` prints which method wins at each budget of CPU time.

`--json -` prints JSON alone, `--short` is for continuous integration, `--picture FILE` draws where
sampling collapses and where Laplace misleads.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.progress import Progress, TaskID

from benchmarks.inference import Row, run, table, winners


def main(arguments: Sequence[str] | None = None) -> None:
    """Run every case."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.inference", description=__doc__)
    parser.add_argument("--short", action="store_true", help="less than a minute")
    parser.add_argument("--json", metavar="FILE", help="write JSON to FILE; - is standard output")
    parser.add_argument("--picture", metavar="FILE", type=Path, help="draw a PNG")
    parser.add_argument(
        "--recordings", type=Path, help="folder of recordings (default: $FGPLAN_PEDESTRIANS)"
    )
    options = parser.parse_args(arguments)
    folder = options.recordings or Path(os.environ.get("FGPLAN_PEDESTRIANS", "-"))
    recorded = folder if (folder / "cases.csv").is_file() else None
    if recorded is None:
        print("skipped: recorded crowd, no recordings are named by --recordings", file=sys.stderr)
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bars:
        tasks: dict[str, TaskID] = {}

        def tell(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=total)
            bars.update(tasks[what], completed=done)

        rows = list(run(options.short, recorded, tell))
        if options.picture is not None:
            from benchmarks.inference.picture import draw

            draw(rows, options.picture, options.short, tell)
    numbers = [asdict(row) for row in rows]
    text = json.dumps({"rows": numbers, "winners": winners(rows)}, allow_nan=False)
    if options.json == "-":
        sys.stdout.write(text + "\n")
        return
    if options.json:
        Path(options.json).write_text(text + "\n", encoding="utf-8")
    _print(rows)


def _print(rows: Sequence[Row]) -> None:
    head = ("CPU s", "mean sd", "mode nats", "evidence nats", "effective", "trusted")
    print(f"{'case':24}{'method':30}{'draws':>8}" + "".join(f"{h:>15}" for h in head))
    for r in rows:
        numbers = (r.seconds, r.mean_error, r.mode_error, r.evidence_error, r.ess)
        cells = "".join(f"{'–' if x is None else f'{x:.3g}':>15}" for x in numbers)
        print(f"{r.case:24}{r.method:30}{r.draws:8}{cells}{'yes' if r.trusted else 'no':>15}")
    for r in {row.case: row for row in rows}.values():
        doubts = "; ".join(r.reference_doubts) or "none"
        print(f"reference of {r.case}: log evidence ± {r.reference_error:.3f}, doubts: {doubts}")
    print()
    print("\n".join(table(rows)))


if __name__ == "__main__":
    main()
