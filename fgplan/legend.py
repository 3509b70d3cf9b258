"""Beside the map: the probability of each hypothesis, and what the signs mean."""

from __future__ import annotations

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from fgplan.canvas import GOAL, HYPOTHESES, PERSON, REGION, ROBOT
from fgplan.crowd import seen
from fgplan.labels import short
from fgplan.mixture import Mixture
from fgplan.scenario import FieldOfView, Scenario

LONGEST = 28
"""Of a label in a picture [characters]."""


def colours_of(mixture: Mixture) -> list[str]:
    """Of each component, by its label: the same in every picture of the same hypotheses."""
    labels = sorted(c.label for c in mixture.components)
    return [HYPOTHESES[labels.index(c.label) % len(HYPOTHESES)] for c in mixture.components]


def is_narrow(view: FieldOfView | None) -> bool:
    """Whether there is anything that the robot does not see."""
    return view is not None and (np.isfinite(view.range) or view.angle < 2 * np.pi)


def draw_bars(axes: Axes, mixture: Mixture) -> None:
    """P(i) by height and by mass; what is not feasible is named so."""
    where = np.arange(len(mixture.components), dtype=float)
    colours = colours_of(mixture)
    bars, said = [(-0.2, mixture.probability_height, "")], "probability by height"
    if mixture.has_mass:
        bars.append((0.06, mixture.probability_mass, "////"))
        said = "probability (plain: height, hatched: mass)"
    for shift, values, hatch in bars:
        axes.barh(where + shift, values, 0.26, color=colours, hatch=hatch, ec="black", lw=0.6)
        for y, value in zip(where + shift, values, strict=True):
            axes.text(value + 0.02, y, f"{value:.2f}", va="center", fontsize=7)
    for y, component in zip(where, mixture.components, strict=True):  # above: long ones have room
        name = short(component.label, LONGEST) + " – refused" * (not component.feasible)
        axes.text(0.01, y - 0.36, name, va="bottom", fontsize=8.5, parse_math=False)
    axes.set(xlim=(0, 1.2), xticks=(0, 0.5, 1), yticks=())
    axes.set_xlabel(said, fontsize=8)
    axes.set_ylim(max(len(where), 3) - 0.7, -0.8)
    axes.spines[["top", "right"]].set_visible(False)


def draw_legend(axes: Axes, mixture: Mixture, scenario: Scenario) -> None:
    def line(colour: str, style: str | tuple[int, tuple[int, ...]], width: float) -> Line2D:
        return Line2D([], [], color=colour, ls=style, lw=width)

    def disc(fill: str, edge: str, marker: str = "o", size: float = 9) -> Line2D:
        return Line2D([], [], ls="", marker=marker, ms=size, mfc=fill, mec=edge)

    entries: dict[str, Artist] = {
        "robot now": disc(ROBOT, "black"),
        "what will be driven": line("black", "-", 4),
        "a hypothesis: its plan": line(HYPOTHESES[0], "-", 5),
    }
    if any(c.route is not None for c in mixture.components):
        entries["and its route"] = line(HYPOTHESES[0], (0, (5, 3)), 1.2)
    if scenario.goal is not None:
        entries["goal"] = disc(GOAL, "black", "*", 13)
    if is_narrow(scenario.field_of_view):
        entries["field of view"] = Patch(
            fc=to_rgba(ROBOT, 0.05), ec=to_rgba(ROBOT, 0.5), ls=(0, (6, 4)), lw=0.8
        )
    if scenario.regions:
        entries["a region"] = line(REGION, "--", 1.0)
    unseen = len(scenario.tracks) - len(seen(scenario))
    if len(scenario.tracks) > unseen:
        entries["person now"] = disc(PERSON, PERSON)
        entries["seen so far"] = line(PERSON, ":", 1.5)
        entries["predicted, with 2σ"] = line(PERSON, (0, (4, 2)), 1.0)
        if scenario.crowd == "joint":
            entries["planned with the robot"] = line(PERSON, "-", 1.5)
    if unseen:
        entries["person not in view"] = disc("none", "#777777")
    axes.axis("off")
    axes.legend(entries.values(), entries.keys(), loc="upper left", fontsize=8, frameon=False)
