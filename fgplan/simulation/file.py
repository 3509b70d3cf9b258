"""Simulation files: a scenario file with a [world], and the worlds that it makes.

Start, people, obstacles, sensors and faults each have random numbers of their own, so that a change
of one leaves the rest of a seed's world as it was.
"""

from __future__ import annotations

import copy
import re
import tomllib
from dataclasses import dataclass, replace
from functools import lru_cache
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgplan import scenario_file
from fgplan.errors import Mistake, NoRoute, ScenarioError
from fgplan.occupancy import OccupancyGrid
from fgplan.regions import Region
from fgplan.routes import find_routes
from fgplan.scenario import Scenario
from fgplan.shared_control import Waypoint
from fgplan.simulation.body import Limits
from fgplan.simulation.errand import way_of
from fgplan.simulation.faults import Faults
from fgplan.simulation.human_like import HumanLike
from fgplan.simulation.operators import Names, operator_named
from fgplan.simulation.orca import Orca
from fgplan.simulation.people import Motion, heedless
from fgplan.simulation.sensor import Sensors, known_at_first
from fgplan.simulation.walkers import Walker, Walkers
from fgplan.simulation.walls import rectangles
from fgplan.simulation.world import Event, Operator, Rules, World
from fgplan.simulation.world_table import (
    Box,
    DiscsTable,
    EventTable,
    PeopleTable,
    WorldTable,
    understood,
    unknown_facts,
)
from fgplan.timing import path_length

Array = NDArray[np.float64]

START, PEOPLE, DISCS = 2, 3, 4
"""Streams of the seed's random numbers; 1 is the operator's."""
TRIES = 2000
"""Places that are drawn before there is no room left."""
ROOM = 1.0
"""Round obstacles leave this much room around start and goal [m]."""
QUICKEST, SLOWEST = 1.3, 0.3
"""Largest speed of a person, and the least that is drawn, as a share of the group's."""
_STEP = re.compile(r"([^.\[\]]+)|\[(\d+)\]")


@dataclass(frozen=True)
class FromFile:
    """Makes the worlds of a simulation file.

    Args:
        path: The TOML file.
        changes: Keys and values that replace those of the file: ("world.people[0].count", "12").
    """

    path: Path
    changes: tuple[tuple[str, str], ...] = ()

    @property
    def name(self) -> str:
        """The file's, with the changes."""
        return " ".join([self.path.stem, *(f"{key}={value}" for key, value in self.changes)])

    @property
    def version(self) -> str:
        """Changes with what the file says."""
        return sha256(self.path.read_bytes()).hexdigest()[:12]

    def check(self) -> None:
        """Read the file.

        Raises:
            ScenarioError: it cannot be read or makes no sense; all mistakes are named.
        """
        self._read()

    def __call__(self, seed: int) -> World:
        """The world of a seed.

        Raises:
            ScenarioError: as `check`, or there is no room for people or obstacles.
        """
        scenario, table = self._read()
        grid = scenario.grid
        start = _start(self.path, scenario, table, np.random.default_rng([seed, START]))
        scenario = scenario.replace(robot=replace(scenario.robot, position=start))
        if table.discs is not None:
            rng = np.random.default_rng([seed, DISCS])
            grid = _with_discs(self.path, scenario, table.discs, rng)
        walkers: list[Walker] = []
        rng = np.random.default_rng([seed, PEOPLE])
        for i, group in enumerate(table.people):
            at = f"world.people[{i}].area"
            for number in range(group.count):
                walker = _walker(scenario, grid, group, walkers, rng)
                if walker is None:
                    mend = f"no room left for person {number + 1} of {group.count}; give more"
                    raise ScenarioError(str(self.path), (Mistake(at, group.area, mend),))
                walkers.append(walker)
        quality = table.sensor.quality(scenario.field_of_view)
        via = tuple(r for name in table.via for r in scenario.regions if r.name == name)
        name = f"{self.name}, seed {seed}"
        reference = _shortest(grid, scenario, via, table)
        known = known_at_first(grid, start, quality.map_range)
        world = World(
            name=name,
            scenario=scenario.replace(grid=known, field_of_view=quality.view, name=name),
            people=Walkers(walkers, _motion(table.motion, walkers, grid)),
            sensor=Sensors(quality, grid, seed),
            limits=Limits(
                scenario.robot.max_speed,
                scenario.robot.max_acceleration,
                table.max_yaw_rate,
                table.max_yaw_acceleration,
            ),
            rules=Rules(
                period=table.period,
                substeps=table.substeps,
                time_limit=table.time_limit,
                tolerance=table.tolerance,
                contact_ends=table.contact_ends,
                seen_by_people=table.sees_robot,
            ),
            grid=grid,
            events=tuple(map(_event, table.events)),
            via=via,
            tamper=Faults(table.faults, seed) if table.faults > 0 else None,
            reference=reference,
        )
        return replace(world, operator=_operator(world, table, seed))

    def _read(self) -> tuple[Scenario, WorldTable]:
        try:
            written = self.path.stat().st_mtime_ns
        except OSError:
            written = 0  # reading it says what is wrong
        return _understood(self.path, self.changes, written)


