"""Costmaps: values of ROS, distances over cells, the global plan."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from fgplan import OccupancyGrid
from fgplan.peers.costmap import (
    FREE,
    INSCRIBED,
    LETHAL,
    UNKNOWN,
    Costmap,
    Inflation,
    shortest_path,
    window,
)

INFLATION = Inflation(0.25, radius=0.75, scaling=5.0)


def wall(gap: bool = True) -> OccupancyGrid:
    """4 m by 4 m with a wall along x = 2, open for y > 3 unless closed."""
    occupied = np.zeros((40, 40), dtype=bool)
    occupied[: 30 if gap else 40, 20] = True
    return OccupancyGrid.from_array(occupied, 0.1, (0.0, 0.0, 0.0))


def test_values_are_those_of_ros() -> None:
    d = np.array([0.0, 0.1, 0.25, 0.35, 0.55, 0.75, 0.76])
    decay = [int(252 * np.exp(-5 * 0.1)), int(252 * np.exp(-5 * 0.3)), int(252 * np.exp(-5 * 0.5))]
    assert_array_equal(INFLATION.cost(d), [LETHAL, INSCRIBED, INSCRIBED, *decay, FREE])


@given(st.floats(0, 2), st.floats(0, 2))
def test_farther_is_never_dearer(a: float, b: float) -> None:
    near, far = INFLATION.cost(np.array(sorted([a, b]))).tolist()
    assert near >= far


def test_a_person_is_a_lethal_disc() -> None:
    grid = OccupancyGrid.from_array(np.zeros((40, 40), dtype=bool), 0.1, (0.0, 0.0, 0.0))
    costmap = Costmap.build(grid, INFLATION, [[2.0, 2.0]], person_radius=0.3)
    assert costmap.at([2.05, 2.05]) == LETHAL
    assert costmap.at([2.45, 2.05]) == INSCRIBED  # 0.25 m from the disc
    assert 0 < costmap.at([2.75, 2.05]) < INSCRIBED
    assert costmap.at([3.9, 2.05]) == FREE
    assert costmap.at([4.1, 2.0]) == UNKNOWN  # outside


def test_a_person_smaller_than_a_cell_still_counts() -> None:
    grid = OccupancyGrid.from_array(np.zeros((4, 4), dtype=bool), 1.0, (0.0, 0.0, 0.0))
    assert Costmap.build(grid, INFLATION, [[1.1, 1.1]], 0.05).at([1.5, 1.5]) == LETHAL


def test_people_outside_the_map_are_left_out() -> None:
    grid = wall()
    away = Costmap.build(grid, INFLATION, [[90.0, 90.0], [-9.0, 1.0]])
    assert_array_equal(away.values, Costmap.build(grid, INFLATION).values)


@pytest.mark.parametrize(("free", "value"), [(True, FREE), (False, UNKNOWN)])
def test_unknown_cells(free: bool, value: int) -> None:
    data = np.zeros((10, 10), dtype=np.int8)
    data[2, 3] = -1
    grid = OccupancyGrid(data, 0.1, np.zeros(3), unknown_is_free=free)
    assert Costmap.build(grid, INFLATION).values[2, 3] == value


def test_steps_go_round_what_is_blocked() -> None:
    costmap = Costmap.build(wall(), Inflation(0.0, 0.0))
    steps = costmap.steps_to(np.array([[0, 19]]))
    assert steps[0, 19] == 0
    assert steps[0, 18] == 1
    assert steps[0, 21] == 62  # up 30, two across, down 30
    assert steps[0, 20] == np.inf


def test_targets_that_are_blocked_lead_nowhere() -> None:
    costmap = Costmap.build(wall(), Inflation(0.0, 0.0))
    assert np.all(costmap.steps_to(np.array([[0, 20]])) == np.inf)


def test_path_goes_through_the_gap_and_keeps_clear() -> None:
    costmap = Costmap.build(wall(), INFLATION)
    path = shortest_path(costmap, [1.0, 1.0], [3.0, 1.0])
    assert path is not None
    assert_allclose(path[[0, -1]], [[1.05, 1.05], [3.05, 1.05]])
    assert np.all(costmap.at(path) < INSCRIBED)
    assert path[:, 1].max() > 3.0
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() < 0.1 * np.sqrt(2) + 1e-9


@pytest.mark.parametrize("goal", [[3.0, 1.0], [2.05, 1.0], [9.0, 9.0]])
def test_no_path_is_none(goal: Any) -> None:
    assert shortest_path(Costmap.build(wall(gap=False), INFLATION), [1.0, 1.0], goal) is None


def test_a_robot_in_an_inflated_cell_still_gets_away() -> None:
    costmap = Costmap.build(wall(), INFLATION)
    assert costmap.at([1.85, 1.0]) == INSCRIBED
    inside = shortest_path(costmap, [1.85, 1.0], [1.0, 1.0])
    assert inside is not None


@given(st.floats(-1, 5), st.floats(-1, 5), st.floats(-3, 3))
def test_window_is_a_part_of_the_map(x: float, y: float, yaw: float) -> None:
    data = np.random.default_rng(0).integers(0, 101, (40, 40)).astype(np.int8)
    grid = OccupancyGrid(data, 0.1, np.array([0.3, -0.2, yaw]))
    part = window(grid, [x, y], 1.5)
    rows, cols = part.data.shape
    assert 1 <= rows <= 17
    assert 1 <= cols <= 17
    cells = np.stack(np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij"), axis=-1)
    whole = grid.world_to_cell(part.cell_to_world(cells))
    assert_array_equal(part.data, grid.data[whole[..., 0], whole[..., 1]])
