"""What a scenario may say. Every rule is stated once, here, for files and for Python alike.

A mistake is named by its path in a scenario file (`people[2].track[5]`), also when the scenario
was built in Python: one spelling for one thing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from factors.residual import whitener
from fgplan.errors import MissionError, Mistake, ScenarioError
from fgplan.labels import IN_NO_PLAN, IN_NO_REGION, misread
from fgplan.measuring import ROBOT, Measurement, Reading
from fgplan.mission.parser import KEYWORDS
from fgplan.robots import RobotModel
from fgplan.scenario import FieldOfView, GivenPlan, Level, Scenario, Track
from fgplan.stack import loose

Array = NDArray[np.float64]

FARTHEST = 1e7
"""Largest coordinate [m]: beyond it a float no longer resolves a robot."""
LATEST = 1e11
"""Largest time stamp [s], on any clock in use."""
NARROWEST = 1e-6
"""Smallest width of a level [m] that is not 0."""
MOST_STEPS = 2000
LONGEST = 600.0
"""Largest horizon [s]: the hard check looks every 0.05 s, and must end."""
LONGEST_STEP = 60.0
"""Largest dt [s]: obstacles are checked every 0.25 m between two states."""
MOST_PLANS = 100


@dataclass(frozen=True)
class _Range:
    """Numbers from low to high; an end with a tiny or huge value stands for an open one."""

    low: float
    high: float
    mend: str
    infinite: bool = False

    def allows(self, value: object) -> bool:
        if isinstance(value, bool | np.bool_) or not isinstance(
            value, int | float | np.integer | np.floating
        ):
            return False
        return bool(self.low <= value <= self.high or (self.infinite and value == np.inf))


# 1e±15: what is squared and inverted later must stay finite.
_POSITIVE = _Range(1e-15, 1e15, "give a finite number above 0")
_POSITIVE_OR_INF = _Range(1e-15, 1e15, "give a number above 0, or inf", infinite=True)
_NOT_NEGATIVE = _Range(0, 1e15, "give a finite number, 0 or above")
_NOT_NEGATIVE_OR_INF = _Range(0, 1e15, "give a number, 0 or above, or inf", infinite=True)
_FINITE = _Range(-1e15, 1e15, "give a finite number")
_SPEED = _Range(1e-3, 100, "give a speed above 0, at most 100 m/s")
_CLOCK = _Range(-LATEST, LATEST, f"give a time in seconds, within ±{LATEST:g}")

_DENSITY = {
    "dt": _Range(1e-15, LONGEST_STEP, f"give a time above 0, at most {LONGEST_STEP:g} s"),
    "horizon": _Range(1e-15, LONGEST, f"give a time above 0, at most {LONGEST:g} s"),
    "t_ref": _POSITIVE,
    "Qc_robot": _POSITIVE,
    "Qc_people": _POSITIVE,
    "sigma_track": _POSITIVE,
    "sigma_speed": _POSITIVE,
    "alpha": _Range(0, 1, "give a number from 0 to 1"),
    "h_c": _POSITIVE,
    "contact_sigma": _POSITIVE_OR_INF,
    "contact_margin": _NOT_NEGATIVE,
    "obstacle_sigma": _POSITIVE_OR_INF,
    "obstacle_margin": _NOT_NEGATIVE,
    "limit_sigma": _POSITIVE_OR_INF,
    "reach": _POSITIVE_OR_INF,
    "beta": _NOT_NEGATIVE,
}
_ROBOT = {
    "radius": _POSITIVE,
    "preferred_speed": _SPEED,
    "max_speed": _SPEED,
    "max_acceleration": _Range(1e-3, 1e4, "give an acceleration above 0, at most 1e4 m/s²"),
}
_MODEL = {
    "max_reverse_speed": _Range(0, 100, "give a speed, 0 or above, at most 100 m/s"),
    "max_yaw_rate": _Range(1e-3, 100, "give a yaw rate above 0, at most 100 rad/s"),
    "max_yaw_acceleration": _Range(1e-3, 1e4, "give a number above 0, at most 1e4 rad/s²"),
    "min_turning_radius": _Range(1e-3, 1e4, "give a radius above 0, at most 1e4 m"),
    "Qc_yaw": _POSITIVE,
}
_YAW_RATE = _Range(-100, 100, "give a yaw rate of at most 100 rad/s")
_LEVEL = {
    "sigma": _NOT_NEGATIVE_OR_INF,
    "length": _Range(1e-6, 1e6, "give a time from 1e-6 to 1e6 s"),
    "h": _POSITIVE,
}
_FIELD_OF_VIEW = {
    "range": _POSITIVE_OR_INF,
    # A little above 2π, so that a rounded 6.284 is all round as well.
    "angle": _Range(1e-15, 6.29, "give the full opening angle in radians, above 0, at most 2π"),
}


def validate(scenario: Scenario) -> None:
    """Refuse a scenario that cannot be planned, whatever its source.

    Where the map leaves no room for the robot is not checked here but by the global planner, which
    may still mend it; `placement` says it at once.

    Raises:
        ScenarioError: it holds a number that is not finite, a shape that is wrong, a covariance
            that is not positive definite, a contradiction, ...; all mistakes are named.
    """
    mistakes = tuple(find_mistakes(scenario))
    if mistakes:
        raise ScenarioError(str(scenario.name), mistakes)


def find_mistakes(scenario: Scenario) -> Iterable[Mistake]:
    """Yields every mistake of a scenario, in the order of a scenario file."""
    yield from _robot(scenario)
    if scenario.goal is not None:
        yield from _points("goal.position", scenario.goal, (2,))[1]
    yield from _goal_speed(scenario)
    yield from _plans(scenario)
    yield from _density(scenario)
    yield from _crowd(scenario)
    if scenario.field_of_view is not None:
        yield from _numbers("field_of_view", scenario.field_of_view, _FIELD_OF_VIEW)
        yield from _occlusion(scenario.field_of_view)
    yield from _levels(scenario.levels)
    yield from _regions(scenario)
    yield from _mission(scenario)
    names = [level.name for level in scenario.levels]
    for i, measurement in enumerate(scenario.data):
        yield from find_data_mistakes(f"data[{i}]", measurement, names)


def _goal_speed(scenario: Scenario) -> Iterable[Mistake]:
    most = scenario.robot.preferred_speed
    if not _NOT_NEGATIVE.allows(scenario.goal_speed):
        yield Mistake("goal.speed", _plain(scenario.goal_speed), _NOT_NEGATIVE.mend)
    elif _SPEED.allows(most) and scenario.goal_speed > most:
        mend = f"is above preferred_speed, {most:g} m/s; the robot passes the goal at most so fast"
        yield Mistake("goal.speed", scenario.goal_speed, mend)


def placement(scenario: Scenario) -> Iterable[Mistake]:
    """Yields a mistake for a start or goal that lies outside the map or inside an obstacle."""
    grid = scenario.grid
    if grid is None:
        return
    for path, point in (
        ("robot.position", scenario.robot.position),
        ("goal.position", scenario.goal),
    ):
        where = None if point is None else _points(path, point, (2,))[0]
        if where is None:
            continue
        if not grid.contains(where):
            xmin, ymin, xmax, ymax = grid.bounds
            mend = f"lies outside the map, x {xmin:g} to {xmax:g}, y {ymin:g} to {ymax:g}"
            yield Mistake(path, _plain(point), mend)
        elif grid.is_occupied(where):
            yield Mistake(path, _plain(point), "lies inside an obstacle of the map; move it")


def _robot(scenario: Scenario) -> Iterable[Mistake]:
    robot = scenario.robot
    yield from _points("robot.position", robot.position, (2,))[1]
    yield from _points("robot.velocity", robot.velocity, (2,))[1]
    if robot.heading is not None and not _FINITE.allows(robot.heading):
        yield Mistake("robot.heading", robot.heading, "give a finite angle in radians")
    if not _YAW_RATE.allows(robot.yaw_rate):
        yield Mistake("robot.yaw_rate", _plain(robot.yaw_rate), _YAW_RATE.mend)
    fits = isinstance(robot.model, RobotModel) and not isinstance(robot.model, type)
    if not fits:
        yield Mistake("robot.model", robot.model, "give a robot model, such as Holonomic()")
    own = {name: allowed for name, allowed in _MODEL.items() if hasattr(robot.model, name)}
    yield from _numbers("robot", robot.model, own)
    wrong = list(_numbers("robot", robot, _ROBOT))
    yield from wrong
    if not wrong and robot.preferred_speed > robot.max_speed:
        mend = f"give at most robot.max_speed, which is {robot.max_speed:g}"
        yield Mistake("robot.preferred_speed", robot.preferred_speed, mend)
    if robot.covariance is not None:
        dim = robot.model.dim if fits else 4
        yield from _covariance("robot.covariance", robot.covariance, dim)


def _covariance(path: str, value: Any, dim: int) -> Iterable[Mistake]:
    matrix, wrong = _points(path, value, (dim, dim), limit=1e30)
    if matrix is None:
        yield from wrong
        return
    try:
        W = whitener(matrix)
    except ValueError as error:
        what = str(error).split("must be ")[-1].split(",")[0]
        yield Mistake(path, _plain(value), f"give a matrix that is {what}")
        return
    if not np.abs(W).max() < 1e15:
        yield Mistake(path, _plain(value), "give a matrix that is not nearly singular")


def _plans(scenario: Scenario) -> Iterable[Mistake]:
    plans, count = scenario.plans, scenario.count
    if isinstance(count, bool) or not isinstance(count, int | np.integer):
        yield Mistake("plans.count", count, "give a whole number")
    elif not 0 <= count <= MOST_PLANS:
        yield Mistake("plans.count", count, f"give a whole number from 0 to {MOST_PLANS}")
    elif count == 0 and not plans and scenario.goal is not None:
        mend = "contradicts the goal: ask for one plan or more, give plans, or drop the goal"
        yield Mistake("plans.count", count, mend)
    for i, plan in enumerate(plans):
        yield from _given(f"plans.given[{i}]", plan)
    yield from _names([plan.label for plan in plans], "plans.given[{}].label", IN_NO_PLAN)
    weights = [plan.weight for plan in plans]
    if weights and all(w == 0 for w in weights):
        yield Mistake("plans.given", weights, "give at least one plan a weight above 0")


def _given(path: str, plan: GivenPlan) -> Iterable[Mistake]:
    vertices, wrong = _points(f"{path}.path", plan.path, (None, 2))
    yield from wrong
    if vertices is not None and len(vertices) < 2:
        yield Mistake(f"{path}.path", _plain(vertices), "give two vertices or more")
    if plan.weight is not None and not _NOT_NEGATIVE.allows(plan.weight):
        yield Mistake(f"{path}.weight", plan.weight, _NOT_NEGATIVE.mend)


def _density(scenario: Scenario) -> Iterable[Mistake]:
    density = scenario.density
    wrong = list(_numbers("density", density, _DENSITY))
    yield from wrong
    if any(mistake.path in ("density.dt", "density.horizon") for mistake in wrong):
        return
    if density.horizon < density.dt:
        mend = f"give at least density.dt, which is {density.dt:g}"
        yield Mistake("density.horizon", density.horizon, mend)
    elif density.horizon / density.dt > MOST_STEPS:
        mend = f"give at least horizon/{MOST_STEPS} = {density.horizon / MOST_STEPS:g}"
        yield Mistake("density.dt", density.dt, mend)


def _crowd(scenario: Scenario) -> Iterable[Mistake]:
    for path, value, choices in (
        ("crowd.mode", scenario.crowd, ("joint", "predicted")),
        ("crowd.pairs", scenario.pairs, ("all", "robot")),
    ):
        if value not in choices:
            yield Mistake(path, value, f"give {choices[0]!r} or {choices[1]!r}")
    if not _CLOCK.allows(scenario.now):
        yield Mistake("crowd.now", scenario.now, _CLOCK.mend)
    for i, track in enumerate(scenario.tracks):
        yield from _track(f"people[{i}]", track, scenario.now)
    yield from _distinct([track.identity for track in scenario.tracks], "people[{}].id")


def _track(path: str, track: Track, now: float) -> Iterable[Mistake]:
    if not _POSITIVE.allows(track.radius):
        yield Mistake(f"{path}.radius", track.radius, _POSITIVE.mend)
    path = f"{path}.track"
    times, wrong = _points(path, track.times, (None,), limit=LATEST)
    positions, wrong_too = _points(path, track.positions, (None, 2))
    if times is not None and positions is not None and len(times) == len(positions):
        if len(times) == 0:
            yield Mistake(path, [], "give at least one detection [t, x, y]")
        elif not (times[-1] <= now and np.all(times[1:] > times[:-1])):
            yield from _stamps(path, np.column_stack([times, positions]), now)
        return
    rows = _rows(track)
    if rows is None:
        yield Mistake(path, None, "give times of shape (m,) and positions of shape (m, 2)")
        return
    for mistake in {m.path: m for m in (*wrong, *wrong_too)}.values():
        k = int(mistake.path[len(path) + 1 : -1])
        yield Mistake(mistake.path, rows[k].tolist(), mistake.mend)
    yield from _stamps(path, rows, now)


def _rows(track: Track) -> Array | None:
    """Rows (t, x, y), numbers or not finite; None where the shapes do not fit."""
    try:
        times = np.asarray(track.times, dtype=float)
        positions = np.asarray(track.positions, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return None
    if times.ndim != 1 or positions.shape != (len(times), 2):
        return None
    return np.column_stack([times, positions])


def _stamps(path: str, rows: Array, now: float) -> Iterable[Mistake]:
    """Time stamps that do not increase or come after now; those that are no numbers are skipped."""
    before = -np.inf
    for k, row in enumerate(rows):
        if row[0] > now:
            mend = f"comes after crowd.now = {now:g}; drop it or move now"
            yield Mistake(f"{path}[{k}]", row.tolist(), mend)
        elif row[0] <= before:
            mend = f"comes no later than the time before, {before:g}; times must increase"
            yield Mistake(f"{path}[{k}]", row.tolist(), mend)
        before = max(before, row[0]) if np.isfinite(row[0]) else before


def _occlusion(view: FieldOfView) -> Iterable[Mistake]:
    if not isinstance(view.occlusion, bool | np.bool_):
        yield Mistake("field_of_view.occlusion", view.occlusion, "give true or false")


def _levels(levels: Sequence[Level]) -> Iterable[Mistake]:
    if not levels:
        yield Mistake("levels", [], "give at least one level")
    wrong: list[Mistake] = []
    for i, level in enumerate(levels):
        yield from _numbers(f"levels[{i}]", level, _LEVEL)
        if _NOT_NEGATIVE.allows(level.sigma) and 0 < level.sigma < NARROWEST:
            mend = f"give 0 for exactly its plan, or {NARROWEST:g} m or more"
            yield Mistake(f"levels[{i}].sigma", level.sigma, mend)
        if level.name == ROBOT:
            yield Mistake(f"levels[{i}].name", ROBOT, "is the robot itself; give another name")
        wrong += list(_place_in_stack(f"levels[{i}]", level, levels[:i]))
    if levels and levels[0].sigma == np.inf:
        mend = "give a finite number: nothing else says where the first level is"
        wrong.append(Mistake("levels[0].sigma", levels[0].sigma, mend))
    yield from wrong
    yield from _distinct([level.name for level in levels], "levels[{}].name")
    if not wrong:
        mend = "is flat, and at some steps meets no level that is not; give it a Qc"
        for i in loose(levels):
            yield Mistake(f"levels[{i}]", levels[i].name, mend)


def _regions(scenario: Scenario) -> Iterable[Mistake]:
    yield from _names([r.name for r in scenario.regions], "regions[{}].name", IN_NO_REGION)
    for i, region in enumerate(scenario.regions):
        outline = [*region.polygon, (region.radius, region.radius)]
        yield from _points(f"regions[{i}].polygon", outline, (None, 2))[1]
        if region.name in KEYWORDS:
            mend = "is a word of the language of missions; give another name"
            yield Mistake(f"regions[{i}].name", region.name, mend)


def _mission(scenario: Scenario) -> Iterable[Mistake]:
    mission = scenario.mission
    if mission is None:
        return
    names = [region.name for region in scenario.regions]
    yield from _distinct([fact.name for fact in mission.facts], "mission.facts[{}].name")
    for i, fact in enumerate(mission.facts):
        if fact.closes is not None and fact.closes not in names:
            mend = f"is no region; the regions are {', '.join(names) or 'none'}"
            yield Mistake(f"mission.facts[{i}].closes", fact.closes, mend)
    try:
        mission.check_names(names)
    except MissionError as error:
        yield Mistake("mission.formula", mission.text, str(error))


def _place_in_stack(path: str, level: Level, before: Sequence[Level]) -> Iterable[Mistake]:
    """How a level stands to the others."""
    if level.Qc is not None and not _POSITIVE.allows(level.Qc):
        yield Mistake(f"{path}.Qc", _plain(level.Qc), _POSITIVE.mend)
    names = [other.name for other in before]
    if level.follows is not None and level.follows not in names:
        known = ", ".join(map(repr, names)) or "none: it is the first"
        yield Mistake(f"{path}.follows", level.follows, f"give a level before it: {known}")
    every = level.every
    if isinstance(every, bool) or not isinstance(every, int | np.integer) or every < 1:
        yield Mistake(f"{path}.every", _plain(every), "give a whole number of steps, 1 or more")
    elif every > 1 and level.sigma == np.inf and level.Qc is None:
        mend = "a flat level has no process between its steps; give it a Qc, or a finite sigma"
        yield Mistake(f"{path}.every", every, mend)
    if level.plans and not before:
        yield Mistake(f"{path}.plans", len(level.plans), "give the first level's as plans.given")
    elif level.plans and level.sigma == np.inf:
        mend = "says that nothing is its mean; give a finite number, or no plans"
        yield Mistake(f"{path}.sigma", level.sigma, mend)
    for j, plan in enumerate(level.plans):
        yield from _given(f"{path}.plans[{j}]", plan)
    yield from _names([plan.label for plan in level.plans], path + ".plans[{}].label", IN_NO_PLAN)
    if level.plans and all(plan.weight == 0 for plan in level.plans):
        yield Mistake(f"{path}.plans", 0.0, "give at least one plan a weight above 0")


def find_data_mistakes(path: str, data: Measurement, levels: Sequence[str]) -> Iterable[Mistake]:
    """Yields every mistake of a measurement, named from `path` on.

    Args:
        path: What the measurement is called.
        data: The measurement.
        levels: Names of the levels that there are.
    """
    try:  # from here on it is a program's own code that runs, `readings` of whatever it holds
        known = isinstance(data, Measurement) and not isinstance(data, type)
        readings = tuple(data.readings) if known else ()
    except Exception as error:
        why = f"its readings cannot be made, {type(error).__name__}: {error}"
        yield Mistake(path, type(data).__name__, why)
        return
    if not known:
        yield Mistake(path, data, "give a measurement, such as Readings((Reading(...),))")
        return
    on = data.on if data.on is None or isinstance(data.on, str) else str(data.on)
    if on not in (None, ROBOT, *levels):
        mend = f"is not measured; give {ROBOT!r} or a level: {', '.join(map(repr, levels))}"
        yield Mistake(f"{path}.on", data.on, mend)
    for j, reading in enumerate(readings):
        yield from _reading(f"{path}.readings[{j}]", reading, on)


def _reading(path: str, reading: Reading, on: str | None) -> Iterable[Mistake]:
    if not isinstance(reading, Reading):
        yield Mistake(path, reading, "give a Reading")
        return
    if reading.quantity not in ("position", "velocity"):
        yield Mistake(f"{path}.quantity", reading.quantity, "give 'position' or 'velocity'")
    if reading.time is None:
        if reading.quantity == "velocity" or on == ROBOT:
            mend = "only a position on a level may have no time; give one in seconds"
            yield Mistake(f"{path}.time", None, mend)
    elif not _CLOCK.allows(reading.time):
        yield Mistake(f"{path}.time", _plain(reading.time), _CLOCK.mend)
    if reading.said is not None and not _CLOCK.allows(reading.said):
        yield Mistake(f"{path}.said", _plain(reading.said), _CLOCK.mend)
    yield from _points(f"{path}.value", reading.value, (2,))[1]
    yield from _covariance(f"{path}.covariance", reading.covariance, 2)


def _numbers(path: str, owner: object, ranges: dict[str, _Range]) -> Iterable[Mistake]:
    for name, allowed in ranges.items():
        value = getattr(owner, name)
        if value is None and name == "t_ref":
            continue
        if not allowed.allows(value):
            yield Mistake(f"{path}.{name}", _plain(value), allowed.mend)


def _points(
    path: str, value: Any, shape: tuple[int | None, ...], limit: float = FARTHEST
) -> tuple[Array | None, list[Mistake]]:
    """The value as an array, or None and why not: shape, or numbers that are not finite."""
    named = str(shape).replace("None", "N")
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return None, [Mistake(path, value, f"give numbers, shape {named}")]
    if array.ndim != len(shape) or any(
        want is not None and want != got for want, got in zip(shape, array.shape, strict=True)
    ):
        mend = f"has shape {array.shape}; give shape {named}"
        return None, [Mistake(path, _plain(value), mend)]
    fine = np.abs(array) <= limit  # false for NaN as well
    if fine.all():
        return array, []
    mend = f"give finite numbers, at most {limit:g} in size"
    if shape[0] is not None:
        return None, [Mistake(path, _plain(value), mend)]
    bad = ~fine.reshape(len(array), -1).all(axis=1)
    return None, [Mistake(f"{path}[{k}]", array[k].tolist(), mend) for k in np.flatnonzero(bad)]


def _distinct(names: Sequence[object], path: str) -> Iterable[Mistake]:
    """Names that are no names, or that another has already."""
    counts = Counter(name for name in names if isinstance(name, str))
    taken: set[str] = set()
    for i, name in enumerate(names):
        if not isinstance(name, str) or not name:
            yield Mistake(path.format(i), name, "give a name")
        elif counts[name] > 1 and name in taken:
            yield Mistake(path.format(i), name, f"is also at {path.format(names.index(name))}")
        else:
            taken.add(name)


def _names(names: Sequence[object], path: str, parts: Sequence[str]) -> Iterable[Mistake]:
    """Names that are not distinct, or would be read as more than one in that of a hypothesis."""
    yield from _distinct(names, path)
    for i, name in enumerate(names):
        if isinstance(name, str) and (why := misread(name, parts)) is not None:
            yield Mistake(path.format(i), name, why)


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value
