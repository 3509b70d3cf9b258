"""The commands `fgplan simulate` and `fgplan evaluate`."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from fgplan.simulation import crowdnav, recorded
from fgplan.simulation.batch import Job, Measure, cluster, local, run_all
from fgplan.simulation.planners import named
from fgplan.terminal import progress, reported, write

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
