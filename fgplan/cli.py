"""The command line: `fgplan plan`, `fgplan demo`, `fgplan graph`, `fgplan stack`.

Exit codes: 0 there is a plan (or a safe stop, which is printed as one), 1 there is none, 2 the
input makes no sense.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from fgplan import selection
from fgplan.inference import METHODS
from fgplan.inference.laplace import QUICK
from fgplan.mixture import Mixture
from fgplan.planner import plan
from fgplan.printing import inferences, notes, show
from fgplan.scenario import Scenario
from fgplan.simulation import command
from fgplan.solver import GtsamLM, SecondOrder, Solver
from fgplan.terminal import expect, fail, file_of, progress, reported, write

app = typer.Typer(
    help="Plans for robots among people, as inference on a factor graph.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
app.command("simulate")(command.simulate)
app.add_typer(command.evaluate, name="evaluate")


class SolverName(StrEnum):
    """What optimises."""

    SECOND_ORDER = "second-order"
    GTSAM = "gtsam"


class SelectName(StrEnum):
    """What selects."""

    HEIGHT = "height"
    MASS = "mass"


class CrowdName(StrEnum):
    """What people do in the density."""

    JOINT = "joint"
    PREDICTED = "predicted"


class InferenceName(StrEnum):
    """What gives each hypothesis its evidence."""

    MAP = "map"
    LAPLACE = "laplace"
    IMPORTANCE = "importance"
    MCMC = "mcmc"
    HMC = "hmc"


SOLVERS: dict[SolverName, Solver] = {
    SolverName.SECOND_ORDER: SecondOrder(),
    SolverName.GTSAM: GtsamLM(),
}
RULES = {SelectName.HEIGHT: selection.height, SelectName.MASS: selection.mass}


@app.command("plan")
def plan_command(
    scenario: Annotated[Path | None, typer.Argument(help="Scenario file (TOML).")] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for plan.json and plan.png (default: out; with --json: none)."),
    ] = None,
    json_to: Annotated[
        str | None,
        typer.Option("--json", help="Write the JSON to a file; - is standard output, alone."),
    ] = None,
    solver: Annotated[SolverName, typer.Option(help="Optimiser.")] = SolverName.SECOND_ORDER,
    select: Annotated[SelectName, typer.Option(help="Follow the plan best by.")] = (
        SelectName.HEIGHT
    ),
    crowd: Annotated[
        CrowdName | None,
        typer.Option(help="Plan people with the robot, or hold them at their prediction."),
    ] = None,
    recording: Annotated[Path | None, typer.Option(help="Folder of recorded people.")] = None,
    case: Annotated[str | None, typer.Option(help="Case of the recordings.")] = None,
    at: Annotated[float, typer.Option(help="Seconds after the start of the case.")] = 0.0,
    inference: Annotated[
        InferenceName | None,
        typer.Option(help="What weighs hypotheses by mass (default: laplace, unchecked)."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of a sampler.", min=0)] = 0,
) -> None:
    """Plan one scenario, or one moment of a recording: table, plan.json and plan.png."""
    if inference is InferenceName.MAP and select is SelectName.MASS:
        raise typer.BadParameter("map gives no evidence to select by", param_hint="--inference")
    data = file_of(json_to)
    folder = Path("out") if out is None and json_to is None else out
    expect(data)
    if folder is not None:
        _expect_plan(folder, "plan")
    with reported():
        asked = _asked(scenario, recording, case, at)
        if crowd is not None:
            asked = asked.replace(crowd=crowd.value)
        with progress() as tell:
            mixture = plan(
                asked, solver=SOLVERS[solver], select=RULES[select],
                inference=QUICK if inference is None else METHODS[inference],
                seed=seed, progress=tell,
            )  # fmt: skip
    if json_to == "-":
        print(_json(mixture))
        for line in notes(mixture):
            print(line, file=sys.stderr)
    else:
        show(mixture)
        if inference is not None:
            print("\n".join(inferences(mixture)))
    written = []
    if data is not None:
        written.append(write(data, _json(mixture)))
    if folder is not None:
        written += _save(mixture, asked, folder, "plan")
    if written and json_to != "-":
        print(f"wrote     {', '.join(map(str, written))}")
    if not mixture.action.safe:
        raise typer.Exit(1)


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for pictures and JSON.")] = Path("out/demo"),
    data: Annotated[
        Path | None, typer.Option(help="The data folder of the source tree (default: found).")
    ] = None,
) -> None:
    """Three corridors without and with people: the crowd changes which one is chosen."""
    folder = data or Path(__file__).parents[1] / "data"
    files = [folder / "scenarios" / f"three_corridors{end}.toml" for end in ("", "_crowd")]
    if not all(file.is_file() for file in files):
        fail(
            f"the demo needs {files[0].name} and {files[1].name} of the source tree, which are "
            f"not in {folder / 'scenarios'}; name its data folder with --data"
        )
    for file in files:
        _expect_plan(out, file.stem)
    picture = out / "five_people.png"
    expect(picture)
    plans = []
    for file in files:
        with reported():
            asked = Scenario.load(file)
            plans.append((plan(asked), asked))
        show(plans[-1][0])
        _save(*plans[-1], out, file.stem)
        print()
    from fgplan.plotting import draw_plans

    draw_plans(plans, picture)
    (empty, _), (crowded, asked) = plans
    print(f"wrote     {picture}, and each plan as .json and .png beside it")
    sentence, flipped = _verdict(empty, crowded, len(asked.tracks))
    print(sentence)
    if not flipped:
        raise typer.Exit(1)


@app.command()
def graph(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (TOML).")],
    hypothesis: Annotated[
        str | None, typer.Option(help="Label of the hypothesis (default: the first).")
    ] = None,
    out: Annotated[Path, typer.Option(help="Graphviz file: .dot, .gv or .txt.")] = Path(
        "out/graph.dot"
    ),
) -> None:
    """Print the factor graph of a hypothesis, and draw it: .dot, and .svg where Graphviz is."""
    from fgplan import drawing

    expect(out, ".dot", ".gv", ".txt")
    with reported():
        models = drawing.models(Scenario.load(scenario))
    label = hypothesis or next(iter(models))
    if label not in models:
        raise typer.BadParameter(
            f"{label!r} is none of {', '.join(models)}", param_hint="hypothesis"
        )
    print(f"hypothesis {label}: {drawing.describe(models[label])}")
    written = [write(out, drawing.dot(models[label]))]
    program = shutil.which("dot")
    if program is not None:
        picture = out.with_suffix(".svg")
        subprocess.run([program, "-Tsvg", str(out), "-o", str(picture)], check=True)
        written.append(picture)
    print(f"wrote     {', '.join(map(str, written))}")


@app.command()
def stack(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (TOML).")],
    hypothesis: Annotated[
        str | None, typer.Option(help="Label of the hypothesis (default: the first).")
    ] = None,
    out: Annotated[Path, typer.Option(help="Picture: .png, .svg or .pdf.")] = Path("out/stack.png"),
) -> None:
    """Print the stack of levels and what each coupling is for; draw it beside its graph."""
    from fgplan import stack_drawing
    from fgplan.factorisation import factorise

    expect(out, ".png", ".svg", ".pdf")
    with reported():
        asked = Scenario.load(scenario)
        try:
            report = factorise(asked, hypothesis)
        except KeyError as error:
            raise typer.BadParameter(error.args[0], param_hint="--hypothesis") from None
        print(stack_drawing.describe(asked, report))
        stack_drawing.draw(asked, out)
    print(f"wrote     {out}")


def _asked(scenario: Path | None, recording: Path | None, case: str | None, at: float) -> Scenario:
    """The scenario that the arguments name."""
    if (scenario is None) == (recording is None):
        raise typer.BadParameter("give a scenario file, or --recording with --case")
    if scenario is not None:
        if case is not None or at:
            raise typer.BadParameter("--case and --at are for a --recording")
        return Scenario.load(scenario)
    if recording is None or case is None:
        raise typer.BadParameter("--recording needs a --case")
    from fgplan import recordings

    return recordings.scenario(recording, case, at)


def _json(mixture: Mixture) -> str:
    return json.dumps(mixture.to_dict(), allow_nan=False)


def _expect_plan(folder: Path, stem: str) -> None:
    """Whether `_save` will be able to."""
    expect(folder / f"{stem}.json")
    expect(folder / f"{stem}.png")


def _save(mixture: Mixture, scenario: Scenario, folder: Path, stem: str) -> list[Path]:
    """The plan as JSON and as a picture."""
    from fgplan.plotting import draw_plan  # matplotlib only when something is drawn

    data = write(folder / f"{stem}.json", _json(mixture))
    picture = folder / f"{stem}.png"
    draw_plan(mixture, scenario, picture)
    return [data, picture]


def _verdict(empty: Mixture, crowded: Mixture, people: int) -> tuple[str, bool]:
    """Whether the crowd changes which corridor is chosen, in one sentence."""
    before, after = empty.best, crowded.best
    if before is None or after is None:
        return "The demo shows nothing: no hypothesis is safe.", False

    def chance(mixture: Mixture, label: str) -> float:
        return sum(
            float(p)
            for c, p in zip(mixture.components, mixture.probability_height, strict=True)
            if c.label == label
        )

    was, now = before.label, after.label
    if was == now:
        return f"The crowd does not change the corridor: {was} is chosen with and without.", False
    return (
        f"Without people corridor {was} is chosen (P = {chance(empty, was):.2f} against "
        f"{chance(empty, now):.2f} for {now}); with {people} people in the way it is {now} "
        f"(P = {chance(crowded, now):.2f} against {chance(crowded, was):.2f} for {was}): "
        "the crowd changes which corridor is chosen.",
        True,
    )


def main() -> None:
    """Entry point of the `fgplan` program."""
    app(prog_name="fgplan")


if __name__ == "__main__":
    main()
