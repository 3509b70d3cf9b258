"""`python -m benchmarks.operator` drives S6a, S6b and S6c: by stick, against a stick, to places.

`--json -` prints JSON alone, `--short` is for continuous integration, `--case` drives one of them.
`--gaps SEEDS` compares the choice in S6a with the closed form instead, where one corridor costs
more; `--minutes 60` holds a stick for so long, and prints what is kept of it and what a step costs.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress, TaskID

from benchmarks.operator import CASES, rows
from benchmarks.operator.endurance import held
from benchmarks.operator.gaps import gaps


def main(arguments: Sequence[str] | None = None) -> None:
    """Drive, and print a table for each case."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.operator", description=__doc__)
    parser.add_argument("--short", action="store_true", help="about a minute")
    parser.add_argument("--case", choices=tuple(CASES), help="this one alone")
    parser.add_argument("--gaps", type=int, metavar="SEEDS", help="S6a with corridors not alike")
    parser.add_argument("--minutes", type=float, help="hold a stick for so long instead")
    parser.add_argument("--json", metavar="FILE", help="write JSON to FILE; - is standard output")
    options = parser.parse_args(arguments)
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bars:
        tasks: dict[str, TaskID] = {}

        def tell(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=total)
            bars.update(tasks[what], completed=done)

        if options.minutes is not None:
            found = list(held(options.minutes, tell))
        elif options.gaps is not None:
            found = list(gaps(options.gaps, tell))
        else:
            found = list(rows(options.short, tell, options.case))
    text = json.dumps({"rows": found}, allow_nan=False)
    if options.json == "-":
        sys.stdout.write(text + "\n")
        return
    if options.json:
        Path(options.json).write_text(text + "\n", encoding="utf-8")
    for case in dict.fromkeys(row["case"] for row in found):
        mine = [row for row in found if row["case"] == case]
        names = [name for name in mine[0] if not name.endswith("_ci") and name != "case"]
        print(f"\n{case}\n| {' | '.join(names)} |\n|{'---|' * len(names)}")
        for row in mine:
            print(f"| {' | '.join(_cell(row, name) for name in names)} |")


def _cell(row: dict[str, Any], name: str) -> str:
    value, interval = row[name], row.get(f"{name}_ci")
    shown = f"{value:.3g}" if isinstance(value, float) else str(value)
    if isinstance(value, tuple):
        shown = "; ".join(value)
    return shown if interval is None else "{} [{:.2f}, {:.2f}]".format(shown, *interval)


if __name__ == "__main__":
    main()
