"""What robots meet on their paths: people and walls, and whether they move."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fgplan.safety import People
from fgplan.scenario import Scenario
from fgplan.trajectory import hermite, length

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def moving(path: Array) -> Mask:
    """When robots move on paths (M, S, 2), shape (M, S)."""
    moved = length(np.diff(path, axis=1)) > 1e-4
    return np.concatenate([moved[:, :1], moved], axis=1)


def gaps_of(scenario: Scenario, path: Array, times: Array, people: People) -> Array:
    """Between M robots (M, S, 2) and n people, shape (M, S, n) [m]."""
    if not people.states.shape[1]:
        return np.full((*path.shape[:2], 0), np.inf)
    where, _ = hermite(people.times, people.states[..., :2], people.states[..., 2:], times)
    apart = length(path[:, :, None] - where[None])
    return np.asarray(apart - (scenario.robot.radius + people.radii))


def walls_of(scenario: Scenario, path: Array) -> Array:
    """Gap to the map along M paths (M, S, 2), shape (M, S) [m]."""
    if scenario.grid is None:
        return np.full(path.shape[:2], np.inf)
    return scenario.grid.clearance(path, scenario.robot.radius)
