"""Pictures of a plan: the map, the people, every hypothesis, and when the robot will be where.

Figures are matplotlib's `Figure` objects: no pyplot, no global state, no display.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse, Wedge
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from fgplan.canvas import GOAL, PERSON, ROBOT, Box, draw_grid, draw_region
from fgplan.crowd import Belief, believe, heading, seen
from fgplan.labels import place, short
from fgplan.legend import LONGEST, colours_of, draw_bars, draw_legend, is_narrow
from fgplan.mixture import Component, Mixture
from fgplan.scenario import Scenario, Track
from fgplan.timing import arc_length
from fgplan.trajectory import Trajectory

Array = NDArray[np.float64]

WIDTH = 12.0
"""Of a figure [inch]."""
MAP_SHARE = 0.7
"""Of it, what the map has at most."""
LETTERS = 9.0, 12.0
"""Letters an inch, of a title and of a label."""
MARGIN = 1.0
"""Shown around everything that moves [m]."""
NARROWEST = 6.0
"""Least width and height of what is shown [m]."""
NEAREST = 0.29
"""Between two numbers along a plan [inch]."""
ELLIPSES = (0.25, 0.5)
"""Shares of the horizon at which a prediction's 2σ ellipse is drawn."""


def draw_plan(mixture: Mixture, scenario: Scenario, path: str | Path | None = None) -> Figure:
    """One plan: the map with everything on it, and the probability of each hypothesis.

    Args:
        mixture: What `plan` returned.
        scenario: What it was asked.
        path: Where to save the picture (its suffix says how: .png, .svg, .pdf); None: nowhere.
    """
    return draw_plans([(mixture, scenario)], path)


def draw_plans(plans: Sequence[tuple[Mixture, Scenario]], path: str | Path | None = None) -> Figure:
    """Several plans below each other, to compare; otherwise as `draw_plan`."""
    boxes = [_view(mixture, scenario) for mixture, scenario in plans]
    shares = [min((b[3] - b[1]) / (b[2] - b[0]), 1.0) for b in boxes]
    titles = [_title(mixture, box) for (mixture, _), box in zip(plans, boxes, strict=True)]
    heights = [
        max(MAP_SHARE * WIDTH * share, 3.0) + 1.3 + 0.25 * title.count("\n")
        for share, title in zip(shares, titles, strict=True)
    ]
    figure = Figure(figsize=(WIDTH, sum(heights)), layout="constrained")
    rows = figure.subfigures(len(plans), 1, height_ratios=heights, squeeze=False)[:, 0]
    for row, (mixture, scenario), box, height, title in zip(
        rows, plans, boxes, heights, titles, strict=True
    ):
        bars_share = min((0.6 + 0.5 * max(len(mixture.components), 3)) / height, 0.6)
        picture, bars, legend = row.subplot_mosaic(
            [["map", "bars"], ["map", "legend"]],
            width_ratios=(3.4, 1),
            height_ratios=(bars_share, 1 - bars_share),
        ).values()
        _draw_map_panel(picture, mixture, scenario, box)
        draw_bars(bars, mixture)
        draw_legend(legend, mixture, scenario)
        picture.set_title(title, loc="left", fontsize=12, fontweight="bold", parse_math=False)
    if path is not None:
        figure.savefig(path, dpi=110, bbox_inches="tight", pad_inches=0.15)
    return figure


def _title(mixture: Mixture, box: Box) -> str:
    """What is done, in lines that are no longer than the map; what is in brackets stays whole."""
    best, i = mixture.best, mixture.selected
    if best is None or i is None:
        stop = "" if mixture.action.safe else ", and the stop is NOT CLEAR"
        text = f"{mixture.name}: stops, no hypothesis is safe{stop}"
    else:
        chance = f"(P = {mixture.probability_height[i]:.2f} by height"
        if mixture.has_mass:
            chance += f", {mixture.probability_mass[i]:.2f} by mass"
        text = f"{mixture.name}: selected {short(best.label, LONGEST)} "
        text += f"{chance})".replace(" ", _GLUE)
    room = max(int(LETTERS[0] * (box[2] - box[0]) / _metres(box)), 30)
    return textwrap.fill(text, room, break_long_words=False).replace(_GLUE, " ")


_GLUE = "\N{NO-BREAK SPACE}"


def _metres(box: Box) -> float:
    """Those of an inch of the picture."""
    return max(box[2] - box[0], box[3] - box[1]) / (MAP_SHARE * WIDTH)


