"""Scenario files: TOML whose keys are the fields of `fgplan.scenario`; SI units, radians.

pydantic checks the structure (keys and types), `fgplan.validation` the meaning, and the map is
read in between. A mistake in one place does not hide those in another: what cannot be read is
reported, replaced by numbers that are not finite (which nothing mistakes for a value), and the
rest is checked all the same.
"""

from __future__ import annotations

import copy
import dataclasses
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
from pydantic import BaseModel, BeforeValidator, Field, ValidationError
from pydantic_core import PydanticCustomError

from fgplan.errors import MapError, Mistake, ScenarioError
from fgplan.holonomic import Holonomic
from fgplan.measuring import Reading, Readings
from fgplan.occupancy import OccupancyGrid
from fgplan.robots import RobotModel
from fgplan.scenario import Density, FieldOfView, GivenPlan, Level, Robot, Scenario, Track
from fgplan.tables import Flag, Number, Point, Table, Text, Whole
from fgplan.task_file import MissionTable, RegionTable, TacticTable, understood
from fgplan.validation import find_mistakes, placement
from fgplan.wheeled import CarLike, DifferentialDrive


def _dt_or_number(value: object) -> object:
    return None if value == "dt" else value


def _sigmas_or_matrix(value: object) -> object:
    """Four standard deviations are a diagonal covariance."""
    if not isinstance(value, list) or any(isinstance(entry, list) for entry in value):
        return value
    # 1e15: an integer of TOML may be too large for a float.
    if not all(type(sigma) in (int, float) and 0 < sigma < 1e15 for sigma in value):
        raise PydanticCustomError("sigmas", "give four standard deviations above 0, or 4 rows")
    return np.diag(np.asarray(value, dtype=float) ** 2).tolist()


class _Map(Table):
    file: Text | None = None
    polygons: list[list[Point]] | None = None
    bounds: tuple[Number, Number, Number, Number] | None = None
    resolution: Number | None = None


class _Robot(Table):
    position: Point
    velocity: Point = (0.0, 0.0)
    heading: Number = 0.0
    covariance: Annotated[list[list[Number]], BeforeValidator(_sigmas_or_matrix)] = []
    radius: Number = 0.0
    preferred_speed: Number = 0.0
    max_speed: Number = 0.0
    max_acceleration: Number = 0.0
    yaw_rate: Number = 0.0
    model: Text = "holonomic"
    max_reverse_speed: Number = 0.0
    max_yaw_rate: Number = 0.0
    max_yaw_acceleration: Number = 0.0
    min_turning_radius: Number = 0.0
    Qc_yaw: Number = 0.0


class _Goal(Table):
    position: Point
    speed: Number = 0.0


class _Given(Table):
    label: Text
    path: list[Point]
    weight: Number | None = None


class _Plans(Table):
    count: Whole | None = None
    given: list[_Given] = []


class _Density(Table):
    dt: Number = 0.0
    horizon: Number = 0.0
    t_ref: Annotated[Number | None, BeforeValidator(_dt_or_number)] = None
    Qc_robot: Number = 0.0
    Qc_people: Number = 0.0
    sigma_track: Number = 0.0
    sigma_speed: Number = 0.0
    alpha: Number = 0.0
    h_c: Number = 0.0
    contact_sigma: Number = 0.0
    contact_margin: Number = 0.0
    obstacle_sigma: Number = 0.0
    obstacle_margin: Number = 0.0
    limit_sigma: Number = 0.0
    reach: Number = 0.0
    beta: Number = 0.0


class _Crowd(Table):
    mode: Text = "joint"
    pairs: Text = "all"
    now: Number = 0.0


class _Person(Table):
    id: Text
    track: list[tuple[Number, Number, Number]]
    radius: Number = 0.0


class _FieldOfView(Table):
    range: Number = 0.0
    angle: Number = 0.0
    occlusion: Flag = True


class _Level(Table):
    name: Text = ""
    sigma: Number = 0.0
    length: Number = 0.0
    h: Number = 0.0
    Qc: Number | None = None
    follows: Text | None = None
    every: Whole = 1
    plans: list[_Given] = []


class _Datum(Table):
    on: Text | None = None
    time: Number | None = None
    position: Point | None = None
    velocity: Point | None = None
    sigma: Number | None = None
    covariance: list[list[Number]] | None = None


