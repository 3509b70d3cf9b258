"""`python -m benchmarks.gpmp2` prints a table, with `--json -` JSON alone, or to a file."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.gpmp2 import table


def main(arguments: Sequence[str] | None = None) -> None:
    """Run every case."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gpmp2", description=__doc__)
    parser.add_argument("--json", metavar="FILE", help="write JSON to FILE; - is standard output")
    target = parser.parse_args(arguments).json
    rows = table()
    text = json.dumps(rows, indent=2) + "\n"
    if target == "-":
        sys.stdout.write(text)
        return
    if target:
        Path(target).write_text(text, encoding="utf-8")
    print(f"{'case':14}{'optimizer':20}{'initial error':>20}{'final error':>16}", end="")
    print(f"{'iterations':>12}{'clearance [m]':>15}")
    for row in rows:
        print(f"{row['case']:14}{row['optimizer']:20}{row['initial_error']:20.6f}", end="")
        print(f"{row['final_error']:16.6f}{row['iterations']:12}{row['min_clearance']:15.3f}")


if __name__ == "__main__":
    main()