def _view(mixture: Mixture, scenario: Scenario) -> Box:
    """What is shown: everything that moves or is meant to, inside the map."""
    points = [scenario.robot.position[None], mixture.trajectory.positions]
    points += [c.robot.positions for c in mixture.components]
    points += [c.route for c in mixture.components if c.route is not None]
    points += [track.positions[-1:] for track in seen(scenario)]
    if scenario.goal is not None:
        points.append(scenario.goal[None])
    every = np.vstack(points)
    low, high = every.min(axis=0) - MARGIN, every.max(axis=0) + MARGIN
    middle, half = (low + high) / 2, np.maximum((high - low) / 2, NARROWEST / 2)
    low, high = middle - half, middle + half
    if scenario.grid is not None:
        bounds = np.array(scenario.grid.bounds)
        low = np.maximum(low, np.minimum(bounds[:2], every.min(axis=0)))
        high = np.minimum(high, np.maximum(bounds[2:], every.max(axis=0)))
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _draw_map_panel(axes: Axes, mixture: Mixture, scenario: Scenario, box: Box) -> None:
    d = scenario.density
    times = colormaps["cividis"]
    scale = Normalize(0.0, float(mixture.trajectory.times[-1]))
    if scenario.grid is not None:
        draw_grid(axes, scenario.grid)
    _draw_field_of_view(axes, scenario, box)
    for region in scenario.regions:
        draw_region(axes, region, box)
    for component, colour in zip(mixture.components, colours_of(mixture), strict=True):
        _draw_hypothesis(axes, component, colour)
    _draw_names(axes, mixture, scenario, box)
    tracks = seen(scenario)
    for track in scenario.tracks:
        _draw_track(axes, track, any(track is one for one in tracks))
    belief = believe(tracks, scenario.now, d.Qc_people, d.sigma_track, d.sigma_speed)
    _draw_prediction(axes, belief, d.horizon)
    seconds = _seconds(d.horizon)
    shown = mixture.best or mixture.components[0]
    for person in shown.crowd.values():
        if scenario.crowd == "joint":
            axes.plot(*person.at(_fine(person)).T[:2], color=PERSON, lw=1.5, zorder=5)
        x, y = person.at(seconds).T[:2]
        axes.scatter(x, y, c=seconds, cmap=times, norm=scale, s=16, ec=PERSON, lw=0.8, zorder=6)
    _draw_ends(axes, scenario)
    _draw_driven(axes, mixture.trajectory, times, scale)
    _draw_seconds(axes, mixture.trajectory, seconds, (times, scale), NEAREST * _metres(box))
    axes.set(
        xlim=(box[0], box[2]), ylim=(box[1], box[3]), aspect="equal", xlabel="x [m]", ylabel="y [m]"
    )


def _draw_field_of_view(axes: Axes, scenario: Scenario, box: Box) -> None:
    view = scenario.field_of_view
    if view is None or not is_narrow(view):
        return
    reach = min(view.range, 2 * float(np.hypot(box[2] - box[0], box[3] - box[1])))
    middle, half = np.degrees(heading(scenario)), np.degrees(min(view.angle, 2 * np.pi)) / 2
    x, y = scenario.robot.position
    for look in (
        {"fc": ROBOT, "ec": "none", "alpha": 0.05},
        {"fc": "none", "ec": ROBOT, "alpha": 0.5, "ls": (0, (6, 4)), "lw": 0.8},
    ):
        axes.add_patch(Wedge((x, y), reach, middle - half, middle + half, zorder=1, **look))  # type: ignore[arg-type]


def _draw_hypothesis(axes: Axes, component: Component, colour: str) -> None:
    """Its route, thin and dashed, and the plan it came to, wide and faint."""
    if component.route is not None:
        axes.plot(*component.route.T, color=colour, lw=1.2, ls=(0, (5, 3)), zorder=2)
    positions = component.robot.at(_fine(component.robot))[:, :2]
    axes.plot(*positions.T, color=colour, lw=5, alpha=0.55, solid_capstyle="round", zorder=3)


def _draw_names(axes: Axes, mixture: Mixture, scenario: Scenario, box: Box) -> None:
    """Label and probability of each hypothesis, where it does not hide another, a person, the
    robot or the goal."""
    routes = [
        c.robot.positions if c.route is None else _resampled(c.route) for c in mixture.components
    ]
    marks = [scenario.robot.position[None], mixture.trajectory.positions]
    marks += [track.positions[-1:] for track in scenario.tracks]
    marks += [c.robot.positions[-1:] for c in mixture.components]
    if scenario.goal is not None:
        marks.append(scenario.goal[None])
    corners, colours = np.reshape(box, (2, 2)), colours_of(mixture)
    for i, component in enumerate(mixture.components):
        text = f"{short(component.label, LONGEST)}  {mixture.probability_height[i]:.2f}"
        half = _metres(box) * np.array([len(text) / LETTERS[1] + 0.2, 0.3]) / 2
        others = [route for j, route in enumerate(routes) if j != i]
        x, y = place(routes[i], half, np.vstack(marks), others, corners)
        marks.append(np.array([x, y]) + half * _AROUND)
        look = {"boxstyle": "round,pad=0.25", "fc": "white", "ec": colours[i], "lw": 1.5}
        axes.text(
            x, y, text, ha="center", va="center", fontsize=10, zorder=9, parse_math=False, bbox=look
        )


_AROUND = np.stack(np.meshgrid(np.linspace(-1, 1, 9), [-1, 0, 1]), axis=-1).reshape(-1, 2)
"""Points of a label, for the next ones to keep away from."""


