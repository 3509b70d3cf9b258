"""Progress is made on the way that is followed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgplan import OccupancyGrid, Robot, Scenario
from fgplan.driving import Memory
from fgplan.driving.routing import Routes, Way

GRID, OTHER = (OccupancyGrid.from_polygons([], (0, 0, 1, 1), 0.5) for _ in range(2))


def way(label, length):
    return Way(label, np.array([[0.0, 0.0], [length, 0.0]]))


def drive(steps):
    """For how long there was no progress [s], of steps (label followed, lengths by name, map)."""
    memory, longest = Memory(Scenario(Robot(np.zeros(2)), goal=np.ones(2))), []
    for now, (label, lengths, grid) in enumerate(steps):
        ways = tuple(way(name, length) for name, length in lengths.items())
        memory = replace(memory, scenario=memory.scenario.replace(now=float(now)))
        memory = memory.rerouted(Routes(ways, grid=grid))
        if label == memory.followed:
            longest.append(now - memory.progress()[1])
        memory = memory.following(label)
    return max(longest)


def test_the_way_round_a_blocked_aisle_is_progress():
    """8 m through people who stay, or 40 m round them, at 1 m/s."""
    aisle = [("A", {"A": 8.0, "B": 40.0}, GRID)] * 10
    round_it = [("B", {"A": 8.0 + t, "B": 40.0 - t}, GRID) for t in range(40)]
    assert drive(aisle + round_it) <= 10


@pytest.mark.parametrize("farther", [40.0, 8.5])
def test_a_map_that_makes_the_way_longer_is_no_stall(farther):
    before = [("A", {"A": 8.0 - t}, GRID) for t in range(4)]
    after = [("A", {"A": farther - t}, OTHER) for t in range(30) if t < farther]
    assert drive(before + after) <= 1


@pytest.mark.parametrize("grids", [[GRID], [GRID, OTHER]])
def test_who_does_not_come_nearer_makes_no_progress_whatever_the_map(grids):
    to_and_fro = [("A", {"A": 8.0 + 0.05 * (t % 2)}, grids[t % len(grids)]) for t in range(30)]
    assert drive(to_and_fro) >= 28
