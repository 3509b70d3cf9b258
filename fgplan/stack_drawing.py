"""A declared stack and the graphical model that is read off from it: as text, and side by side in
one picture, as the paper draws them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isfinite, isinf
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fgplan.drawing import COLOURS, models, symbol
from fgplan.factorisation import Report
from fgplan.measuring import Measurement
from fgplan.model import Model
from fgplan.obeying import obeying
from fgplan.scenario import Level, Scenario
from fgplan.stack import ROBOT, coupling_name, links, name_of, parent

SHOWN = 4
"""Time steps of the graphical model that are drawn: it repeats."""
Style = dict[str, Any]

SIZE = (13.0, 1.2)
"""Width of the picture, and height of a row [inch]."""


def describe(scenario: Scenario, report: Report) -> str:
    """The stack, the density that is read off from it, and what each coupling is for.

    Args:
        scenario: What is known now.
        report: From `fgplan.factorisation.factorise`.
    """
    levels = scenario.levels
    count = f"{len(levels)} level" + "s" * (len(levels) > 1)
    head = f"{scenario.name}: {count} above the robot"
    rows = [("level", "guided by", "prior", "meets", "hypotheses", "data")]
    for i, level in enumerate(levels):
        above = parent(levels, i)
        rows.append(
            (
                level.name,
                "–" if above is None else f"{levels[above].name}, h {levels[above].h:g} m²",
                prior_of(level, i == 0),
                f"every {level.every * scenario.density.dt:g} s",
                hypotheses_of(scenario, i),
                ", ".join(_data(scenario, level.name, i == 0)) or "–",
            )
        )
    guides = [f"{levels[x.above].name}, h {x.h:g} m²" for x in links(levels) if x.below is None]
    d = scenario.density
    robot = f"acceleration, Qc {d.Qc_robot:g} m²/s³"
    data = ", ".join(_data(scenario, ROBOT, False)) or "–"
    rows.append((ROBOT, "; ".join(guides), robot, f"every {d.dt:g} s", "", data))
    parts = [("what is asked", "held by")]
    parts += [(held.text, ", ".join(sorted(held.levels)) or "nobody now") for held in report.held]
    table = [("coupling", "needed for", "joins", "KL nats", "of the robot")]
    for c in report.couplings:
        need = "; ".join(c.carries) or "nothing: not needed"
        numbers = (f"{c.divergence:.3f}", f"{c.divergence_robot:.3f}")
        table.append((f"{c.above} – {c.below}", need, "; ".join(c.joins) or "–", *numbers))
    blocks = [head, _table(rows), f"p(i, …) ∝ {' '.join(_product(scenario))}", _table(parts)]
    closing = [
        f"KL: of the density of hypothesis {report.hypothesis} from the one without the coupling.",
        *_infinite(report),
    ]
    return "\n\n".join([*blocks, _table(table), "\n".join(closing)]) + "\n"


def _infinite(report: Report) -> Iterator[str]:
    """What an infinite divergence means, in words: no Gaussian is left without the coupling."""
    if any(isinf(c.divergence_robot) for c in report.couplings):
        yield "inf of the robot: only the coupling makes this plan an optimum. Without it, what"
        yield "pushes away (people, obstacles) outweighs what holds: no Gaussian to compare."
    if any(isinf(c.divergence) and isfinite(c.divergence_robot) for c in report.couplings):
        yield "inf, but not of the robot: only the coupling holds a level that the robot can spare."


def prior_of(level: Level, is_first: bool) -> str:
    """p(η_l) in words."""
    if level.sigma == 0:
        return "its plan, exactly" if is_first or level.plans else "the plan, exactly"
    if isfinite(level.sigma):
        return f"around its plan, σ {level.sigma:g} m over {level.length:g} s"
    if level.Qc is None:
        return "flat"
    return f"smooth, Qc {level.Qc:g} m²/s³"


def hypotheses_of(scenario: Scenario, index: int) -> str:
    """The discrete choices of a level."""
    if index > 0:
        return ", ".join(plan.label for plan in scenario.levels[index].plans) or "–"
    given = [plan.label for plan in scenario.plans]
    if scenario.mission is not None:
        given.append(f"{scenario.count} best of {scenario.mission.text}")
    elif scenario.goal is not None and scenario.count:
        given.append(f"{scenario.count} routes")
    return ", ".join(given) or "–"


def draw(scenario: Scenario, path: str | Path | None = None) -> Figure:
    """The stack on the left, the graphical model of its first hypothesis on the right.

    Args:
        scenario: What is known now.
        path: Where to save the picture (its suffix says how: .png, .svg, .pdf); None: nowhere.

    Raises:
        ScenarioError, NoRoute, MissionError: as `fgplan.plan`.
    """
    label, model = next(iter(models(scenario).items()))
    names = _rows(scenario, model)
    figure = Figure(figsize=(SIZE[0], SIZE[1] * (len(names) + 1.5)), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[1, 1.6])
    _draw_stack(left, scenario, names)
    _draw_model(right, scenario, model, names)
    left.set_title(f"{scenario.name}: the stack", loc="left", fontsize=11, parse_math=False)
    title = f"its graphical model, hypothesis {label}, steps 0 to {_last(model)}"
    right.set_title(title, loc="left", fontsize=11, parse_math=False)
    if path is not None:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=110)
    return figure


def _rows(scenario: Scenario, model: Model) -> list[str]:
    """Rows of both halves, top down: levels, robot, people."""
    people = ["people"] if scenario.tracks else []
    return [*(level.name for level in scenario.levels), ROBOT, *people]


def _last(model: Model) -> int:
    return min(SHOWN, len(model.times)) - 1


def _draw_stack(axes: Axes, scenario: Scenario, names: Sequence[str]) -> None:
    levels, height = scenario.levels, {name: -float(i) for i, name in enumerate(names)}
    box: Style = {"boxstyle": "round,pad=0.5", "fc": "#eaf3fa", "ec": "#0072b2"}
    plain: Style = {"fontsize": 9, "parse_math": False, "va": "center"}
    for i, name in enumerate(names):
        text = name
        if i < len(levels):
            text = f"{name}\n{prior_of(levels[i], i == 0)}"
            choices = hypotheses_of(scenario, i)
            if choices != "–":
                axes.text(0.0, height[name] + 0.36, _cut(choices), ha="center", **plain)
        axes.text(0.0, height[name], text, ha="center", bbox=box, zorder=3, **plain)
        data = [] if name == "people" else list(_data(scenario, name, i == 0))
        for j, one in enumerate(data):
            y = height[name] + 0.2 * (j - (len(data) - 1) / 2)
            axes.text(0.98, y, one, ha="left", color="#d55e00", **plain)
            axes.plot([0.3, 0.95], [height[name], y], color="#d55e00", lw=0.8, zorder=1)
    for link in links(levels):
        above, below = levels[link.above].name, name_of(levels, link.below)
        far = height[above] - height[below] > 1.5  # past the rows in between
        style = "arc3,rad=0.45" if far else "arc3"
        arrow: Style = {
            "arrowstyle": "-|>",
            "color": "#0072b2",
            "connectionstyle": style,
            "shrinkA": 16,
        }
        ends = (0.0, height[below] + 0.12), (0.0, height[above] - 0.1)
        axes.annotate("", *ends, arrowprops=arrow)
        x = -0.4 - 0.25 * (height[above] - height[below] - 1.0) if far else 0.05
        y = (height[above] + height[below]) / 2
        axes.text(x, y - 0.05, f"h {link.h:g} m²", color="#0072b2", **plain)
    if "people" in height:
        ends = (0.0, height["people"] + 0.12), (0.0, height[ROBOT] - 0.1)
        axes.annotate("", *ends, arrowprops={"arrowstyle": "<|-|>", "color": "#d55e00"})
    axes.set(xlim=(-1.3, 2.0), ylim=(-len(names) + 0.4, 0.6))
    axes.axis("off")


def _draw_model(axes: Axes, scenario: Scenario, model: Model, names: Sequence[str]) -> None:
    """Circles are variables, grey where known; squares are factors, coloured by their term."""
    row = {f"level {i}": -float(i) for i in range(len(scenario.levels))}
    row |= {"robot": -float(names.index(ROBOT)), "crowd": -float(names.index(names[-1]))}
    last = _last(model)
    taken: set[tuple[float, float]] = set()
    for i, name in enumerate(names):
        variable = f"level {i}" if i < len(scenario.levels) else "crowd" * (name == "people")
        held = "predicted" if name == "people" else "its plan"
        if variable and variable not in model.columns:
            axes.axhline(row.get(variable, -float(i)), color="#bbbbbb", lw=1, ls=":", zorder=0)
            axes.text(-0.55, -float(i) + 0.1, f"{name}: {held}", fontsize=8, parse_math=False)
    for variable in model.columns:
        for k in range(last + 1):
            known = (variable, k) in model.fixed
            circle: Style = {"s": 620, "marker": "o", "ec": "black", "lw": 1.0, "zorder": 3}
            axes.scatter([k], [row[variable]], fc="#cccccc" if known else "white", **circle)
            text = f"{_letter(variable)}{k}"
            axes.text(k, row[variable], text, ha="center", va="center", fontsize=8, zorder=4)
    handles: dict[str, Any] = {}
    plans = {
        coupling_name(scenario.levels, link): -float(link.above)
        for link in links(scenario.levels)
        if f"level {link.above}" not in model.columns
    }
    for number, term in enumerate(model.terms, start=1):
        colour = COLOURS[(number - 1) % len(COLOURS)]
        for k in term.steps:
            places = [(k + offset, row[name]) for name, offset in term.variables]
            if max(x for x, _ in places) > last:
                continue
            if term.name in plans:  # its other side is a plan, not a variable
                places.append((k, plans[term.name]))
            at = _free(places, taken)
            taken.add(at)
            for place in places:
                axes.plot(*zip(place, at, strict=True), color="#888888", lw=0.7, zorder=1)
            square: Style = {
                "marker": "s",
                "s": 62,
                "fc": colour,
                "ec": "black",
                "lw": 0.6,
                "zorder": 2,
            }
            mark = axes.scatter([at[0]], [at[1]], **square)
            axes.text(*at, str(number), ha="center", va="center", fontsize=5.5, zorder=3)
            handles.setdefault(f"{number}  {term.name}: {symbol(term)}".rstrip(": "), mark)
    axes.legend(
        list(handles.values()), list(handles), loc="center left", bbox_to_anchor=(1.0, 0.5),
        fontsize=8, frameon=False,
    )  # fmt: skip
    axes.set(xlim=(-0.6, last + 0.7), ylim=(-len(names) + 0.4, 0.6))
    axes.axis("off")


def _free(
    places: Sequence[tuple[float, float]], taken: set[tuple[float, float]]
) -> tuple[float, float]:
    """Where a factor is drawn: between its variables, beside one alone; none hides another."""
    x, y = np.mean(places, axis=0).tolist()
    if len(places) == 1:
        x, y = x + 0.17, y - 0.3
    along = len({b for _, b in places}) == 1 and len(places) > 1
    step = (0.0, 0.14) if along else (0.12, 0.0)
    place = (round(x, 3), round(y, 3))
    while place in taken:
        place = (round(place[0] + step[0], 3), round(place[1] + step[1], 3))
    return place


def _letter(variable: str) -> str:
    known = {"robot": "r", "crowd": "f"}
    return known.get(variable) or f"η{variable.removeprefix('level ')},"


def _data(scenario: Scenario, name: str, is_first: bool) -> Iterator[str]:
    """What measures a level or the robot, by kind and region; its mission's rules among them."""
    for m in obeying(scenario).data:
        if m.on == name or (m.on is None and is_first):
            yield _called(m)


def _called(measurement: Measurement) -> str:
    region = getattr(measurement, "region", None)
    kind = type(measurement).__name__
    return kind if region is None else f"{kind} {region.name}"


def _product(scenario: Scenario) -> Iterator[str]:
    """The factors of the density, by the names of the levels."""
    levels = scenario.levels
    yield "w_i"
    for i, level in enumerate(levels):
        if isfinite(level.sigma):
            yield f"· p({level.name} | i)"
        elif level.Qc is not None:
            yield f"· p({level.name})"
        if list(_data(scenario, level.name, i == 0)):
            yield f"· p(data | {level.name})"
    for link in links(levels):
        yield f"· ψ({levels[link.above].name}, {name_of(levels, link.below)})"
    yield "· p(robot)"
    if scenario.tracks:
        yield "· p(people) · ψ_int(robot, people)"


def _cut(text: str, longest: int = 44) -> str:
    return text if len(text) <= longest else f"{text[: longest - 1]}…"


def _table(rows: Sequence[tuple[str, ...]]) -> str:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = ("  ".join(f"{cell:<{w}}" for cell, w in zip(row, widths, strict=True)) for row in rows)
    return "\n".join(line.rstrip() for line in lines)