@lru_cache(maxsize=8)
def _understood(
    path: Path, changes: tuple[tuple[str, str], ...], written: int
) -> tuple[Scenario, WorldTable]:
    """Scenario and world of a file as it was written at a time."""
    raw = scenario_file.read(path)
    for key, value in changes:
        raw = _changed(path, raw, key, value)
    scenario: Scenario | None = None
    mistakes: list[Mistake] = []
    try:
        scenario = scenario_file.parse(raw, path)
    except ScenarioError as error:
        mistakes += error.mistakes
    regions = None if scenario is None else [r.name for r in scenario.regions]
    table, wrong = understood(raw, regions)
    mistakes += wrong
    if scenario is not None and scenario.goal is None and scenario.mission is None:
        mistakes.append(Mistake("goal", None, "is missing; a run ends there, or with a [mission]"))
    if scenario is not None and table is not None:
        mistakes += unknown_facts(table, scenario.mission)
    if mistakes or scenario is None or table is None:
        raise ScenarioError(str(path), tuple({m.path: m for m in mistakes}.values()))
    return scenario, table


def _changed(path: Path, raw: dict[str, Any], key: str, text: str) -> dict[str, Any]:
    """The tables with one key changed; what is no TOML is a text."""
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text
    tables = copy.deepcopy(raw)
    steps = [int(i) if i else k for k, i in _STEP.findall(key)]
    owner: Any = tables
    try:
        for step, after in pairwise(steps):
            if isinstance(owner, dict) and isinstance(after, str):
                owner.setdefault(step, {})
            owner = owner[step]
        owner[steps[-1]] = value
    except (LookupError, TypeError):
        mend = "names nothing in the file; see docs/simulation.md for its keys"
        raise ScenarioError(str(path), (Mistake("--set", key, mend),)) from None
    return tables


def _start(path: Path, scenario: Scenario, table: WorldTable, rng: np.random.Generator) -> Array:
    """Where the robot starts."""
    robot, spread = scenario.robot, table.start_spread
    for _ in range(TRIES):
        place = np.asarray(robot.position + rng.uniform(-spread, spread, 2))
        if scenario.grid is None or scenario.grid.clearance(place, robot.radius) > 0:
            return place
    mistake = Mistake("world.start_spread", spread, "no room left for the robot; give less")
    raise ScenarioError(str(path), (mistake,))


def _with_discs(
    path: Path, scenario: Scenario, discs: DiscsTable, rng: np.random.Generator
) -> OccupancyGrid:
    """The map with round obstacles."""
    if scenario.grid is None:
        mistake = Mistake("world.discs", discs.count, "needs a map to be drawn on; give [map]")
        raise ScenarioError(str(path), (mistake,))
    ends = [(scenario.robot.position, ROOM)]
    if scenario.goal is not None:
        ends.append((np.asarray(scenario.goal, dtype=float), ROOM))
    placed: list[tuple[Array, float]] = []
    for number in range(discs.count):
        radius = float(rng.uniform(*discs.radius))
        for _ in range(TRIES):
            place = _drawn(discs.area, rng)
            if all(np.hypot(*(place - p)) >= radius + r for p, r in ends) and all(
                np.hypot(*(place - p)) >= radius + r + discs.apart for p, r in placed
            ):
                placed.append((place, radius))
                break
        else:
            mend = f"no room left for disc {number + 1} of {discs.count}; give more, or fewer discs"
            raise ScenarioError(str(path), (Mistake("world.discs.area", discs.area, mend),))
    centres = scenario.grid.centres
    cells = np.zeros(centres.shape[:-1], dtype=bool)
    for place, radius in placed:
        cells |= np.hypot(*np.moveaxis(centres - place, -1, 0)) <= radius
    return scenario.grid.with_obstacles(cells)


