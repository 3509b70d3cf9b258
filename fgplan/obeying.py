"""Mission → tactical data: what the automaton's state requires of every place until it changes.

Regions that would fail the mission are kept out of, twice over: as tactical data of the level below
the mission, which plans around them, and as obstacles of the robot, which the hard check knows.
Regions that must not be left are tactical data alone. Both change with the automaton.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from fgplan.measuring import ROBOT, Measurement
from fgplan.mission import Mission, Rules, rules
from fgplan.occupancy import OccupancyGrid
from fgplan.regions import Region
from fgplan.scenario import Scenario
from fgplan.tactical import KeepIn, KeepOut

SIGMA = 0.05
"""Of tactical data that a mission gives [m]: a mission is kept, not weighed."""


def obeying(scenario: Scenario) -> Scenario:
    """The scenario with what its mission requires now: tactical data, and forbidden regions as
    obstacles. Without a mission, or without such rules, itself.

    Raises:
        MissionError: a name in the mission is neither region nor fact.
    """
    now = rules_now(scenario)
    if not now.forbidden and not now.held:
        return scenario
    data = (*scenario.data, *_tau(scenario, now))
    return closed(scenario, now).replace(data=data)


def closed(scenario: Scenario, now: Rules | None = None) -> Scenario:
    """The scenario with forbidden regions as obstacles alone.

    Args:
        scenario: What is known now.
        now: Its rules; None: they are found.
    """
    now = rules_now(scenario) if now is None else now
    if scenario.grid is None or not now.forbidden:
        return scenario
    shut = tuple(r for r in scenario.regions if r.name in now.forbidden)
    return scenario.replace(grid=_closed(scenario.grid, shut))


def tau(scenario: Scenario) -> tuple[Measurement, ...]:
    """The tactical data alone."""
    return tuple(_tau(scenario, rules_now(scenario)))


def _tau(scenario: Scenario, now: Rules) -> list[Measurement]:
    named = {region.name: region for region in scenario.regions}
    below = scenario.levels[1] if len(scenario.levels) > 1 else None
    level = below.name if below is not None and below.sigma > 0 else ROBOT
    given = {"on": level, "sigma": SIGMA, "t_ref": scenario.density.t_ref}
    margin = scenario.robot.radius + scenario.density.obstacle_margin
    found: list[Measurement] = []
    if level != ROBOT or scenario.grid is None:  # else they are obstacles already
        found += [KeepOut(named[name], margin, **given) for name in now.forbidden]  # type: ignore[arg-type]
    found += [KeepIn(named[name], **given) for name in now.held]  # type: ignore[arg-type]
    return found


def rules_now(scenario: Scenario) -> Rules:
    """What a scenario's mission requires of every place now; nothing without a mission."""
    if scenario.mission is None:
        return Rules()
    position = scenario.robot.position
    return _rules_at(
        scenario.mission,
        scenario.grid,
        scenario.regions,
        (float(position[0]), float(position[1])),
        scenario.robot.radius,
    )


@lru_cache(maxsize=4)
def _rules_at(
    mission: Mission,
    grid: OccupancyGrid | None,
    regions: tuple[Region, ...],
    position: tuple[float, float],
    radius: float,
) -> Rules:
    return rules(mission, grid, regions, np.array(position), radius)


@lru_cache(maxsize=4)
def _closed(grid: OccupancyGrid, regions: tuple[Region, ...]) -> OccupancyGrid:
    """The map with regions as obstacles; kept, so that distances are measured once."""
    inside = np.any([region.contains(grid.centres) for region in regions], axis=0)
    return grid.with_obstacles(inside)
