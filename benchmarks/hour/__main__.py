"""`python -m benchmarks.hour`: an hour of driving, and another one with spoilt observations."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence

from benchmarks.hour import drive
from fgplan.terminal import progress


def main(arguments: Sequence[str] | None = None) -> None:
    """Drive, and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hour", description=__doc__)
    parser.add_argument("--steps", type=int, default=36_000, help="of 0.1 s (default: %(default)s)")
    parser.add_argument("--faults", type=float, action="append", help="share; again: another run")
    parser.add_argument("--deadline", type=float, help="of a plan [s]; default: none")
    parser.add_argument("--seed", type=int, default=0, help="of the world")
    parser.add_argument("--short", action="store_true", help="20 steps")
    parser.add_argument("--json", choices=["-"], help="- writes JSON to standard output")
    options = parser.parse_args(arguments)
    steps = 20 if options.short else options.steps
    rows = []
    for share in options.faults or [0.0, 0.05]:
        with progress() as tell:
            rows.append(drive(steps, share, options.seed, options.deadline, tell))
    if options.json == "-":
        sys.stdout.write(json.dumps(rows, allow_nan=False) + "\n")
        return
    for row in rows:
        for name, value in row.items():
            print(f"{name:18}{value:.4g}" if isinstance(value, float) else f"{name:18}{value}")
        print()


if __name__ == "__main__":
    main()