def _walker(
    scenario: Scenario,
    grid: OccupancyGrid | None,
    group: PeopleTable,
    others: list[Walker],
    rng: np.random.Generator,
) -> Walker | None:
    """Somebody of a group, apart from walls, robot and others; None where there is no room."""
    robot, radius = scenario.robot, group.radius
    for _ in range(TRIES):
        place = _drawn(group.area, rng)
        free = grid is None or grid.clearance(place, radius) > 0
        free = free and np.hypot(*(place - robot.position)) > robot.radius + radius
        if free and all(np.hypot(*(place - o.position)) > radius + o.radius for o in others):
            break
    else:
        return None
    shift = rng.uniform(-group.spread, group.spread, (len(group.waypoints), 2))
    waypoints = np.array(group.waypoints, dtype=float) + shift
    speed = max(float(rng.normal(group.speed, group.speed_sigma)), SLOWEST * group.speed)
    entry = None if group.entry is None else _drawn(group.entry, rng)
    towards = waypoints[0] - place
    walks = group.moving and group.begins == 0
    velocity = towards / max(float(np.hypot(*towards)), 1e-9) * speed if walks else np.zeros(2)
    return Walker(
        place,
        waypoints,
        velocity=velocity,
        radius=radius,
        speed=speed,
        max_speed=QUICKEST * speed,
        ends=group.ends,  # type: ignore[arg-type]  # the table was checked
        entry=entry,
        begins=group.begins,
    )


def _operator(world: World, table: WorldTable, seed: int) -> Operator | None:
    """Who holds a stick and names places; None is nobody."""
    operator = None if table.operator is None else operator_named(table.operator)(world, seed)
    if not table.waypoints:
        return operator
    places = []
    for w in table.waypoints:
        when = None if w.time is None else world.scenario.now + w.time
        place = Waypoint(np.array(w.position), w.sigma**2 * np.eye(2), when, name=w.name)
        places.append((w.said, place))
    return Names(places, operator)


def _event(table: EventTable) -> Event:
    goal = None if table.goal is None else np.array(table.goal, dtype=float)
    return Event(table.time, goal, dict(table.facts))


def _motion(name: str, walkers: list[Walker], grid: OccupancyGrid | None) -> Motion:
    """How people move."""
    if name == "heedless":
        return heedless
    radii = np.array([w.radius for w in walkers], dtype=float)
    most = np.array([w.max_speed for w in walkers], dtype=float)
    settings = Orca() if name == "orca" else HumanLike()
    return settings.motion(radii, most, rectangles(grid))


def _shortest(
    grid: OccupancyGrid | None, scenario: Scenario, via: tuple[Region, ...], table: WorldTable
) -> float | None:
    """Length of the shortest way from the start over the regions to the last goal, or of that to
    do the mission [m]; None where it is a straight line, or there is none."""
    if scenario.mission is not None:
        return way_of(scenario.replace(grid=grid))
    if grid is None:
        return None
    moved = [event for event in table.events if event.goal is not None]
    last = max(moved, key=lambda event: event.time, default=None)
    goal = scenario.goal if last is None else last.goal
    between = [np.mean(region.polygon, axis=0) for region in via]
    places = [scenario.robot.position, *between, np.array(goal, dtype=float)]
    try:
        legs = (find_routes(grid, a, b, scenario.robot.radius, 1)[0] for a, b in pairwise(places))
        return sum(path_length(leg.path) for leg in legs)
    except NoRoute:
        return None


def _drawn(box: Box, rng: np.random.Generator) -> Array:
    """A place in a box."""
    return np.asarray(rng.uniform(box[:2], box[2:]))
