"""What a scenario file may say: its tables, whose keys are the fields of `fgplan.scenario`."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field
from pydantic_core import PydanticCustomError

from fgplan.tables import Flag, Number, Point, Table, Text, Whole
from fgplan.task_file import MissionTable, RegionTable, TacticTable


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


class MapTable(Table):
    file: Text | None = None
    polygons: list[list[Point]] | None = None
    bounds: tuple[Number, Number, Number, Number] | None = None
    resolution: Number | None = None


class RobotTable(Table):
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


class GoalTable(Table):
    position: Point
    speed: Number = 0.0


class GivenTable(Table):
    label: Text
    path: list[Point]
    weight: Number | None = None


class PlansTable(Table):
    count: Whole | None = None
    given: list[GivenTable] = []


class DensityTable(Table):
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


class CrowdTable(Table):
    mode: Text = "joint"
    pairs: Text = "all"
    now: Number = 0.0


class PersonTable(Table):
    id: Text
    track: list[tuple[Number, Number, Number]]
    radius: Number = 0.0


class FieldOfViewTable(Table):
    range: Number = 0.0
    angle: Number = 0.0
    occlusion: Flag = True


class LevelTable(Table):
    name: Text = ""
    sigma: Number = 0.0
    length: Number = 0.0
    h: Number = 0.0
    Qc: Number | None = None
    follows: Text | None = None
    every: Whole = 1
    plans: list[GivenTable] = []


class DatumTable(Table):
    on: Text | None = None
    time: Number | None = None
    position: Point | None = None
    velocity: Point | None = None
    sigma: Number | None = None
    covariance: list[list[Number]] | None = None


class FileTable(Table):
    robot: RobotTable
    name: Text | None = None
    map: MapTable | None = None
    goal: GoalTable | None = None
    plans: PlansTable = Field(default_factory=PlansTable)
    density: DensityTable = Field(default_factory=DensityTable)
    crowd: CrowdTable = Field(default_factory=CrowdTable)
    people: list[PersonTable] = []
    field_of_view: FieldOfViewTable | None = None
    levels: list[LevelTable] | None = None
    data: list[DatumTable] = []
    regions: list[RegionTable] = []
    mission: MissionTable | None = None
    tactics: list[TacticTable] = []
    world: dict[str, Any] | None = None  # of a simulation: fgplan.simulation.file reads it