def _draw_track(axes: Axes, track: Track, is_seen: bool) -> None:
    colour = PERSON if is_seen else "#777777"
    axes.plot(*track.positions.T, color=colour, lw=1.5, ls=":", zorder=4)
    x, y = track.positions[-1]
    fill = colour if is_seen else "none"
    axes.add_patch(Circle((x, y), track.radius, fc=fill, ec=colour, alpha=0.45, zorder=4))
    axes.text(
        x,
        y,
        track.identity,
        fontsize=7,
        ha="center",
        va="center",
        zorder=7,
        clip_on=True,
        parse_math=False,
    )


def _draw_prediction(axes: Axes, belief: Belief, horizon: float) -> None:
    """Where each person goes by itself: mean, and 2σ at some times."""
    means, _ = belief.predict(np.linspace(0.0, horizon, 20))
    for i in range(belief.count):
        axes.plot(*means[:, i, :2].T, color=PERSON, lw=1.0, ls=(0, (4, 2)), zorder=4)
    means, covariances = belief.predict(horizon * np.array(ELLIPSES))
    for mean, covariance in zip(
        means[..., :2].reshape(-1, 2), covariances[..., :2, :2].reshape(-1, 2, 2), strict=True
    ):
        values, vectors = np.linalg.eigh(covariance)
        width, height = 4 * np.sqrt(values)
        tilt = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
        where = (mean[0], mean[1])
        axes.add_patch(
            Ellipse(where, width, height, angle=tilt, fc="none", ec=PERSON, alpha=0.5, lw=0.7)
        )


def _draw_ends(axes: Axes, scenario: Scenario) -> None:
    robot = scenario.robot
    x, y = robot.position
    axes.add_patch(Circle((x, y), robot.radius, fc=ROBOT, ec="black", lw=0.8, zorder=8))
    nose = robot.radius * np.array([np.cos(heading(scenario)), np.sin(heading(scenario))])
    axes.plot([x, x + nose[0]], [y, y + nose[1]], color="white", lw=1.5, zorder=8)
    if scenario.goal is not None:
        x, y = scenario.goal
        axes.scatter([x], [y], marker="*", s=260, c=GOAL, ec="black", lw=0.9, zorder=8)


def _draw_driven(axes: Axes, driven: Trajectory, times: Colormap, scale: Normalize) -> None:
    """What will be driven: bold, coloured by time."""
    t = _fine(driven)
    positions = driven.at(t)[:, :2]
    axes.plot(*positions.T, color="black", lw=6, solid_capstyle="round", zorder=6.5)
    pieces = np.stack([positions[:-1], positions[1:]], axis=1)
    line = LineCollection(list(pieces), cmap=times, norm=scale, lw=4, capstyle="round", zorder=6.6)
    line.set_array((t[:-1] + t[1:]) / 2)
    axes.add_collection(line)
    bar = axes.figure.colorbar(
        line, ax=axes, location="bottom", shrink=0.4, aspect=45, pad=0.01, ticks=_seconds(t[-1])
    )
    bar.set_label("time from now [s], along the selected plan and on the people", fontsize=8)
    bar.ax.tick_params(labelsize=8)


def _draw_seconds(
    axes: Axes,
    driven: Trajectory,
    seconds: Array,
    colours: tuple[Colormap, Normalize],
    nearest: float,
) -> None:
    """A dot each second, and its number beside it where that is far enough from the last [m]."""
    states = driven.at(seconds)
    times, scale = colours
    x, y = states.T[:2]
    axes.scatter(x, y, c=seconds, cmap=times, norm=scale, s=42, ec="black", lw=1.0, zorder=7)
    last = driven.positions[0]
    for t, state in zip(seconds, states, strict=True):
        if np.linalg.norm(state[:2] - last) < nearest:
            continue
        last = state[:2]
        across = np.array([-state[3], state[2]]) / max(np.hypot(*state[2:4]), 1e-9)
        aside = 15 * across * (1 if across[1] > -0.2 else -1)  # above, or on one side of all
        text = axes.annotate(
            f"{t:g} s",
            (state[0], state[1]),
            xytext=(aside[0], aside[1]),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=9,
            fontweight="bold",
            zorder=8,
            clip_on=True,
        )
        text.set_path_effects([withStroke(linewidth=2.5, foreground="white")])


def _seconds(horizon: float) -> Array:
    """Times to read: every second, or fewer when there are many."""
    step = max(1, int(np.ceil(horizon / 8)))
    return np.arange(step, horizon + 1e-9, step, dtype=float)


def _fine(trajectory: Trajectory) -> Array:
    """Times between the states, for a smooth line."""
    return np.linspace(trajectory.times[0], trajectory.times[-1], 8 * len(trajectory.times))


def _resampled(path: Array) -> Array:
    """The polyline (N, 2) with 60 points at equal distances."""
    along = arc_length(path)
    at = np.linspace(0.0, along[-1], 60)
    return np.column_stack([np.interp(at, along, path[:, i]) for i in range(2)])
