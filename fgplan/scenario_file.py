"""Scenario files: TOML whose keys are the fields of `fgplan.scenario`; SI units, radians.

`fgplan.structure` checks the structure (keys and types), `fgplan.validation` the meaning, and the
map is read in between. A mistake in one place does not hide those in another.
"""

from __future__ import annotations

import dataclasses
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fgplan.errors import MapError, Mistake, ScenarioError
from fgplan.holonomic import Holonomic
from fgplan.measuring import Reading, Readings
from fgplan.occupancy import OccupancyGrid
from fgplan.robots import RobotModel
from fgplan.scenario import Density, FieldOfView, GivenPlan, Level, Robot, Scenario, Track
from fgplan.scenario_table import (
    DatumTable,
    FileTable,
    GivenTable,
    LevelTable,
    MapTable,
    PersonTable,
    RobotTable,
)
from fgplan.structure import overlap, structured
from fgplan.task_file import understood
from fgplan.validation import find_mistakes, placement
from fgplan.wheeled import CarLike, DifferentialDrive

MODELS = {"holonomic": Holonomic, "differential": DifferentialDrive, "car": CarLike}
"""Robot models by name; their fields are keys of [robot]."""

MOST_CELLS = 40_000_000
"""Of a map drawn in a scenario file: more would take minutes and gigabytes."""


def load(path: Path) -> Scenario:
    """Read a scenario file; `data/scenarios/three_corridors_crowd.toml` explains every key.

    Args:
        path: The TOML file. The map's file is relative to it.

    Raises:
        ScenarioError: the file is missing, is not TOML, or says something that cannot be planned;
            all mistakes are reported at once, those of its map among them.
    """
    return parse(read(path), path)


def parse(raw: Mapping[str, Any], path: Path) -> Scenario:
    """A scenario from the tables of a file.

    Args:
        raw: As TOML gives them.
        path: Where they are from; the map's file is relative to it.

    Raises:
        ScenarioError: as `load`.
    """
    table, mistakes = structured(raw, FileTable)
    return _understand(table, mistakes, path)


def _understand(table: FileTable, mistakes: list[Mistake], path: Path) -> Scenario:
    """The scenario, unless there are mistakes of structure, map or meaning."""
    reported = [found.path for found in mistakes]
    unclear = any(known.startswith("map") for known in reported)
    grid, wrong = _map(table.map, path.parent, unclear)
    model, misplaced = _model(table.robot, "robot.model" in reported)
    scenario = _scenario(table, grid, model, path.stem)
    scenario, no_task = understood(scenario, table.regions, table.mission, table.tactics)
    meant = (
        *wrong,
        *misplaced,
        *no_task,
        *_goal(table),
        *_choices(table),
        *map(_respelled, find_mistakes(scenario)),
        *placement(scenario),
    )
    new = [m for m in meant if not any(overlap(m.path, known) for known in reported)]
    if mistakes or new:
        raise ScenarioError(str(path), (*mistakes, *new))
    return scenario


