"""The commands `fgplan simulate` and `fgplan evaluate`."""

from __future__ import annotations

import csv
import io
import json
import shutil
import sys
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from fgplan.simulation import crowdnav, metrics, recorded
from fgplan.simulation.batch import Job, Measure, cluster, local, run_all
from fgplan.simulation.file import FromFile
from fgplan.simulation.planners import named
from fgplan.terminal import expect, file_of, progress, reported, write

evaluate = typer.Typer(
    help="Drive a public benchmark: CrowdNav, or recorded people.", no_args_is_help=True
)

PlannerName = Annotated[str, typer.Option(help="Who drives; see docs/simulation.md.")]
Workers = Annotated[int, typer.Option(help="Runs side by side.", min=1)]
Scheduler = Annotated[
    str | None, typer.Option(help="Address of a dask scheduler: run on its workers instead.")
]
Store = Annotated[
    Path | None,
    typer.Option(help="File of finished runs (JSON lines): what is in it is not run again."),
]
JsonTo = Annotated[
    str | None,
    typer.Option("--json", help="Write the JSON to a file; - is standard output, alone."),
]


class Layout(StrEnum):
    """Where people of CrowdNav cross."""

    CIRCLE = "circle"
    SQUARE = "square"


COLUMNS = {
    "success": "success", "collisions": "colli-\nsions", "time": "time\ns",
    "path_ratio": "path\nratio", "min_separation": "separation\nm",
    "stopped_fraction": "stopped", "switches": "switches", "people_delay": "delay of\npeople s",
    "step_ms_p50": "step p50\nms", "step_ms_p99": "step p99\nms",
}  # fmt: skip
"""Of the table of `simulate`, with their heads."""


def simulate(
    scenario: Annotated[list[Path], typer.Argument(help="Simulation files.")],
    planner: Annotated[
        list[str], typer.Option(help="Who drives; may be given again. See docs/simulation.md.")
    ] = ["fgplan"],  # noqa: B006 - typer's own way
    seeds: Annotated[int, typer.Option(help="How many, from --seed-offset on.", min=1)] = 20,
    seed_offset: Annotated[int, typer.Option(help="The first seed.", min=0)] = 0,
    change: Annotated[
        list[str] | None,
        typer.Option("--set", help="Change a key of the files: world.people[0].count=12."),
    ] = None,
    operator: Annotated[
        str | None,
        typer.Option(help="Who holds a stick, or a log of Joy messages; see docs/simulation.md."),
    ] = None,
    json_to: JsonTo = None,
    csv_to: Annotated[
        Path | None, typer.Option("--csv", help="Write a line a run to a CSV file.")
    ] = None,
    gif: Annotated[
        Path | None, typer.Option(help="Write a film of the first seed of the first planner.")
    ] = None,
    store: Store = None,
    workers: Workers = 1,
    scheduler: Scheduler = None,
) -> None:
    """Drive in simulated worlds: a row a planner and scenario, on the same seeds."""
    expect(file_of(json_to))
    expect(csv_to)
    expect(gif, ".gif")
    expect(store)
    with reported():
        makers = [named(name) for name in planner]
        stick = [] if operator is None else [f"world.operator={operator}"]
        setups = [FromFile(path, _changes([*(change or []), *stick])) for path in scenario]
        for setup in setups:
            world = setup(seed_offset)
            for maker in makers:  # who cannot drive there says so before anybody does
                maker(world)
        every = range(seed_offset, seed_offset + seeds)
        jobs = [
            Job(setup, setup.name, name, seed, setup.version)
            for setup in setups for name in planner for seed in every
        ]  # fmt: skip
        rows = _run(jobs, metrics.row, store, workers, scheduler)
        if gif is not None:
            from fgplan.simulation.animation import film

            world = setups[0](seed_offset)
            film(world, makers[0](world), gif)
    lines = []
    for setup in setups:
        for name in planner:
            own = [r for r in rows if (r["scenario"], r["planner"]) == (setup.name, name)]
            lines.append({"scenario": setup.name, "planner": name, **metrics.summary(own)})
    if json_to == "-":
        print(json.dumps(lines, allow_nan=False))
    else:
        _table(lines)
    written = [] if gif is None else [gif]
    data = file_of(json_to)
    if data is not None:
        written.append(write(data, json.dumps(lines, allow_nan=False)))
    if csv_to is not None:
        written.append(write(csv_to, _csv(rows)))
    if written and json_to != "-":
        print(f"wrote     {', '.join(map(str, written))}")
    _complain(rows)


