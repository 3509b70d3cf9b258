"""Pictures of a plan: the map, the people, every hypothesis, and when the robot will be where.

Figures are matplotlib's `Figure` objects: no pyplot, no global state, no display.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Ellipse, Wedge
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray

from fgplan.crowd import Belief, believe, heading, seen
from fgplan.labels import short
from fgplan.mixture import Component, Mixture
from fgplan.occupancy import OCCUPIED, OccupancyGrid
from fgplan.regions import Region
from fgplan.scenario import Scenario, Track
from fgplan.trajectory import Trajectory

Array = NDArray[np.float64]
Box = tuple[float, float, float, float]
"""(x_min, y_min, x_max, y_max) [m]."""

# Okabe and Ito's colours, and cividis for time: a colour-blind reader can tell them apart.
ROBOT = "#0072b2"
PERSON = "#d55e00"
GOAL = "#f0e442"
HYPOTHESES = ("#56b4e9", "#009e73", "#cc79a7", "#e69f00", "#999999")
REGION = "#7a4b94"
FREE, UNKNOWN, OBSTACLE = "#f4f4f4", "#cfcfcf", "#5a5a5a"

WIDTH = 12.0
"""Of a figure [inch]."""
MARGIN = 1.0
"""Shown around everything that moves [m]."""
NARROWEST = 6.0
"""Least width and height of what is shown [m]."""
FINE = 300
"""Points across the picture at which a region is looked at."""
ROOM = 1.0
"""A label this far from everything hides nothing [m]."""
LONGEST = 28
"""Of a label in a picture [characters]."""
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
    heights = [max(0.7 * WIDTH * share, 3.0) + 1.3 for share in shares]
    figure = Figure(figsize=(WIDTH, sum(heights)), layout="constrained")
    rows = figure.subfigures(len(plans), 1, height_ratios=heights, squeeze=False)[:, 0]
    for row, (mixture, scenario), box, height in zip(rows, plans, boxes, heights, strict=True):
        bars_share = min((0.6 + 0.4 * max(len(mixture.components), 3)) / height, 0.6)
        picture, bars, legend = row.subplot_mosaic(
            [["map", "bars"], ["map", "legend"]],
            width_ratios=(3.4, 1),
            height_ratios=(bars_share, 1 - bars_share),
        ).values()
        _draw_map_panel(picture, mixture, scenario, box)
        _draw_bars(bars, mixture)
        _draw_legend(legend, mixture, scenario)
        picture.set_title(
            _title(mixture), loc="left", fontsize=12, fontweight="bold", parse_math=False
        )
    if path is not None:
        figure.savefig(path, dpi=110, bbox_inches="tight", pad_inches=0.15)
    return figure


def _title(mixture: Mixture) -> str:
    best, i = mixture.best, mixture.selected
    if best is None or i is None:
        stop = "" if mixture.action.safe else ", and the stop is NOT CLEAR"
        return f"{mixture.name}: stops, no hypothesis is safe{stop}"
    chance = f"P = {mixture.probability_height[i]:.2f} by height"
    if mixture.has_mass:
        chance += f", {mixture.probability_mass[i]:.2f} by mass"
    return f"{mixture.name}: selected {short(best.label, LONGEST)} ({chance})"


def _colours(mixture: Mixture) -> list[str]:
    """Of each component, by its label: the same in every picture of the same hypotheses."""
    labels = sorted(c.label for c in mixture.components)
    return [HYPOTHESES[labels.index(c.label) % len(HYPOTHESES)] for c in mixture.components]


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
        _draw_grid(axes, scenario.grid)
    _draw_field_of_view(axes, scenario, box)
    for region in scenario.regions:
        _draw_region(axes, region, box)
    for component, colour in zip(mixture.components, _colours(mixture), strict=True):
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
    _draw_seconds(axes, mixture.trajectory, seconds, (times, scale))
    axes.set(
        xlim=(box[0], box[2]), ylim=(box[1], box[3]), aspect="equal", xlabel="x [m]", ylabel="y [m]"
    )


def _draw_grid(axes: Axes, grid: OccupancyGrid) -> None:
    rows, cols = grid.data.shape
    kinds = np.where(grid.data >= OCCUPIED, 2, np.where(grid.data < 0, 1, 0))
    x, y, yaw = grid.origin.tolist()
    image = axes.imshow(
        kinds,
        cmap=ListedColormap([FREE, UNKNOWN, OBSTACLE]),
        vmin=0,
        vmax=2,
        origin="lower",
        extent=(0, cols, 0, rows),
        interpolation="nearest",
        zorder=0,
    )
    place = Affine2D().scale(grid.resolution).rotate(yaw).translate(x, y)
    image.set_transform(place + axes.transData)


def _draw_region(axes: Axes, region: Region, box: Box) -> None:
    """Its outline and its name."""
    x, y = np.linspace(box[0], box[2], FINE), np.linspace(box[1], box[3], FINE)
    distance = region.shape.distance(np.stack(np.meshgrid(x, y), axis=-1))
    if distance.min() > 0:  # not in the picture
        return
    axes.contour(x, y, distance, [0.0], colors=REGION, linestyles="dashed", linewidths=1.0)
    axes.contourf(x, y, distance, [-np.inf, 0.0], colors=[REGION], alpha=0.08, zorder=0.5)
    row, column = np.unravel_index(np.argmin(distance), distance.shape)
    axes.text(
        float(x[column]), float(y[row]), region.name, fontsize=8, color=REGION, ha="center",
        va="center", parse_math=False, clip_on=True, zorder=1,
    )  # fmt: skip


def _draw_field_of_view(axes: Axes, scenario: Scenario, box: Box) -> None:
    view = scenario.field_of_view
    if view is None or (np.isinf(view.range) and view.angle >= 2 * np.pi):
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
    """Label and probability of each hypothesis, where it does not hide another, or a person."""
    routes = [
        c.robot.positions[-1:] if c.route is None else _resampled(c.route)
        for c in mixture.components
    ]
    people = np.array([track.positions[-1] for track in scenario.tracks]).reshape(-1, 2)
    size = np.array([box[2] - box[0], box[3] - box[1]])
    colours = _colours(mixture)
    for i, component in enumerate(mixture.components):
        route = routes[i]
        others = [other for j, other in enumerate(routes) if j != i]
        room = np.minimum(_distance(route, others), ROOM)
        room += np.minimum(_distance(route, [people, mixture.trajectory.positions]), ROOM)
        roomy = route[room >= room.max() - 0.1]
        x, y = roomy[len(roomy) // 2]
        x, y = np.clip((x, y), box[:2] + 0.06 * size, box[2:] - 0.06 * size)
        axes.text(
            x,
            y,
            f"{short(component.label, LONGEST)}  {mixture.probability_height[i]:.2f}",
            ha="center",
            va="center",
            fontsize=10,
            zorder=9,
            parse_math=False,
            bbox={"boxstyle": "round,pad=0.25", "fc": "white", "ec": colours[i], "lw": 1.5},
        )


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
    axes: Axes, driven: Trajectory, seconds: Array, colours: tuple[Colormap, Normalize]
) -> None:
    """A dot each second, and its number where there is room."""
    states = driven.at(seconds)
    times, scale = colours
    x, y = states.T[:2]
    axes.scatter(x, y, c=seconds, cmap=times, norm=scale, s=42, ec="black", lw=1.0, zorder=7)
    last = driven.positions[0]
    for t, state in zip(seconds, states, strict=True):
        if np.linalg.norm(state[:2] - last) < 0.35:
            continue
        last = state[:2]
        text = axes.annotate(
            f"{t:g} s",
            (state[0], state[1]),
            xytext=(0, 8),
            textcoords="offset points",
            ha="center",
            fontsize=9,
            fontweight="bold",
            zorder=8,
            clip_on=True,
        )
        text.set_path_effects([withStroke(linewidth=2.5, foreground="white")])


def _draw_bars(axes: Axes, mixture: Mixture) -> None:
    """P(i) by height and by mass; what is not feasible is named so."""
    where = np.arange(len(mixture.components), dtype=float)
    colours = _colours(mixture)
    bars, said = [(-0.2, mixture.probability_height, "")], "probability by height"
    if mixture.has_mass:
        bars.append((0.2, mixture.probability_mass, "////"))
        said = "probability (plain: height, hatched: mass)"
    for shift, values, hatch in bars:
        axes.barh(where + shift, values, 0.36, color=colours, hatch=hatch, ec="black", lw=0.6)
        for y, value in zip(where + shift, values, strict=True):
            axes.text(value + 0.02, y, f"{value:.2f}", va="center", fontsize=8)
    labels = [short(c.label, LONGEST) + "\nrefused" * (not c.feasible) for c in mixture.components]
    axes.set_yticks(where, labels, parse_math=False)
    axes.set(xlim=(0, 1.2), xticks=(0, 0.5, 1))
    axes.set_xlabel(said, fontsize=8)
    axes.set_ylim(max(len(where), 3) - 0.5, -0.5)
    axes.spines[["top", "right"]].set_visible(False)


def _draw_legend(axes: Axes, mixture: Mixture, scenario: Scenario) -> None:
    def line(colour: str, style: str | tuple[int, tuple[int, ...]], width: float) -> Line2D:
        return Line2D([], [], color=colour, ls=style, lw=width)

    def disc(fill: str, edge: str, marker: str = "o", size: float = 9) -> Line2D:
        return Line2D([], [], ls="", marker=marker, ms=size, mfc=fill, mec=edge)

    entries = {
        "robot now": disc(ROBOT, "black"),
        "what will be driven": line("black", "-", 4),
        "a hypothesis: its plan": line(HYPOTHESES[0], "-", 5),
    }
    if any(c.route is not None for c in mixture.components):
        entries["and its route"] = line(HYPOTHESES[0], (0, (5, 3)), 1.2)
    if scenario.goal is not None:
        entries["goal"] = disc(GOAL, "black", "*", 13)
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


def _seconds(horizon: float) -> Array:
    """Times to read: every second, or fewer when there are many."""
    step = max(1, int(np.ceil(horizon / 8)))
    return np.arange(step, horizon + 1e-9, step, dtype=float)


def _fine(trajectory: Trajectory) -> Array:
    """Times between the states, for a smooth line."""
    return np.linspace(trajectory.times[0], trajectory.times[-1], 8 * len(trajectory.times))


def _distance(points: Array, others: Sequence[Array]) -> Array:
    """From each point (N, 2) to the nearest of all others, shape (N,); 1 m when there are none."""
    rest = np.vstack([np.zeros((0, 2)), *others])
    apart = np.linalg.norm(points[:, None] - rest, axis=-1)
    return np.asarray(apart.min(axis=1, initial=np.inf) if len(rest) else np.ones(len(points)))


def _resampled(path: Array) -> Array:
    """The polyline (N, 2) with 60 points at equal distances."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    at = np.linspace(0.0, along[-1], 60)
    return np.column_stack([np.interp(at, along, path[:, i]) for i in range(2)])
