"""`python -m benchmarks.goals` prints how soon it is known where an operator is going.

`--json -` prints JSON alone, `--short` is for continuous integration, `--picture FILE` draws the
reliability diagram.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import Progress, TaskID

from benchmarks.goals import BINS, Row, as_dict, run


def main(arguments: Sequence[str] | None = None) -> None:
    """Drive, and print a row for each number of candidates."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.goals", description=__doc__)
    parser.add_argument("--short", action="store_true", help="less than a minute")
    parser.add_argument("--json", metavar="FILE", help="write JSON to FILE; - is standard output")
    parser.add_argument("--picture", metavar="FILE", type=Path, help="draw a PNG")
    options = parser.parse_args(arguments)
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bars:
        tasks: dict[str, TaskID] = {}

        def tell(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=total)
            bars.update(tasks[what], completed=done)

        rows = list(run(options.short, tell))
    if options.picture is not None:
        draw(rows, options.picture)
    text = json.dumps({"rows": [as_dict(row) for row in rows]}, allow_nan=False)
    if options.json == "-":
        sys.stdout.write(text + "\n")
        return
    if options.json:
        Path(options.json).write_text(text + "\n", encoding="utf-8")
    print("| candidates | operator | runs | P ≥ 0.9 after, median | 90 % | never | ECE |")
    print("|---|---|---|---|---|---|---|")
    for r in rows:
        print(
            f"| {r.candidates} | {r.hand} | {r.runs} | {r.known_after_p50:.0%} of the path "
            f"| {r.known_after_p90:.0%} | {r.never:.0%} | {r.error:.3f} |"
        )


def draw(rows: Sequence[Row], path: Path) -> None:
    """The reliability diagram of each row as a PNG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.2 * len(rows), 3.4), layout="constrained")
    for axes, row in zip(figure.subplots(1, len(rows), squeeze=False)[0], rows, strict=True):
        axes.plot([0, 1], [0, 1], color="0.7", lw=1)
        total = sum(count for *_, count in row.reliability)
        for mean, share, count in row.reliability:
            axes.bar(
                mean, share, width=0.8 / BINS, color="tab:blue", alpha=0.25 + 0.75 * count / total
            )
            axes.text(mean, 0.02, str(count), ha="center", fontsize=6)
        axes.set(
            title=f"{row.candidates} candidates, {row.hand}\nECE {row.error:.3f}",
            xlabel="probability of the most probable", ylabel="share that is right",
            xlim=(0, 1.05), ylim=(0, 1.05), aspect="equal",
        )  # fmt: skip
        axes.title.set_fontsize(8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
