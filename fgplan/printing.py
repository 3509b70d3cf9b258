"""A plan on a terminal: the table of hypotheses, what is selected, and what to do."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator
from typing import TYPE_CHECKING

from fgplan.labels import lines
from fgplan.mixture import Component, Mixture

if TYPE_CHECKING:
    from rich.table import Table

WIDTH = 120
"""Least columns of a table: a number must not be cut."""
FREE = 42
"""Of these, what numbers leave for the label and the verdict."""
LONGEST = 22
"""Of a line of a label [characters]."""
HEADS = (
    "prior\nw",
    "energy\nnats",
    "log\nevidence",
    "P by\nheight",
    "P by\nmass",
    "separation\nm",
    "clearance\nm",
    "itera-\ntions",
    "time\nms",
    "\noptima",
)
"""Of the numbers of a hypothesis, with their units; see `docs/conventions.md`."""
YIELDS = 0.05
"""A displacement from here on is worth naming [standard deviations]."""


def show(mixture: Mixture) -> None:
    """The table of hypotheses, what is selected, and what to do."""
    from rich.console import Console

    columns = shutil.get_terminal_size((WIDTH, 40)).columns
    Console(highlight=False, width=max(columns, WIDTH)).print(_table(mixture))
    print(f"selected  {_selected(mixture.best)}")
    action = mixture.action
    (x, y), (vx, vy) = action.position, action.velocity
    print(
        f"action    {action.kind}: velocity ({vx:.2f}, {vy:.2f}) m/s, "
        f"next position ({x:.2f}, {y:.2f}) m in {action.time:g} s"
    )
    for line in notes(mixture):
        print(line)


def notes(mixture: Mixture) -> Iterator[str]:
    """What to know before driving."""
    if mixture.action.kind == "stop":
        clear = "clear of people and obstacles" if mixture.action.safe else "NOT CLEAR"
        yield f"STOP      {clear}; {mixture.action.reason}"
    for warning in mixture.warnings:
        yield f"note      {warning}"


def _selected(best: Component | None) -> str:
    if best is None:
        return "none"
    moved = [f"{name} by {far:.1f} σ" for name, far in best.displacement.items() if far >= YIELDS]
    asks = f"; asks people to yield: {', '.join(moved)}" if moved else ""
    return f"{best.label} (from the start {best.start!r}){asks}"


def _table(mixture: Mixture) -> Table:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    total = 1e3 * mixture.timing["total"]
    title = Text(f"{mixture.name} ({total:.0f} ms)")
    table = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", padding=(0, 1, 0, 0))
    labels = ["\n  ".join(lines(c.label, LONGEST)) for c in mixture.components]
    longest = max(len(line) for label in labels for line in label.splitlines())
    least = min(max(longest, 8), LONGEST) + 2
    table.add_column("hypothesis", min_width=least, overflow="fold")
    for head in HEADS:
        table.add_column(head, justify="right", no_wrap=True)
    table.add_column("feasible", min_width=min(24, FREE - least), overflow="fold")
    rows = zip(
        mixture.components, mixture.probability_height, mixture.probability_mass, strict=True
    )
    for i, (c, height, mass) in enumerate(rows):
        mark = "*" if i == mixture.selected else " "
        by_mass = f"{mass:.3f}" if mixture.has_mass else "–"
        numbers = [*_weights(c), f"{height:.3f}", by_mass, *_counts(c)]
        verdict = "yes" if c.feasible else "no: " + ", ".join(c.check.problems)
        style = "bold" if i == mixture.selected else None
        table.add_row(Text(f"{mark} {labels[i]}"), *numbers, Text(verdict), style=style)
    return table


def _weights(c: Component) -> list[str]:
    evidence = "–" if c.log_evidence is None else f"{c.log_evidence:.3f}"
    return [f"{math.exp(c.log_prior):.3f}", f"{c.energy:.3f}", evidence]


def _counts(c: Component) -> list[str]:
    def metres(value: float) -> str:
        return f"{value:.2f}" if math.isfinite(value) else "–"

    return [
        metres(c.check.min_separation),
        metres(c.check.clearance),
        str(c.iterations),
        f"{1e3 * c.seconds:.1f}",
        str(c.optima),
    ]


def inferences(mixture: Mixture) -> Iterator[str]:
    """What the inference method says of each hypothesis."""
    for c in mixture.components:
        if c.inferred is None:
            continue
        result, d = c.inferred, c.inferred.diagnostics
        evidence = "none" if result.log_evidence is None else f"{result.log_evidence:.3f}"
        error = result.log_evidence_error
        parts = [f"log evidence {evidence}" + ("" if error is None else f" ± {error:.3f}")]
        if d.ess is not None:
            drawn = d.draws if d.chains else d.energies
            parts.append(f"{d.ess:.0f} effective of {drawn} draws")
        if d.rhat is not None:
            parts.append(f"split R-hat {d.rhat:.3f}")
        yield f"inference {c.label} by {result.method}: {', '.join(parts)}"