class _File(Table):
    robot: _Robot
    name: Text | None = None
    map: _Map | None = None
    goal: _Goal | None = None
    plans: _Plans = Field(default_factory=_Plans)
    density: _Density = Field(default_factory=_Density)
    crowd: _Crowd = Field(default_factory=_Crowd)
    people: list[_Person] = []
    field_of_view: _FieldOfView | None = None
    levels: list[_Level] | None = None
    data: list[_Datum] = []
    regions: list[RegionTable] = []
    mission: MissionTable | None = None
    tactics: list[TacticTable] = []
    world: dict[str, Any] | None = None  # of a simulation: fgplan.simulation.file reads it


MODELS = {"holonomic": Holonomic, "differential": DifferentialDrive, "car": CarLike}
"""Robot models by name; their fields are keys of [robot]."""

MOST_CELLS = 40_000_000
"""Of a map drawn in a scenario file: more would take minutes and gigabytes."""

_ROWS = {"track": (1, 3), "path": (1, 2), "polygon": (1, 2), "polygons": (2, 2)}
"""Lists of rows: how deep the rows are, and how long."""

_TABLES = {"people", "given", "levels", "data", "regions", "facts", "plans", "tactics"}
"""Lists of tables: one that cannot be read becomes an empty one."""

_UNREADABLE: dict[str, Any] = {
    "position": [np.nan, np.nan],
    "track": [[np.nan] * 3],
    "path": [[np.nan, np.nan]] * 2,
    "robot": {"position": [np.nan, np.nan]},
}
"""Stand-ins for required values that are missing or cannot be read."""

_MENDS = {
    "missing": "is missing; give it",
    "float_type": "give a number",
    "int_type": "give a whole number",
    "string_type": 'give a text in "quotes"',
    "bool_type": "give true or false",
    "list_type": "give a list in [brackets]",
    "tuple_type": "give a list in [brackets]",
    "too_long": "has too many entries",
    "model_type": "give a table",
}


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
    table, mistakes = _structure(raw)
    return _understand(table, mistakes, path)


def _understand(table: _File, mistakes: list[Mistake], path: Path) -> Scenario:
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
    new = [m for m in meant if not any(_overlap(m.path, known) for known in reported)]
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


def _structure(raw: Mapping[str, Any]) -> tuple[_File, list[Mistake]]:
    """The tables with their types, and what had to be replaced on the way."""
    tables = copy.deepcopy(dict(raw))
    mistakes: list[Mistake] = []
    while True:
        try:
            table = _File.model_validate(tables)
            return table, list({found.path: found for found in mistakes}.values())
        except ValidationError as error:
            # Every round replaces each value that is wrong by one that is not, from the inside
            # out, so that there is an end. A missing key may follow from a value taken out.
            known = [found.path for found in mistakes]
            for issue in error.errors(include_url=False):
                loc = issue["loc"]
                found = mistake(loc, issue)
                if not any(_overlap(found.path, path) for path in known):
                    mistakes.append(found)
                _repair(tables, loc, issue["type"])


def mistake(
    loc: tuple[int | str, ...], issue: Mapping[str, Any], root: type[BaseModel] = _File
) -> Mistake:
    """What pydantic found, as a mistake.

    Args:
        loc: Where, from the root.
        issue: One entry of `ValidationError.errors()`.
        root: The table of the whole file.
    """
    kind = issue["type"]
    if kind == "extra_forbidden":
        return Mistake(_spell(loc), issue["input"], _nearest(loc, root))
    if kind == "missing" and isinstance(loc[-1], int):
        return Mistake(_spell(loc[:-1]), issue["input"], "has too few entries")
    value = None if kind == "missing" else issue["input"]
    return Mistake(_spell(loc), value, _MENDS.get(kind, issue["msg"]))


def _nearest(loc: tuple[int | str, ...], model: type[BaseModel]) -> str:
    """How to mend an unknown key."""
    for part in loc[:-1]:
        if isinstance(part, str):
            model = _table_of(model.model_fields[part].annotation)
    valid = sorted(model.model_fields)
    close = get_close_matches(str(loc[-1]), valid, n=1)
    if close:
        return f"is not a key; did you mean {close[0]!r}?"
    return f"is not a key; the keys here are {', '.join(valid)}"


