"""The dynamic window: what it holds, and what it rejects and prefers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from fgplan import OccupancyGrid
from fgplan.peers.costmap import Costmap, Inflation
from fgplan.peers.dwa import Scene, Weights, Window, choose, scores

WINDOW = Window(min_speed=-0.2)
PATH = np.column_stack([np.arange(0.05, 5, 0.1), np.full(50, 0.05)])


def scene(*people: list[float]) -> Scene:
    """Open ground with the path along the x axis."""
    grid = OccupancyGrid.from_array(np.zeros((60, 70), dtype=bool), 0.1, (-1.0, -3.0, 0.0))
    built = Scene.build(Costmap.build(grid, Inflation(0.25), people), PATH, Weights())
    assert built is not None
    return built


@given(st.floats(-0.5, 1.5), st.floats(-2, 2))
def test_commands_can_be_reached_and_are_allowed(v: float, w: float) -> None:
    rng = np.random.default_rng(0)
    for commands in (WINDOW.lattice([v, w], 5, 7), WINDOW.sample([v, w], 35, rng)):
        change = np.abs(commands - [v, w]).max(axis=0)
        assert np.all(change <= WINDOW.period * np.array([1.0, 3.0]) + 1e-12)
        # Who is beyond a limit may be there still, but no further.
        assert commands[:, 0].max() <= max(WINDOW.max_speed, v - 0.1) + 1e-12
        assert commands[:, 0].min() >= min(WINDOW.min_speed, v + 0.1) - 1e-12
        assert np.abs(commands[:, 1]).max() <= max(WINDOW.max_yaw_rate, abs(w) - 0.3) + 1e-12


def test_roll_out_is_an_arc() -> None:
    states = WINDOW.roll_out([1.0, 2.0, 0.5], np.array([[0.8, 1.0], [0.5, 0.0]]))
    assert states.shape == (2, 18, 5)
    centre = np.array([1.0, 2.0]) + 0.8 * np.array([-np.sin(0.5), np.cos(0.5)])
    assert_allclose(np.linalg.norm(states[0, :, :2] - centre, axis=1), 0.8, atol=1e-9)
    assert_allclose(states[0, -1, 2], 0.5 + 1.7)
    assert_allclose(states[1, -1, :2], [1 + 0.85 * np.cos(0.5), 2 + 0.85 * np.sin(0.5)])


def test_on_the_path_it_drives_on_straight_and_fast() -> None:
    commands = WINDOW.lattice([0.5, 0.0], 5, 7)
    choice = choose(scene(), WINDOW.roll_out([0.0, 0.05, 0.0], commands))
    assert choice.index is not None
    assert_allclose(commands[choice.index], [0.6, 0.0], atol=1e-12)
    assert choice.rejected == 0


def test_beside_the_path_it_turns_back_to_it() -> None:
    commands = WINDOW.lattice([0.5, 0.0], 5, 7)
    choice = choose(scene(), WINDOW.roll_out([0.0, 1.0, 0.0], commands))
    assert choice.index is not None
    assert commands[choice.index][1] < 0


def test_somebody_in_the_way_rejects_what_leads_into_them() -> None:
    ground = scene([0.8, 0.0])
    straight = WINDOW.roll_out([0.0, 0.05, 0.0], np.array([[0.6, 0.0]]))
    assert scores(ground, straight) == -1.0
    commands = WINDOW.lattice([0.6, 0.0], 5, 7)
    choice = choose(ground, WINDOW.roll_out([0.0, 0.05, 0.0], commands))
    assert choice.rejected > 0


def test_all_round_blocked_is_no_choice() -> None:
    ground = scene([0.6, 0.0], [-0.6, 0.0], [0.0, 0.6], [0.0, -0.6])
    choice = choose(ground, WINDOW.roll_out([0.0, 0.0, 0.0], WINDOW.lattice([0.8, 0.0], 5, 7)))
    assert (choice.index, choice.cost, choice.rejected) == (None, np.inf, 35)


def test_leaving_the_map_is_rejected() -> None:
    away = WINDOW.roll_out([-0.9, 0.0, np.pi], np.array([[0.5, 0.0]]))
    assert scores(scene(), away) == -1.0


def test_where_path_and_goal_are_cut_off_it_is_rejected() -> None:
    occupied = np.zeros((30, 50), dtype=bool)
    occupied[:, 25] = True
    grid = OccupancyGrid.from_array(occupied, 0.1, (0.0, -1.5, 0.0))
    far = np.column_stack([np.arange(3.5, 4.5, 0.1), np.zeros(10)])
    built = Scene.build(Costmap.build(grid, Inflation(0.25)), far, Weights())
    assert built is not None
    assert scores(built, WINDOW.roll_out([0.5, 0.0, 0.0], np.array([[0.5, 0.0]]))) == -2.0


def test_a_plan_outside_the_costmap_is_no_scene() -> None:
    ground = scene()
    assert Scene.build(ground.costmap, PATH + 90.0, Weights()) is None


@pytest.mark.parametrize("weights", [Weights(), Weights(10, 5, 0.1)])
def test_cost_is_the_weighted_sum(weights: Weights) -> None:
    ground = scene()
    ground = Scene(ground.costmap, ground.path, ground.goal, weights)
    end = WINDOW.roll_out([0.04, 1.04, 0.0], np.array([[0.0, 0.0]]))
    # Ten cells beside the path, 49 and ten from its end, three fewer from the nose, nothing near.
    expected = 0.05 * (weights.path_bias * (10 + 10) + weights.goal_bias * (59 + 56))
    assert scores(ground, end) == pytest.approx(expected)
