"""`python -m benchmarks.suite`: S1 to S11 in closed loop, a row a planner and scenario."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.suite import SHORT, SUITE, beats, drive, lines, regrets, spoilt
from fgplan.simulation.batch import local
from fgplan.terminal import progress


def main(arguments: Sequence[str] | None = None) -> None:
    """Drive, and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.suite", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="how many (default: %(default)s)")
    parser.add_argument("--only", action="append", help="cases whose name begins so; again")
    parser.add_argument("--planner", action="append", help="who drives (default: all); again")
    parser.add_argument("--faults", type=float, metavar="SHARE", help="of observations spoilt")
    parser.add_argument("--store", type=Path, help="finished runs, as `fgplan simulate` keeps them")
    parser.add_argument("--workers", type=int, default=1, help="runs side by side")
    parser.add_argument("--short", action="store_true", help="one doorway, two seeds")
    parser.add_argument("--json", choices=["-"], help="- writes JSON to standard output")
    options = parser.parse_args(arguments)
    cases, seeds = (SHORT, range(2)) if options.short else (SUITE, range(options.seeds))
    if options.only:
        cases = tuple(c for c in cases if any(c.name.startswith(o) for o in options.only))
    if options.faults is not None:
        cases = tuple(spoilt(case, options.faults) for case in cases)
    with local(options.workers) as executor, progress() as tell:
        driven = drive(cases, seeds, options.planner, executor, options.store, tell)
    rows = [line for case in cases for line in lines(case, driven)]
    regret = list(regrets(cases, driven))
    if options.json == "-":
        sys.stdout.write(json.dumps(rows + regret, allow_nan=False) + "\n")
        return
    print("\n".join(table(rows)))
    for row in regret:
        between = _between(row["value_ci"])
        print(f"{row['scenario']}: {row['planner']} loses {row['value']:.2f} s {between}")


def table(rows: Sequence[dict[str, Any]]) -> list[str]:
    """As Markdown."""
    head = ("scenario", "planner", "runs", "success", "contacts", "measure", "more than fgplan",
            "time s", "stopped", "switches", "step ms")  # fmt: skip
    out = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for row in rows:
        more, own = row["more_than_fgplan"], row["planner"] == "fgplan"
        apart = "" if more is None or own else f"{more:+.2f} {_between(row['more_than_fgplan_ci'])}"
        ours = [r for r in rows if (r["scenario"], r["planner"]) == (row["scenario"], "fgplan")]
        mark = " *" if ours and not own and beats(ours[0], row) else ""
        step = row["step_ms_p50"]
        cells = (
            row["scenario"], row["planner"], str(row["episodes"]),
            f"{row['success']:.2f} {_between(row['success_ci'])}", f"{row['collisions']:.2f}",
            f"{row['measure']} {_number(row['value'], row['value_ci'])}{mark}", apart,
            f"{row['time']:.1f}", f"{row['stopped_fraction']:.2f}", f"{row['switches']:.1f}",
            "" if step is None else f"{step:.0f}",
        )  # fmt: skip
        out.append(f"| {' | '.join(cells)} |")
    return [*out, "", "\\* fgplan's interval lies wholly on the better side"]


def _number(value: float | None, interval: Sequence[float] | None) -> str:
    return "–" if value is None or interval is None else f"{value:.2f} {_between(interval)}"


def _between(interval: Sequence[float]) -> str:
    return "({:.2f}–{:.2f})".format(*interval)


if __name__ == "__main__":
    main()
