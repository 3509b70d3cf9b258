"""The factor graph of a density, to read: as text, and as a Graphviz drawing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

import gtsam

from fgplan import keys
from fgplan.crowd import believe, seen
from fgplan.hypotheses import hypothesise
from fgplan.model import Model, Term, build
from fgplan.obeying import obeying
from fgplan.products import crossed
from fgplan.scenario import Scenario
from fgplan.tactical import of_people
from fgplan.validation import validate

SYMBOLS = {
    "robot now": "p(f^R_0 | z^R)",
    "robot prior": "p(f^R)",
    "crowd now": "p(f_0 | z^f)",
    "crowd prior": "p(f)",
    "interaction": "ψ_int",
    "contact": "ψ_contact",
    "obstacle": "ψ_obs",
    "obstacle between": "ψ_obs",
    "speed limit": "limit",
    "acceleration limit": "limit",
}
"""What a term is in `docs/density.md`; terms of a level are told by their last word."""

LEVEL_SYMBOLS = {"now": "p(η_0 | i)", "prior": "p(η | i)", "coupling": "ψ(η, ·)"}

COLOURS = ("#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#f0e442", "#d55e00", "#bbbbbb")
"""Okabe and Ito's: a colour-blind reader can tell them apart; numbers tell terms of one colour."""

YOURS = "yours"
"""What the user's own factors are called."""

COLUMN, ROW = 1.9, 1.7
"""Between two time steps and between two variables of a drawing [inch]."""


def models(scenario: Scenario, factors: Iterable[gtsam.NonlinearFactor] = ()) -> dict[str, Model]:
    """The density of each hypothesis by its label: what `plan` solves, to look inside.

    Args:
        scenario: What is known now.
        factors: Your own GTSAM factors, as in `plan`.

    Raises:
        ScenarioError: the scenario makes no sense.
        NoRoute: a goal is stated and nothing leads there.
    """
    validate(scenario)
    d = scenario.density
    belief = believe(seen(scenario), scenario.now, d.Qc_people, d.sigma_track, d.sigma_speed)
    stated = hypothesise(scenario, belief)
    scenario = of_people(obeying(scenario), belief)
    proposed = crossed(scenario, stated)
    built = build(scenario, belief, proposed, factors)
    return {h.label: model for h, model in zip(proposed, built, strict=True)}


def describe(model: Model) -> str:
    """Every variable and every term of the density, with the number of GTSAM factors it makes."""
    steps = len(model.times)
    size = sum(variable.dim for variable in model.variables) * steps
    variables = [("variable", "size", "steps", "")]
    for v in model.variables:
        fixed = [str(k) for name, k in model.fixed if name == v.name]
        note = f"known exactly at {', '.join(fixed)}" if fixed else ""
        variables.append((v.name, str(v.dim), _span(range(steps)), note))
    factors = [("factor", "density", "on", "steps", "count", "residual")]
    for term in model.terms:
        row = (term.name, symbol(term), _on(term), _span(term.steps), str(len(term.steps)))
        factors.append((*row, type(term.residual).__name__))
    for name, k in model.fixed:
        factors.append((f"{name} known", "", f"{name}({k})", str(k), "1", "equality"))
    for factor in model.extra:
        on = ", ".join(keys.name(key) for key in factor.keys())
        factors.append((YOURS, "", on, "", "1", type(factor).__name__))
    count = sum(int(row[4]) for row in factors[1:])
    head = f"{len(model.variables) * steps} variables ({size} numbers), {count} factors"
    return "\n\n".join([head, _table(variables, "<><<"), _table(factors, "<<<<><")]) + "\n"


def symbol(term: Term) -> str:
    """The factor of the density that a term is."""
    return SYMBOLS.get(term.name) or LEVEL_SYMBOLS.get(term.name.rpartition(" ")[2], "")


