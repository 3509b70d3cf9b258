"""The part of a scenario file that says what is asked: regions, mission, tactical data."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from fgplan import tactical
from fgplan.errors import MissionError, Mistake
from fgplan.measuring import Measurement
from fgplan.mission import Fact, Mission
from fgplan.regions import Region
from fgplan.scenario import Scenario
from fgplan.tables import Flag, Number, Point, Table, Text

KINDS: dict[str, type[Any]] = {
    "keep_out": tactical.KeepOut,
    "keep_in": tactical.KeepIn,
    "speed_zone": tactical.SpeedZone,
    "deadline": tactical.Deadline,
    "pass": tactical.PassOn,
    "formation": tactical.Formation,
    "stay_behind": tactical.StayBehind,
}
"""Tactical data by name; their fields are the keys of [[tactics]]."""


class RegionTable(Table):
    """[[regions]]."""

    name: Text
    polygon: list[Point] | None = None
    centre: Point | None = None
    radius: Number = 0.0


class FactTable(Table):
    """[[mission.facts]]."""

    name: Text
    holds: Flag = False
    closes: Text | None = None


class MissionTable(Table):
    """[mission]."""

    formula: Text
    facts: list[FactTable] = []


class TacticTable(Table):
    """[[tactics]]."""

    kind: Text
    on: Text | None = None
    sigma: Number = 0.0
    region: Text | None = None
    person: Text | None = None
    leader: Text | None = None
    side: Text | None = None
    margin: Number = 0.0
    begins: Number = 0.0
    ends: Number = 0.0
    limit: Number = 0.0
    blend: Number = 0.0
    time: Number = 0.0
    opens: Number = 0.0
    speed: Number = 0.0
    point: Point | None = None
    direction: Point | None = None
    gap: Number = 0.0
    length: Number = 0.0
    offset: Point | None = None


def understood(
    scenario: Scenario,
    regions: Sequence[RegionTable],
    mission: MissionTable | None,
    tactics: Sequence[TacticTable],
) -> tuple[Scenario, list[Mistake]]:
    """The scenario with what is asked, and what makes no sense of it."""
    places, wrong = _regions(regions)
    asked, no_mission = _mission(mission)
    if not wrong:  # where a region cannot be read, the rest would not know its name
        scenario = scenario.replace(mission=asked)
        known = {region.name: region for region in places}
        data = [_tactic(f"tactics[{i}]", t, known, scenario) for i, t in enumerate(tactics)]
        wrong += [mistake for _, mistakes in data for mistake in mistakes]
        found = tuple(m for m, _ in data if m is not None)
        scenario = scenario.replace(data=(*scenario.data, *found))
    return scenario.replace(regions=places), [*wrong, *no_mission]


def _regions(tables: Sequence[RegionTable]) -> tuple[tuple[Region, ...], list[Mistake]]:
    """The regions, and those that are none."""
    regions, wrong = [], []
    for i, table in enumerate(tables):
        outline = table.polygon if table.centre is None else [table.centre]
        if (table.polygon is None) == (table.centre is None) or outline is None:
            mend = "give a polygon, or a centre with a radius"
            wrong.append(Mistake(f"regions[{i}]", table.name, mend))
            continue
        try:
            regions.append(Region(table.name, tuple(outline), table.radius))
        except ValueError as error:
            wrong.append(Mistake(f"regions[{i}]", table.name, str(error)))
    return tuple(regions), wrong


def _mission(table: MissionTable | None) -> tuple[Mission | None, list[Mistake]]:
    """The mission, or why it is none."""
    if table is None:
        return None, []
    facts = tuple(Fact(f.name, f.holds, f.closes) for f in table.facts)
    try:
        return Mission(table.formula, facts), []
    except MissionError as error:
        return None, [Mistake("mission.formula", table.formula, str(error))]


def _tactic(
    path: str, table: TacticTable, regions: dict[str, Region], scenario: Scenario
) -> tuple[Measurement | None, list[Mistake]]:
    """One piece of tactical data, or why it is none."""
    kind = KINDS.get(table.kind)
    if kind is None:
        mend = f"give one of {', '.join(map(repr, KINDS))}"
        return None, [Mistake(f"{path}.kind", table.kind, mend)]
    stated = {key: value for key, value in table.stated().items() if key != "kind"}
    wrong = list(_keys(path, table.kind, kind, stated))
    if "region" in stated and stated["region"] not in regions:
        mend = f"is no region; the regions are {', '.join(regions) or 'none'}"
        wrong.append(Mistake(f"{path}.region", stated["region"], mend))
    for key in stated.keys() & {"person", "leader"}:
        names = [track.identity for track in scenario.tracks]
        if names and stated[key] not in names:
            mend = f"is nobody here; the people are {', '.join(names)}"
            wrong.append(Mistake(f"{path}.{key}", stated[key], mend))
    if wrong:
        return None, wrong
    if "region" in stated:
        stated["region"] = regions[stated["region"]]
    for key in stated.keys() & {"point", "direction"}:
        stated[key] = np.array(stated[key], dtype=float)
    made = kind(**stated, t_ref=scenario.density.t_ref)
    try:
        tuple(made.pieces(scenario.now, np.array([0.0, 1.0])))
    except ValueError as error:
        return None, [Mistake(path, table.kind, str(error))]
    return made, []


def _keys(path: str, name: str, kind: type[Any], stated: dict[str, Any]) -> Iterable[Mistake]:
    """Keys that this kind does not have, and those that it needs."""
    own = {f.name: f for f in dataclasses.fields(kind) if f.name not in ("seen", "t_ref")}
    for key in sorted(stated.keys() - own.keys()):
        mend = f"is no property of the kind {name!r}; it has {', '.join(sorted(own))}"
        yield Mistake(f"{path}.{key}", stated[key], mend)
    for key, f in own.items():
        if f.default is dataclasses.MISSING and key not in stated:
            yield Mistake(f"{path}.{key}", None, "is missing; give it")