@evaluate.command("crowdnav")
def evaluate_crowdnav(
    planner: PlannerName = "fgplan",
    cases: Annotated[int, typer.Option(help="How many.", min=1)] = 500,
    seed_offset: Annotated[
        int, typer.Option(help="Seed of the first; 1000 begins the published test cases.", min=0)
    ] = 1000,
    people: Annotated[int, typer.Option(help="How many.", min=1)] = 5,
    layout: Annotated[Layout, typer.Option(help="Where people cross.")] = Layout.CIRCLE,
    visible: Annotated[
        bool, typer.Option("--visible/--invisible", help="Whether people see the robot.")
    ] = False,
    varied: Annotated[bool, typer.Option(help="Draw people's radii and largest speeds.")] = False,
    json_to: JsonTo = None,
    store: Store = None,
    workers: Workers = 1,
    scheduler: Scheduler = None,
) -> None:
    """CrowdNav's crossing, by its published rules and cases."""
    expect(file_of(json_to))
    expect(store)
    with reported():
        named(planner)
        setup = crowdnav.CrowdNav(people, layout.value, visible, varied)
        jobs = [
            Job(setup, setup.name, planner, seed)
            for seed in range(seed_offset, seed_offset + cases)
        ]
        rows = _run(jobs, crowdnav.measure, store, workers, scheduler)
    line = {"planner": planner, "scenario": setup.name, "seed_offset": seed_offset}
    _tell([{**line, **crowdnav.summary(rows)}], json_to)


@evaluate.command("recorded")
def evaluate_recorded(
    data: Annotated[Path, typer.Option(help="Folder of the recordings.")],
    out: Annotated[Path, typer.Option(help="CSV file: case_id, t, x, y.")],
    planner: PlannerName = "fgplan",
    tier: Annotated[str | None, typer.Option(help="Stratum of the cases (default: all).")] = None,
    store: Store = None,
    workers: Workers = 1,
    scheduler: Scheduler = None,
) -> None:
    """Drive in the place of recorded people, for the recordings' own evaluation to judge."""
    expect(out)
    expect(store)
    with reported():
        named(planner)
        setup = recorded.Recorded(data.resolve(), tier)
        jobs = [
            Job(setup, f"recorded {case.identity}", planner, seed)
            for seed, case in enumerate(setup.cases)
        ]
        rows = _run(jobs, recorded.measure, store, workers, scheduler)
    write(out, recorded.table(rows))
    print(
        f"wrote     {out}: {len(rows)} cases, {sum(r['end'] == 'goal' for r in rows)} at the goal"
    )
    _complain(rows)


def _run(
    jobs: Sequence[Job],
    measure: Measure,
    store: Path | None,
    workers: int,
    scheduler: str | None,
) -> list[dict[str, Any]]:
    """Run on this machine, or on a cluster."""
    place: AbstractContextManager[Executor | None]
    place = local(workers) if scheduler is None else cluster(scheduler)
    with place as executor, progress() as tell:
        return run_all(jobs, executor, store, measure, tell)


def _changes(stated: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Keys and values of --set."""
    pairs = [text.partition("=") for text in stated]
    for text, (key, sign, _) in zip(stated, pairs, strict=True):
        if not key or not sign:
            raise typer.BadParameter(f"{text!r} is not KEY=VALUE", param_hint="--set")
    return tuple((key, value) for key, _, value in pairs)


def _table(lines: Sequence[dict[str, Any]]) -> None:
    """A row a planner and scenario; below each number its interval."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("scenario", min_width=18, overflow="fold")
    table.add_column("planner", no_wrap=True)
    for head in ("runs", *COLUMNS.values()):
        table.add_column(head, justify="right", no_wrap=True)
    for line in lines:
        cells = []
        for name in COLUMNS:
            value, interval = line[name], line[f"{name}_ci"]
            between = "" if interval is None else "\n{:.2f}–{:.2f}".format(*interval)
            cells.append("–" if value is None else f"{value:.2f}{between}")
        table.add_row(line["scenario"], line["planner"], str(line["episodes"]), *cells)
    Console(highlight=False, width=max(160, shutil.get_terminal_size().columns)).print(table)


def _csv(rows: Sequence[dict[str, Any]]) -> str:
    """A line a run."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().rstrip("\n")


def _tell(lines: Sequence[dict[str, Any]], json_to: str | None) -> None:
    """Rows as JSON or as a table."""
    text = json.dumps(lines[0] if len(lines) == 1 else lines, allow_nan=False)
    if json_to == "-":
        print(text)
        return
    if json_to is not None:
        write(Path(json_to), text)
    for line in lines:
        for name, value in line.items():
            if name.endswith("_ci"):
                continue
            interval = line.get(f"{name}_ci")
            shown = f"{value:.4g}" if isinstance(value, float) else str(value)
            between = "" if interval is None else "  [{:.4g}, {:.4g}]".format(*interval)
            print(f"{name:18}{shown}{between}")


def _complain(rows: Sequence[dict[str, Any]]) -> None:
    """What planners raised, on standard error."""
    for row in rows:
        if row["error"]:
            print(f"fgplan: {row['world']}: {row['error']}", file=sys.stderr)