def dot(model: Model) -> str:
    """The factor graph in Graphviz's language: `dot -Tsvg` draws it.

    Time steps are columns, variables rows (mission at the top, people at the bottom). Circles are
    variables, grey where known exactly; squares are factors, with the number of their term.
    """
    rows = {v.name: ROW * i for i, v in enumerate(reversed(model.variables))}
    place = {key: (COLUMN * k, rows[name]) for (name, k), key in model.keys.items()}
    lines = [
        "graph density {",
        '  graph [layout=neato, outputorder=edgesfirst, splines=line, fontname="Helvetica"]',
        '  node [fontname="Helvetica", fontsize=9, style=filled, fixedsize=true]',
        '  edge [color="#888888"]',
    ]
    for (name, k), key in model.keys.items():
        fill = "#cccccc" if (name, k) in model.fixed else "#ffffff"
        look = f'shape=circle, width=0.85, fillcolor="{fill}"'
        lines.append(_node(keys.name(key), place[key], look))
    taken: Counter[tuple[int, ...]] = Counter()
    for square in _squares(model):
        at = _beside([place[key] for key in square.on], taken[square.on])
        taken[square.on] += 1
        look = f'shape=square, width=0.2, label="{square.number}", tooltip={_quoted(square.term)}'
        look += f', fillcolor="{_colour(square.number)}"'
        lines.append(_node(square.name, at, look))
        lines += [f"  {_quoted(square.name)} -- {_quoted(keys.name(key))}" for key in square.on]
    middle = 0.5 * ROW * (len(rows) - 1)
    lines.append(
        _node(
            "legend",
            (-2.6, middle),
            f"shape=plain, fixedsize=false, fillcolor=white, {_legend(model)}",
        )
    )
    return "\n".join([*lines, "}"]) + "\n"


@dataclass(frozen=True)
class _Square:
    """One factor of the drawing: its name, its term and that one's number, and its keys."""

    name: str
    term: str
    number: int
    on: tuple[int, ...]


def _squares(model: Model) -> Iterable[_Square]:
    for number, term in enumerate(model.terms, start=1):
        for k in term.steps:
            on = tuple(model.keys[name, k + offset] for name, offset in term.variables)
            yield _Square(f"{term.name} {k}", term.name, number, on)
    for i, factor in enumerate(model.extra):
        yield _Square(f"{YOURS} {i}", YOURS, len(model.terms) + 1, tuple(factor.keys()))


def _beside(variables: list[tuple[float, float]], nth: int) -> tuple[float, float]:
    """Where the nth factor on the same variables is drawn, so that none hides another."""
    x = sum(point[0] for point in variables) / len(variables)
    y = sum(point[1] for point in variables) / len(variables)
    if len(variables) == 1:
        return x + 0.3 + 0.25 * nth, y + 0.6
    apart = 0.25 * ((nth + 1) // 2) * (-1) ** nth
    along_time = len({point[1] for point in variables}) == 1
    return (x, y + apart) if along_time else (x + apart, y)


def _colour(number: int) -> str:
    return COLOURS[(number - 1) % len(COLOURS)]


def _legend(model: Model) -> str:
    names = [f"{term.name}: {symbol(term)}" for term in model.terms] + [YOURS] * bool(model.extra)
    rows = (
        f'<tr><td bgcolor="{_colour(i)}">{i}</td><td align="left" border="0">{name}</td></tr>'
        for i, name in enumerate(map(escape, names), start=1)
    )
    return f'label=<<table border="0" cellborder="1" cellspacing="2">{"".join(rows)}</table>>'


def _node(name: str, at: tuple[float, float], attributes: str) -> str:
    return f'  {_quoted(name)} [pos="{at[0]:.2f},{at[1]:.2f}!", {attributes}]'


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _on(term: Term) -> str:
    steps = {0: "k", 1: "k+1"}
    return ", ".join(f"{name}({steps.get(o, f'k+{o}')})" for name, o in term.variables)


def _span(steps: range) -> str:
    return f"{steps[0]}..{steps[-1]}" if len(steps) > 1 else str(steps[0])


def _table(rows: Sequence[tuple[str, ...]], align: str) -> str:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = (
        "  ".join(
            f"{cell:{side}{width}}" for cell, side, width in zip(row, align, widths, strict=True)
        )
        for row in rows
    )
    return "\n".join(line.rstrip() for line in lines)
