"""`python -m benchmarks.mission`: missions among people, 50 seeds of the delivery scenario."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.mission import runs, summary


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the seeds and print a line a scenario."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mission", description=__doc__)
    parser.add_argument("--scenario", action="append", help="name of a file; may be given again")
    parser.add_argument("--seeds", type=int, default=50, help="how many")
    parser.add_argument("--offset", type=int, default=0, help="the first seed")
    parser.add_argument("--short", action="store_true", help="one seed")
    parser.add_argument("--store", type=Path, help="file of finished runs, not made again")
    parser.add_argument("--json", choices=["-"], help="- writes JSON to standard output")
    options = parser.parse_args(arguments)
    count = 1 if options.short else options.seeds
    seeds = range(options.offset, options.offset + count)

    def tell(what: str, done: int, total: int) -> None:
        sys.stderr.write(f"\r{what}: {done} of {total}")

    names = options.scenario or ["delivery"]
    lines = [summary(runs(name, seeds, options.store, tell)) for name in names]
    sys.stderr.write("\n")
    if options.json == "-":
        sys.stdout.write(json.dumps(lines, allow_nan=False) + "\n")
        return
    for line in lines:
        shown = (f"{k} {v:.1f}" if isinstance(v, float) else f"{k} {v}" for k, v in line.items())
        print("  ".join(shown))


if __name__ == "__main__":
    main()
