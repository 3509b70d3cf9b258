"""`python -m benchmarks.robots`: iterations of a start and slip of its optimum, by robot model."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict

from rich.console import Console
from rich.progress import track

from benchmarks.robots import run


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all models."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.robots", description=__doc__)
    parser.add_argument("--scenes", type=int, default=128, help="scenes for each row")
    parser.add_argument("--short", action="store_true", help="8 scenes")
    parser.add_argument("--json", choices=["-"], help="- writes JSON to standard output")
    options = parser.parse_args(arguments)
    error = Console(stderr=True)

    def bar(items: Iterable[int]) -> Iterable[int]:
        return track(list(items), console=error, transient=True, disable=not error.is_terminal)

    rows = run(8 if options.short else options.scenes, bar)
    if options.json == "-":
        sys.stdout.write(json.dumps([asdict(row) for row in rows], allow_nan=False) + "\n")
        return
    head = (
        "conv.",
        "within",
        "iter 50",
        "iter 90",
        "ms 50",
        "ms 90",
        "nats 50",
        "slip mm",
        "driven",
    )
    print(f"{'model':20}{'start':10}" + "".join(f"{h:>9}" for h in head))
    for r in rows:
        numbers = [
            f"{r.converged:.3f}", f"{r.within:.3f}", f"{r.iterations_p50:.0f}",
            f"{r.iterations_p90:.0f}", f"{r.ms_p50:.1f}", f"{r.ms_p90:.1f}",
            f"{r.energy_p50:.2f}", f"{r.slip_optimum_mm:.3f}", f"{r.slip_driven_mm:.1e}",
        ]  # fmt: skip
        print(f"{r.model:20}{r.start:10}" + "".join(f"{x:>9}" for x in numbers))


if __name__ == "__main__":
    main()