def read(path: Path) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        ScenarioError: there is no such file, it is not TOML, or it is empty.
    """
    try:
        text = path.read_bytes().decode()
        raw = tomllib.loads(text)
    except OSError as error:
        mend = f"cannot be read: {error.strerror}"
        raise ScenarioError(str(path), (Mistake("file", str(path), mend),)) from None
    except UnicodeDecodeError as error:
        mistake = Mistake(f"byte {error.start}", error.object[error.start], "write UTF-8")
        raise ScenarioError(str(path), (mistake,)) from None
    except tomllib.TOMLDecodeError as error:
        lines = text.splitlines()
        # At the end of the file Python names no line.
        number = int(found[1]) if (found := re.search(r"line (\d+)", str(error))) else len(lines)
        got = lines[number - 1] if number <= len(lines) else ""
        mistake = Mistake(f"line {number}", got, f"is not TOML: {error}")
        raise ScenarioError(str(path), (mistake,)) from None
    if not raw:
        mend = "is empty; give at least [robot] with a position"
        raise ScenarioError(str(path), (Mistake("file", str(path), mend),))
    return raw


def _map(
    table: MapTable | None, folder: Path, unclear: bool
) -> tuple[OccupancyGrid | None, list[Mistake]]:
    """The grid, or what is wrong with it; `unclear` when the table itself has mistakes."""
    if table is None:
        return None, []
    drawn = [key for key in ("polygons", "bounds", "resolution") if key in table.model_fields_set]
    if table.file is not None:
        if drawn:
            mend = f"contradicts map.{', map.'.join(drawn)}; keep the file or the polygons"
            return None, [Mistake("map.file", table.file, mend)]
        try:
            return OccupancyGrid.load(folder / table.file), []
        except MapError as error:
            return None, [Mistake("map.file", table.file, str(error))]
    if table.polygons is None or table.bounds is None or table.resolution is None:
        missing = [key for key in ("polygons", "bounds", "resolution") if key not in drawn]
        mend = "is missing; give file, or polygons with bounds and resolution"
        return None, [Mistake(f"map.{key}", None, mend) for key in missing if not unclear]
    xmin, ymin, xmax, ymax = table.bounds
    if not 1e-9 < table.resolution < 1e9 and table.resolution > 0:
        mend = "is no size of a cell; give metres, such as 0.05"
        return None, [Mistake("map.resolution", table.resolution, mend)]
    sides = np.array([xmax - xmin, ymax - ymin])
    if (
        table.resolution > 0
        and np.all(sides > 0)
        and not (np.prod(np.ceil(sides / table.resolution)) <= MOST_CELLS)
    ):
        mend = f"makes a map of more than {MOST_CELLS:g} cells; give a coarser one"
        return None, [Mistake("map.resolution", table.resolution, mend)]
    try:
        shapes = [np.asarray(polygon, dtype=float) for polygon in table.polygons]
        return OccupancyGrid.from_polygons(shapes, table.bounds, table.resolution), []
    except MapError as error:
        # "bounds: got ...; give ..." or "polygons[3]: got ...; give ..."
        key, _, what = str(error).partition(": ")
        return None, [Mistake(f"map.{key}", _stated(table, key), what.rpartition("; ")[2])]


def _stated(table: MapTable, key: str) -> object:
    """What the file says at a key such as `bounds` or `polygons[3]`."""
    name, _, index = key.rstrip("]").partition("[")
    value = getattr(table, name, None)
    return value[int(index)] if index and value is not None else value


def _goal(table: FileTable) -> Sequence[Mistake]:
    """A file that asks for global plans and names no goal contradicts itself."""
    count = table.plans.count
    if table.goal is None and table.mission is None and count is not None and count > 0:
        mend = "asks for global plans without a goal; give [goal] position, or count = 0"
        return (Mistake("plans.count", count, mend),)
    return ()


def _choices(table: FileTable) -> Iterable[Mistake]:
    """Data that measures nothing or two things, or whose noise is stated twice or not at all."""
    for i, datum in enumerate(table.data):
        for one, other in (("position", "velocity"), ("sigma", "covariance")):
            given = [k for k in (one, other) if getattr(datum, k) is not None]
            if len(given) != 1:
                mend = f"give either {one} or {other}"
                yield Mistake(f"data[{i}]", sorted(datum.model_fields_set), mend)


_PARTS = re.compile(r"(data\[\d+\])\.readings\[0\]\.(?:value|(\w+))")


def _respelled(mistake: Mistake) -> Mistake:
    """With the keys of [[data]], which holds one reading each."""
    path = _PARTS.sub(lambda m: f"{m[1]}.{m[2]}" if m[2] else m[1], mistake.path)
    return dataclasses.replace(mistake, path=path)


def _measurement(datum: DatumTable) -> Readings:
    value = datum.position if datum.velocity is None else datum.velocity
    quantity = "position" if datum.velocity is None else "velocity"
    noise: Any = datum.covariance
    if noise is None:  # one standard deviation for both axes; none at all is named as a mistake
        noise = np.eye(2) * (1.0 if datum.sigma is None else datum.sigma * abs(datum.sigma))
    where = _array((0.0, 0.0) if value is None else value)
    return Readings((Reading(datum.time, where, _array(noise), quantity),), datum.on)  # type: ignore[arg-type]


def _model(table: RobotTable, unclear: bool) -> tuple[RobotModel, list[Mistake]]:
    """The robot model, and what is said of it that it does not have; `unclear` when nobody knows
    which model is meant."""
    kind = MODELS.get(table.model)
    if unclear or kind is None:
        names = ", ".join(repr(name) for name in MODELS)
        wrong = [] if unclear else [Mistake("robot.model", table.model, f"give one of {names}")]
        return Holonomic(), wrong
    stated = {key: value for key, value in table.stated().items() if key in _model_keys()}
    own = {f.name for f in dataclasses.fields(kind)}
    misplaced = [
        Mistake(f"robot.{key}", stated[key], f"is no property of the model {table.model!r}")
        for key in sorted(stated.keys() - own)
    ]
    return kind(**{key: value for key, value in stated.items() if key in own}), misplaced


def _model_keys() -> set[str]:
    """The keys of [robot] that belong to its model."""
    return {f.name for kind in MODELS.values() for f in dataclasses.fields(kind)}


def _scenario(
    table: FileTable, grid: OccupancyGrid | None, model: RobotModel, stem: str
) -> Scenario:
    """The scenario that the tables describe."""
    own = {*_model_keys(), "model"}
    robot = {key: value for key, value in table.robot.stated().items() if key not in own}
    for name in {"position", "velocity", "covariance"} & robot.keys():
        robot[name] = _array(robot[name])
    optional: dict[str, Any] = {}
    if table.plans.count is not None:
        optional["count"] = table.plans.count
    elif table.goal is None and table.mission is None:
        optional["count"] = 0
    if table.levels is not None:
        optional["levels"] = tuple(map(_level, table.levels))
    if table.name is not None:
        optional["name"] = table.name
    view = table.field_of_view
    return Scenario(
        robot=Robot(**robot, model=model),
        goal=None if table.goal is None else _array(table.goal.position),
        goal_speed=0.0 if table.goal is None else table.goal.speed,
        grid=grid,
        tracks=tuple(_track(person) for person in table.people),
        now=table.crowd.now,
        field_of_view=None if view is None else FieldOfView(**view.stated()),
        plans=tuple(map(_plan, table.plans.given)),
        crowd=table.crowd.mode,  # type: ignore[arg-type]  # find_mistakes checks the word
        pairs=table.crowd.pairs,  # type: ignore[arg-type]
        density=Density(**table.density.stated()),
        data=tuple(_measurement(datum) for datum in table.data),
        **{"name": stem, **optional},
    )


def _plan(given: GivenTable) -> GivenPlan:
    return GivenPlan(given.label, _array(given.path), given.weight)


def _level(table: LevelTable) -> Level:
    stated = table.stated()
    if "plans" in stated:
        stated["plans"] = tuple(map(_plan, table.plans))
    return Level(**stated)


def _track(person: PersonTable) -> Track:
    rows = np.asarray(person.track, dtype=float).reshape(-1, 3)
    radius = {name: value for name, value in person.stated().items() if name == "radius"}
    return Track(person.id, rows[:, 0], rows[:, 1:], **radius)


def _array(value: Any) -> Any:
    """As an array; rows of different lengths stay as they are, for `find_mistakes` to name."""
    try:
        return np.asarray(value, dtype=float)
    except ValueError:
        return value
