"""A film of one run: people, the plans of all hypotheses, and their probabilities over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray
from PIL import Image

from fgplan.canvas import GOAL, HYPOTHESES, PERSON, ROBOT, Box, draw_grid, draw_region
from fgplan.errors import FgplanError
from fgplan.labels import JOINED
from fgplan.occupancy import OccupancyGrid
from fgplan.simulation.episode import Episode, Moment, run
from fgplan.simulation.policy import Policy
from fgplan.simulation.world import World

Array = NDArray[np.float64]

EVERY = 0.2
"""Between two pictures [s of the run]."""
WIDTH, DPI = 9.0, 80
MARGIN = 1.0
"""Shown around everything that moves, where there is no map [m]."""
HOLD = 1500
"""The last picture stays for this long [ms]."""


class NoFilm(FgplanError, OSError):
    """A film that cannot be written."""


@dataclass(frozen=True, eq=False)
class Shot:
    """What one picture shows.

    Args:
        time: Since the start [s].
        robot: Position, shape (2,) [m].
        people: Positions of those who are there, shape (n, 2) [m].
        radii: Of these people, shape (n,) [m].
        plans: Positions of the plan of each hypothesis by its name, (N, 2) [m].
        probabilities: Of each hypothesis, by height.
        followed: The hypothesis that is followed; None where none is.
        words: Outcome and reason.
        grid: The map as the planner knows it, where this step gave it one.
    """

    time: float
    robot: Array
    people: Array
    radii: Array
    plans: dict[str, Array]
    probabilities: dict[str, float]
    followed: str | None
    words: str
    grid: OccupancyGrid | None = None


def film(world: World, policy: Policy, path: Path) -> Episode:
    """Drive, and write a film of it as a GIF.

    Args:
        world: Made for this run.
        policy: Made for this run.
        path: Of the film.

    Raises:
        NoFilm: the file cannot be written.
    """
    start, shots = _standing(world), list[Shot]()

    def watch(moment: Moment) -> None:
        shots.append(_shot(moment, world))

    episode = run(world, policy, watch)
    pictures = list(_pictures(shots or [start], episode, world))
    pause = round(1000 * EVERY)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        pictures[0].save(
            path,
            format="GIF",
            save_all=True,
            append_images=pictures[1:],
            duration=[pause] * (len(pictures) - 1) + [HOLD],
            loop=0,
        )
    except OSError as error:
        raise NoFilm(f"film: got {str(path)!r}; it cannot be written: {error}") from error
    return episode


def _standing(world: World) -> Shot:
    """Before the first step: all there is to see of a run that ends in it."""
    people, robot = world.people, world.scenario.robot
    there = people.present.copy()
    return Shot(0.0, robot.position, people.positions[there], people.radii[there], {}, {}, None, "")


def _shot(moment: Moment, world: World) -> Shot:
    people, command = moment.people, moment.command
    there = people.present.copy()
    decision, plans, probabilities = command.decision, {}, {}
    words = str(command.outcome)
    if decision is not None:
        words = f"{decision.outcome}: {decision.reason}"
        if decision.mixture is not None:
            mixture = decision.mixture
            for c, p in zip(mixture.components, mixture.probability_height, strict=True):
                plans[c.label] = c.robot.positions
                probabilities[c.label] = float(p)
    return Shot(
        time=moment.observation.time - world.scenario.now,
        robot=np.array(moment.observation.position),
        people=people.positions[there],
        radii=people.radii[there],
        plans=plans,
        probabilities=probabilities,
        followed=command.label,
        words=words,
        grid=moment.observation.grid,
    )


def _pictures(shots: Sequence[Shot], episode: Episode, world: World) -> Iterator[Image.Image]:
    """Yields a picture for every `EVERY` seconds, and the last one."""
    box = _view(episode, world)
    share = (box[3] - box[1]) / (box[2] - box[0])
    height = min(max(0.92 * WIDTH * share, 1.5), 9.0)
    colours = _colours(shots)
    lanes = 2.0 if colours else 0.0
    step = max(1, round(EVERY / world.rules.period))
    shown = sorted({*range(0, len(shots), step), len(shots) - 1})
    grid, after = world.scenario.grid, 0
    for k in shown:
        grid = next((s.grid for s in reversed(shots[after : k + 1]) if s.grid is not None), grid)
        after = k + 1
        figure = Figure(figsize=(WIDTH, height + lanes + 0.8), layout="constrained")
        canvas: Any = FigureCanvasAgg(figure)  # untyped
        rows = [height, lanes] if lanes else [height]
        axes = figure.subplots(len(rows), 1, height_ratios=rows, squeeze=False)[:, 0]
        past = episode.robot[: k + 1, :2]
        last = k == len(shots) - 1
        shot = replace(shots[k], words=f"{episode.end}") if last else shots[k]
        _draw_world(axes[0], shot, (world, grid, past), colours, box)
        if lanes:
            _draw_probabilities(axes[1], shots[: k + 1], colours, float(episode.times[-1]))
        canvas.draw()
        picture = Image.frombuffer("RGBA", canvas.get_width_height(), canvas.buffer_rgba())
        yield picture.convert("RGB").quantize(128, Image.Quantize.MAXCOVERAGE)


def _draw_world(
    axes: Axes,
    shot: Shot,
    known: tuple[World, OccupancyGrid | None, Array],
    colours: dict[str, str],
    box: Box,
) -> None:
    """The map with everything on it."""
    world, grid, past = known
    if world.grid is not None:
        draw_grid(axes, world.grid, 0.35 if grid is not world.grid else 1.0)
    if grid is not None and grid is not world.grid:
        draw_grid(axes, grid, 0.65)
    for region in world.scenario.regions:
        draw_region(axes, region, box)
    for region in world.via:
        vertices = np.array([*region.polygon, region.polygon[0]])
        axes.plot(*vertices.T, color=GOAL, lw=1)
        axes.add_patch(Circle(region.polygon[0], region.radius, fc="none", ec=GOAL, lw=2))
    discs = [Circle(tuple(p), r) for p, r in zip(shot.people, shot.radii, strict=True)]
    axes.add_collection(PatchCollection(discs, fc=PERSON, ec="white", lw=0.5, zorder=4))
    for label, plan in shot.plans.items():
        own = shot.followed in _routes(label)
        width, order = (2.4, 6) if own else (1.4, 5)
        axes.plot(*plan.T, color=colours[label], lw=width, zorder=order)
    axes.plot(*past.T, color=ROBOT, lw=1.0, ls=":", zorder=3)
    radius = world.scenario.robot.radius
    axes.add_patch(Circle(tuple(shot.robot), radius, fc=ROBOT, ec="white", lw=0.8, zorder=7))
    goal = world.scenario.goal
    for event in sorted(world.events, key=lambda event: event.time):
        if event.goal is not None and event.time <= shot.time:
            goal = event.goal
    if goal is not None:
        axes.plot(*goal, marker="*", ms=14, mfc=GOAL, mec="black", mew=0.6, zorder=3)
    axes.set(xlim=(box[0], box[2]), ylim=(box[1], box[3]), aspect="equal")
    _label(axes, "x [m]", "y [m]")
    words = shot.words if len(shot.words) < 100 else f"{shot.words[:97]}..."
    title = f"{world.name}   t = {shot.time:.1f} s\n{words}"
    axes.set_title(title, loc="left", fontsize=8, parse_math=False)


def _draw_probabilities(
    axes: Axes, shots: Sequence[Shot], colours: dict[str, str], end: float
) -> None:
    """The probability of each hypothesis since the start; a band below shows which is followed."""
    times = np.array([shot.time for shot in shots])
    for label, colour in colours.items():
        values = np.array([shot.probabilities.get(label, np.nan) for shot in shots])
        if np.isfinite(values).any():
            style = "--" if "waiting" in label else "-"
            axes.plot(times, values, color=colour, lw=1.5, ls=style, label=label, marker=".", ms=2)
        own = np.array([shot.followed in _routes(label) for shot in shots])
        axes.scatter(times[own], np.full(own.sum(), -0.06), color=colour, s=6, marker="s")
    axes.set(xlim=(0, max(end, EVERY)), ylim=(-0.15, 1.05), yticks=(0, 0.5, 1))
    _label(axes, "time since the start [s]", "probability by height")
    title = "each hypothesis; squares below: the one that is followed, which is bold in the map"
    axes.set_title(title, loc="left", fontsize=8)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=7, frameon=False)


def _label(axes: Axes, x: str, y: str) -> None:
    axes.set_xlabel(x, fontsize=8)
    axes.set_ylabel(y, fontsize=8)
    axes.tick_params(labelsize=7)


def _routes(label: str) -> list[str]:
    """Hypotheses that ended in one optimum have their names joined."""
    return label.split(JOINED)


def _colours(shots: Sequence[Shot]) -> dict[str, str]:
    """Of each hypothesis, in the order of their names; the same in every picture."""
    labels = sorted({label for shot in shots for label in shot.plans})
    return {label: HYPOTHESES[i % len(HYPOTHESES)] for i, label in enumerate(labels)}


def _view(episode: Episode, world: World) -> Box:
    """What is shown: the map, else everything that moves."""
    if world.grid is not None:
        return world.grid.bounds
    points = np.vstack([episode.robot[:, :2], episode.people.reshape(-1, 2), episode.goal])
    points = points[~np.isnan(points[:, 0])]  # nobody there, no goal stated
    low, high = points.min(axis=0) - MARGIN, points.max(axis=0) + MARGIN
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])
