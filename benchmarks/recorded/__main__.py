"""`python -m benchmarks.recorded --data FOLDER` prints distributions, `--json -` the rows."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import track

from benchmarks.recorded import PERCENTILES, run, summary


def main(arguments: Sequence[str] | None = None) -> None:
    """Plan every case of a tier."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.recorded", description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of the recordings")
    parser.add_argument("--tier", default="core")
    parser.add_argument("--crowd", choices=("joint", "predicted"), default="joint")
    parser.add_argument("--every", type=int, default=1, help="every so manieth case only")
    parser.add_argument("--json", metavar="FILE", help="write the rows to FILE; - is stdout")
    options = parser.parse_args(arguments)
    error = Console(stderr=True)

    def bar(cases):
        return track(cases, description="cases", console=error)

    rows = run(options.data, options.tier, options.every, options.crowd, bar)
    if options.json == "-":
        sys.stdout.write(json.dumps(rows, allow_nan=False) + "\n")
        return
    if options.json:
        Path(options.json).write_text(json.dumps(rows, allow_nan=False) + "\n", encoding="utf-8")
    print(f"{len(rows)} plans, {len({row['case'] for row in rows})} cases")
    print(f"{'':20}" + "".join(f"{f'p{p}':>10}" for p in PERCENTILES))
    for line in summary(rows):
        if "share" in line:
            print(f"{line['name']:20}{line['share']:10.3f}")
        else:
            print(f"{line['name']:20}" + "".join(f"{line[f'p{p}']:10.1f}" for p in PERCENTILES))
    for row in rows:
        if not row["feasible"]:
            print(f"{row['case']} at {row['at_s']:.1f} s: {row['reason']}")


if __name__ == "__main__":
    main()
