"""The layered stack in closed loop: a robot that does what it is told, at 10 Hz."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from factors.unicycle import advance
from fgplan import OccupancyGrid
from fgplan.peers.layered import RECOVERIES, LayeredStack, Settings, Status
from tests.scenes import blocks

PERIOD = 0.1
NOBODY = np.zeros((0, 2))


def drive(
    grid: OccupancyGrid,
    start: Any,
    goal: Any,
    people: Callable[[float], Any] = lambda _: NOBODY,
    settings: Settings | None = None,
    seconds: float = 40.0,
) -> tuple[Any, list[Status], list[str]]:
    """States (S, 5) of the robot until it arrives, fails or runs out of time."""
    stack, x = LayeredStack(settings), np.array([*start, 0.0, 0.0], dtype=float)
    states, ends, reasons = [x], [], []
    for k in range(round(seconds / PERIOD)):
        t = PERIOD * k
        command = stack.step(t, x[:3], x[3:], people(t), grid, goal)
        ends.append(command.status)
        reasons.append(command.reason)
        if command.status in (Status.REACHED, Status.FAILED):
            break
        wish = np.array([command.twist.linear_x, command.twist.angular_z])
        x = advance(np.array([*x[:3], *wish]), np.zeros(2), PERIOD)
        states.append(x)
    return np.array(states), ends, reasons


def clearance(grid: OccupancyGrid, states: Any) -> float:
    return float(grid.clearance(states[:, :2], 0.25).min())


@pytest.mark.parametrize("heading", [0.0, 2.5])
def test_it_solves_the_empty_map(heading: float) -> None:
    grid = OccupancyGrid.from_array(np.zeros((80, 120), dtype=bool), 0.1, (-2.0, -4.0, 0.0))
    states, ends, _ = drive(grid, [0.0, 0.0, heading], [8.0, 0.5])
    assert ends[-1] is Status.REACHED
    assert len(ends) * PERIOD < 16  # 8 m at 1 m/s, and turning round
    v, w = states[1:, 3], states[1:, 4]
    assert v.max() <= 1.0 + 1e-9
    following = np.array([end is Status.FOLLOWING for end in ends[1 : len(v)]])
    assert np.abs(np.diff(v))[following].max() <= 0.1 + 1e-9
    assert np.abs(np.diff(w))[following].max() <= 0.3 + 1e-9


def test_it_goes_round_the_blocks() -> None:
    grid = blocks()
    states, ends, _ = drive(grid, [0.0, 0.0, 0.0], [8.0, 0.0])
    assert ends[-1] is Status.REACHED
    assert clearance(grid, states) > -0.03  # a cell's edge


def corridors() -> OccupancyGrid:
    """Two corridors from x = 2 to 6; the upper one (y = 1) is the shorter from y = 0.6."""
    occupied = np.zeros((60, 90), dtype=bool)
    occupied[[0, -1], :] = occupied[:, [0, -1]] = True
    occupied[25:35, 30:70] = True  # y −0.5 … 0.5
    occupied[:8, 30:70] = occupied[-8:, 30:70] = True  # beyond ±2.2
    return OccupancyGrid.from_array(occupied, 0.1, (-1.0, -3.0, 0.0))


CROWD = np.array([[4.0, 0.8], [4.0, 1.35], [4.0, 1.9]])  # across the upper corridor


@pytest.mark.parametrize(("where", "arrives"), [("local", False), ("global", True)])
def test_who_knows_of_the_crowd_decides_the_corridor(where: Any, arrives: bool) -> None:
    """With people in the local costmap alone the global plan leads to the blocked corridor, and
    the robot stalls there; in the global one they send it round."""
    settings = Settings(people_in=where)
    states, ends, _ = drive(
        corridors(), [0.0, 0.6, 0.0], [7.2, 0.6], lambda _: CROWD, settings, seconds=18.0
    )
    assert (ends[-1] is Status.REACHED) == arrives
    inside = (states[:, 0] > 2.5) & (states[:, 0] < 5.5)
    assert bool(np.any(states[inside, 1] < 0)) == arrives
    assert np.linalg.norm(states[:, None, :2] - CROWD, axis=-1).min() > 0.45


def test_local_knowledge_recovers_and_gives_up_before_a_blocked_corridor() -> None:
    settings = Settings(rounds=1, wait_time=1.0, progress_time=3.0, patience=1.0)
    _, ends, reasons = drive(
        corridors(), [1.5, 1.2, 0.0], [7.2, 0.6], lambda _: CROWD, settings, seconds=90.0
    )
    assert ends[-1] is Status.FAILED
    assert set(RECOVERIES) <= set(reasons)


def test_a_crowd_that_leaves_is_waited_for() -> None:
    _, ends, _ = drive(
        corridors(), [1.5, 1.2, 0.0], [7.2, 0.6], lambda t: CROWD if t < 8 else NOBODY, seconds=60.0
    )
    assert ends[-1] is Status.REACHED


def test_a_goal_behind_walls_is_said_and_then_given_up() -> None:
    occupied = np.zeros((40, 40), dtype=bool)
    occupied[:, 25] = True
    grid = OccupancyGrid.from_array(occupied, 0.1, (0.0, 0.0, 0.0))
    settings = Settings(rounds=1)
    states, ends, _ = drive(grid, [1.0, 2.0, 0.0], [3.5, 2.0], settings=settings)
    assert ends[0] is Status.NO_VALID_PATH
    assert ends[-1] is Status.FAILED
    assert states[:, 0].max() < 2.3


def test_a_new_goal_begins_anew() -> None:
    grid = blocks()
    stack = LayeredStack()
    stack.step(0.0, [0.0, 0.0, 0.0], [0.0, 0.0], NOBODY, grid, [8.0, 0.0])
    first = stack.path
    stack.step(0.1, [0.0, 0.0, 0.0], [0.0, 0.0], NOBODY, grid, [0.0, -3.0])
    assert first is not None
    assert stack.path is not None
    assert np.linalg.norm(stack.path[-1] - first[-1]) > 3


def test_it_plans_once_a_second() -> None:
    grid = blocks()
    stack = LayeredStack()
    paths = []
    for k in range(25):
        stack.step(PERIOD * k, [0.1 * k, 0.0, 0.0], [0.0, 0.0], NOBODY, grid, [8.0, -2.0])
        paths.append(id(stack.path))
    assert len(set(paths)) == 3
    assert LayeredStack().path is None
