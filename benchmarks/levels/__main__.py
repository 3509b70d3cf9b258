"""`python -m benchmarks.levels`: time of a plan by the number of levels; to compile a mission."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence

from rich.console import Console
from rich.progress import track

from benchmarks.levels import SHAPES, compiled, growth, measure


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print a line a size, and a line a shape."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.levels", description=__doc__)
    parser.add_argument("--repeats", type=int, default=15, help="plans of each size")
    parser.add_argument("--short", action="store_true", help="two of each")
    parser.add_argument("--json", choices=["-"], help="- writes JSON to standard output")
    options = parser.parse_args(arguments)
    repeats = 2 if options.short else options.repeats
    error = Console(stderr=True)

    def bar(items):
        return track(items, console=error)

    rows = {shape: measure(repeats, shape, bar) for shape in SHAPES}
    lines = [growth(of, name) | {"of": name} for of in rows.values() for name in NUMBERS]
    mission = compiled(repeats)
    every = [row for of in rows.values() for row in of]
    if options.json == "-":
        found = {"plans": every, "growth": lines, "mission": mission}
        sys.stdout.write(json.dumps(found, allow_nan=False) + "\n")
        return
    for row in [*every, *lines, mission]:
        print(
            "  ".join(
                f"{k} {v:.3f}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()
            )
        )


NUMBERS = ("plan_ms", "iteration_ms")


if __name__ == "__main__":
    main()
