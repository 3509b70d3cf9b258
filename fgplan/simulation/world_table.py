"""[world]: the table of a scenario file that makes it a simulation file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import Field, ValidationError

from fgplan.errors import FgplanError, Mistake
from fgplan.mission import Mission
from fgplan.scenario import FieldOfView
from fgplan.simulation.operators import operator_named
from fgplan.simulation.sensor import Quality
from fgplan.structure import mistake
from fgplan.tables import Flag, Number, Point, Table, Text, Whole

Box = tuple[Number, Number, Number, Number]

MOTIONS = ("orca", "human-like", "heedless")
ENDS = ("stay", "back", "anew")


class PeopleTable(Table):
    """[[world.people]]: a group."""

    area: Box
    waypoints: list[Point]
    count: Whole = 1
    spread: Number = 0.0
    speed: Number = 1.2
    speed_sigma: Number = 0.0
    radius: Number = 0.3
    begins: Number = 0.0
    moving: Flag = True
    ends: Text = "stay"
    entry: Box | None = None


class SensorTable(Table):
    """[world.sensor]."""

    noise: Number = 0.0
    missed: Number = 0.0
    dropout: Number = 0.0
    latency: Number = 0.0
    identities: Flag = True
    velocities: Flag = False
    range: Number = np.inf
    angle: Number = 2 * np.pi
    occlusion: Flag = True
    map_range: Number = np.inf

    def quality(self, view: FieldOfView | None) -> Quality:
        """As the sensors take it; `view` is that of the scenario, for where none is stated."""
        stated = self.stated()
        own = {k: stated.pop(k) for k in ("range", "angle", "occlusion") if k in stated}
        return Quality(**stated, view=FieldOfView(**own) if own else view)


class EventTable(Table):
    """[[world.events]]."""

    time: Number
    goal: Point | None = None
    facts: dict[str, Flag] = Field(default_factory=dict)


class WaypointTable(Table):
    """[[world.waypoints]]: a place that the operator names."""

    name: Text
    position: Point
    sigma: Number
    said: Number = 0.0
    time: Number | None = None


class DiscsTable(Table):
    """[world.discs]: round obstacles."""

    count: Whole
    radius: tuple[Number, Number]
    area: Box
    apart: Number = 0.0


class WorldTable(Table):
    """[world]."""

    motion: Text = "orca"
    sees_robot: Flag = True
    start_spread: Number = 0.0
    time_limit: Number = 60.0
    tolerance: Number = 0.3
    period: Number = 0.1
    substeps: Whole = 2
    contact_ends: Flag = False
    max_yaw_rate: Number = 1.5
    max_yaw_acceleration: Number = 3.0
    faults: Number = 0.0
    via: list[Text] = Field(default_factory=list)
    people: list[PeopleTable] = Field(default_factory=list)
    sensor: SensorTable = Field(default_factory=SensorTable)
    events: list[EventTable] = Field(default_factory=list)
    discs: DiscsTable | None = None
    operator: Text | None = None
    waypoints: list[WaypointTable] = Field(default_factory=list)


class _Root(Table):
    """Where paths begin."""

    world: WorldTable


def understood(
    raw: Mapping[str, Any], regions: Sequence[str] | None
) -> tuple[WorldTable | None, list[Mistake]]:
    """The table, or None, and what is wrong with it.

    Args:
        raw: The tables of the whole file.
        regions: Names of the regions of the map; None where nobody knows.
    """
    if raw.get("world") is None:
        mend = "is missing; a simulation needs a table [world], see docs/simulation.md"
        return None, [Mistake("world", None, mend)]
    try:
        table = _Root.model_validate({"world": raw["world"]}).world
    except ValidationError as error:
        issues = error.errors(include_url=False)
        return None, [mistake(issue["loc"], issue, _Root) for issue in issues]
    return table, list(_senseless(table, regions))


def unknown_facts(table: WorldTable, mission: Mission | None) -> Iterable[Mistake]:
    """Facts of events that the mission does not have."""
    known = [] if mission is None else [fact.name for fact in mission.facts]
    for i, event in enumerate(table.events):
        for name, value in event.facts.items():
            if name not in known:
                mend = f"is no fact of the mission; it has {', '.join(known) or 'none'}"
                yield Mistake(f"world.events[{i}].facts.{name}", value, mend)


def _senseless(table: WorldTable, regions: Sequence[str] | None) -> Iterable[Mistake]:
    """Yields every value that makes no sense."""
    path = "world"
    if table.motion not in MOTIONS:
        yield Mistake(f"{path}.motion", table.motion, f"give one of {_listed(MOTIONS)}")
    above = "time_limit", "tolerance", "period", "substeps", "max_yaw_rate", "max_yaw_acceleration"
    yield from _above(path, table, *above)
    yield from _not_negative(path, table, "start_spread")
    yield from _shares(path, table, "faults")
    for i, name in enumerate(table.via):
        if regions is not None and name not in regions:
            mend = f"is no region; the regions are {', '.join(regions) or 'none'}"
            yield Mistake(f"{path}.via[{i}]", name, mend)
    for i, group in enumerate(table.people):
        yield from _people(f"{path}.people[{i}]", group)
    sensor = f"{path}.sensor"
    yield from _not_negative(sensor, table.sensor, "noise", "latency")
    yield from _shares(sensor, table.sensor, "missed", "dropout")
    yield from _above(sensor, table.sensor, "range", "angle", "map_range", finite=False)
    for i, event in enumerate(table.events):
        yield from _not_negative(f"{path}.events[{i}]", event, "time")
        if event.goal is not None and not np.all(np.isfinite(event.goal)):
            yield Mistake(f"{path}.events[{i}].goal", event.goal, "give finite numbers")
        if event.goal is None and not event.facts:
            yield Mistake(f"{path}.events[{i}]", event.time, "says nothing; give a goal, or facts")
    yield from _operator(path, table)
    if table.discs is not None:
        discs = table.discs
        yield from _not_negative(f"{path}.discs", discs, "count", "apart")
        yield from _box(f"{path}.discs.area", discs.area)
        if not 0 < discs.radius[0] <= discs.radius[1] < np.inf:
            mend = "give the smallest and the largest radius, above 0"
            yield Mistake(f"{path}.discs.radius", discs.radius, mend)


def _operator(path: str, table: WorldTable) -> Iterable[Mistake]:
    if table.operator is not None:
        try:
            operator_named(table.operator)
        except FgplanError as error:
            yield Mistake(f"{path}.operator", table.operator, str(error))
    for i, place in enumerate(table.waypoints):
        own = f"{path}.waypoints[{i}]"
        yield from _not_negative(own, place, "said")
        yield from _above(own, place, "sigma")
        if not np.all(np.isfinite(place.position)):
            yield Mistake(f"{own}.position", place.position, "give finite numbers")
        if place.time is not None and not np.isfinite(place.time):
            yield Mistake(f"{own}.time", place.time, "give a finite number, or none")


def _people(path: str, group: PeopleTable) -> Iterable[Mistake]:
    yield from _not_negative(path, group, "count", "spread", "speed_sigma", "begins")
    yield from _above(path, group, "speed", "radius")
    yield from _box(f"{path}.area", group.area)
    if group.entry is not None:
        yield from _box(f"{path}.entry", group.entry)
    if group.ends not in ENDS:
        yield Mistake(f"{path}.ends", group.ends, f"give one of {_listed(ENDS)}")
    if not group.waypoints or not np.all(np.isfinite(group.waypoints)):
        mend = "give one place to walk to, or more, in finite numbers"
        yield Mistake(f"{path}.waypoints", group.waypoints, mend)


def _above(path: str, owner: Table, *names: str, finite: bool = True) -> Iterable[Mistake]:
    for name in names:
        value = getattr(owner, name)
        if not value > 0 or (finite and np.isinf(value)):
            yield Mistake(f"{path}.{name}", value, "give a number above 0")


def _not_negative(path: str, owner: Table, *names: str) -> Iterable[Mistake]:
    for name in names:
        value = getattr(owner, name)
        if not 0 <= value < np.inf:
            yield Mistake(f"{path}.{name}", value, "give 0 or a finite number above it")


def _shares(path: str, owner: Table, *names: str) -> Iterable[Mistake]:
    for name in names:
        value = getattr(owner, name)
        if not 0 <= value <= 1:
            yield Mistake(f"{path}.{name}", value, "give a share from 0 to 1")


def _box(path: str, box: Box) -> Iterable[Mistake]:
    xmin, ymin, xmax, ymax = box
    if not (xmin <= xmax and ymin <= ymax and np.all(np.isfinite(box))):
        yield Mistake(path, box, "give xmin, ymin, xmax, ymax with min ≤ max")


def _listed(words: Sequence[str]) -> str:
    return ", ".join(map(repr, words))
