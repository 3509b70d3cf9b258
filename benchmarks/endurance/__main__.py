"""`python -m benchmarks.endurance`: memory over 10,000 plans, and how deadlines are kept."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence

from rich.console import Console
from rich.progress import track

from benchmarks.endurance import deadlines, growth, memory


def main(arguments: Sequence[str] | None = None) -> None:
    """Run both."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.endurance", description=__doc__)
    parser.add_argument("--plans", type=int, default=10_000, help="plans of the memory run")
    parser.add_argument("--late", type=int, default=300, help="plans for each deadline")
    parser.add_argument("--json", choices=["-"], help="- writes JSON to standard output")
    options = parser.parse_args(arguments)
    error = Console(stderr=True)

    def bar(items):
        return track(items, console=error)

    grown, kept = memory(options.plans, bar), deadlines(options.late, bar=bar)
    if options.json == "-":
        sys.stdout.write(json.dumps({"memory": grown, "deadlines": kept}, allow_nan=False) + "\n")
        return
    for row in grown:
        print(f"after {row['plans']:6.0f} plans: {row['rss_mb']:7.1f} MB")
    print(f"growth over the run: {growth(grown):+.2f} MB")
    for row in kept:
        print("  ".join(f"{name} {value:.2f}" for name, value in row.items()))


if __name__ == "__main__":
    main()