def _table_of(annotation: Any) -> type[BaseModel]:
    """The table inside an annotation such as `list[_Person] | None`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    inner = [arg for arg in get_args(annotation) if arg is not type(None)]
    return _table_of(inner[0])


def _repair(tables: dict[str, Any], loc: tuple[int | str, ...], kind: str) -> None:
    """Take out what cannot be read, or put what nothing mistakes for a value in its place."""
    last = max(i for i, part in enumerate(loc) if isinstance(part, str))
    key = str(loc[last])
    owner: Any = tables
    for part in loc[:last]:
        owner = owner[part]
    depth, width = _ROWS.get(key, (0, 0))
    if depth and len(loc) > last + depth:
        if key not in owner:  # another mistake took it out in this round
            return
        rows = owner[key]
        for part in loc[last + 1 : last + depth]:
            rows = rows[part]
        rows[loc[last + depth]] = [np.nan] * width
    elif kind == "missing" and len(loc) == last + 1:
        # A name no other has.
        owner[key] = copy.deepcopy(_UNREADABLE.get(key, f"unnamed {_spell(loc)}"))
    elif key in _TABLES and key in owner and len(loc) > last + 1:
        owner[key][loc[last + 1]] = {}
    else:
        owner.pop(key, None)


def _map(
    table: _Map | None, folder: Path, unclear: bool
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
    if (xmax - xmin) * (ymax - ymin) > MOST_CELLS * table.resolution**2 > 0:
        mend = f"makes a map of more than {MOST_CELLS:g} cells; give a coarser one"
        return None, [Mistake("map.resolution", table.resolution, mend)]
    try:
        shapes = [np.asarray(polygon, dtype=float) for polygon in table.polygons]
        return OccupancyGrid.from_polygons(shapes, table.bounds, table.resolution), []
    except MapError as error:
        # "bounds: got ...; give ..." or "polygons[3]: got ...; give ..."
        key, _, what = str(error).partition(": ")
        return None, [Mistake(f"map.{key}", _stated(table, key), what.rpartition("; ")[2])]


def _stated(table: _Map, key: str) -> object:
    """What the file says at a key such as `bounds` or `polygons[3]`."""
    name, _, index = key.rstrip("]").partition("[")
    value = getattr(table, name, None)
    return value[int(index)] if index and value is not None else value


def _goal(table: _File) -> Sequence[Mistake]:
    """A file that asks for global plans and names no goal contradicts itself."""
    count = table.plans.count
    if table.goal is None and table.mission is None and count is not None and count > 0:
        mend = "asks for global plans without a goal; give [goal] position, or count = 0"
        return (Mistake("plans.count", count, mend),)
    return ()


def _choices(table: _File) -> Iterable[Mistake]:
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


def _measurement(datum: _Datum) -> Readings:
    value = datum.position if datum.velocity is None else datum.velocity
    quantity = "position" if datum.velocity is None else "velocity"
    noise: Any = datum.covariance
    if noise is None:  # one standard deviation for both axes; none at all is named as a mistake
        noise = np.eye(2) * (1.0 if datum.sigma is None else datum.sigma * abs(datum.sigma))
    where = _array((0.0, 0.0) if value is None else value)
    return Readings((Reading(datum.time, where, _array(noise), quantity),), datum.on)  # type: ignore[arg-type]


def _model(table: _Robot, unclear: bool) -> tuple[RobotModel, list[Mistake]]:
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


def _scenario(table: _File, grid: OccupancyGrid | None, model: RobotModel, stem: str) -> Scenario:
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


def _plan(given: _Given) -> GivenPlan:
    return GivenPlan(given.label, _array(given.path), given.weight)


def _level(table: _Level) -> Level:
    stated = table.stated()
    if "plans" in stated:
        stated["plans"] = tuple(map(_plan, table.plans))
    return Level(**stated)


def _track(person: _Person) -> Track:
    rows = np.asarray(person.track, dtype=float).reshape(-1, 3)
    radius = {name: value for name, value in person.stated().items() if name == "radius"}
    return Track(person.id, rows[:, 0], rows[:, 1:], **radius)


def _array(value: Any) -> Any:
    """As an array; rows of different lengths stay as they are, for `find_mistakes` to name."""
    try:
        return np.asarray(value, dtype=float)
    except ValueError:
        return value


def _spell(loc: Sequence[int | str]) -> str:
    """("people", 2, "track", 5) as people[2].track[5]."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in loc)
    return "".join(parts).removeprefix(".")


def _overlap(one: str, other: str) -> bool:
    """Whether one path names the same thing as the other, or a part of it."""
    short, long = sorted((one, other), key=len)
    return long.startswith(short) and long[len(short) :][:1] in ("", ".", "[")
