"""The layered stack in closed loop: a robot that does what it is told, at 10 Hz."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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
        paths.append(stack.path)  # kept: of what is gone, another one could have the id
    assert len({id(path) for path in paths}) == 3
    assert LayeredStack().path is None


def random_map(seed: int) -> tuple[OccupancyGrid, np.random.Generator]:
    """A walled hall of 12 m by 8 m with up to seven blocks."""
    rng = np.random.default_rng(seed)
    occupied = np.zeros((80, 120), dtype=bool)
    occupied[[0, -1], :] = occupied[:, [0, -1]] = True
    for _ in range(int(rng.integers(0, 8))):
        row, col = rng.integers(5, 70), rng.integers(15, 100)
        occupied[row : row + rng.integers(3, 15), col : col + rng.integers(3, 12)] = True
    return OccupancyGrid.from_array(occupied, 0.1, (-2.0, -4.0, 0.0)), rng


def free_point(grid: OccupancyGrid, rng: np.random.Generator, left: float, right: float) -> Any:
    """Somewhere at 0.4 m from every obstacle, or more."""
    while True:
        point = rng.uniform([left, -3.5], [right, 3.5])
        if grid.clearance(point[None], 0.4)[0] > 0:
            return point


@pytest.mark.parametrize("where", ["local", "global"])
def test_it_drives_round_obstacles_and_people_on_random_maps(where: Any) -> None:
    for seed in range(6):
        grid, rng = random_map(seed)
        start, goal = free_point(grid, rng, -1.5, 0), free_point(grid, rng, 8, 9.5)
        first, speed = rng.uniform([1, -3], [8, 3], (4, 2)), rng.normal(0, 0.3, (4, 2))
        states, ends, _ = drive(
            grid, [*start, rng.uniform(-3, 3)], goal,
            lambda t, first=first, speed=speed: first + speed * min(t, 20.0),  # type: ignore[misc]
            Settings(people_in=where), seconds=60.0,
        )  # fmt: skip
        assert ends[-1] is Status.REACHED, seed
        assert clearance(grid, states) > 0


def test_who_looks_at_a_wall_turns_away_from_it() -> None:
    """With `min_speed = 0` it stands there, and every recovery ends where it began."""
    occupied = np.zeros((80, 120), dtype=bool)
    occupied[48:58, 20:30] = True
    grid = OccupancyGrid.from_array(occupied, 0.1, (-2.0, -4.0, 0.0))
    _, ends, reasons = drive(grid, [-0.37, 1.3, 0.6], [9.0, 1.3])
    assert ends[-1] is Status.REACHED
    assert set(reasons) == {""}


@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_it_never_fails_whatever_it_is_given(seed: int) -> None:
    """In walls, outside of the map, at any speed, people on top of it: a finite command within the
    window, or a stop."""
    grid, rng = random_map(seed % 20)
    stack, goal = LayeredStack(), rng.uniform([-4, -6], [12, 6])
    for k in range(4):
        people = rng.uniform([-4, -6], [12, 6], (int(rng.integers(0, 6)), 2))
        pose = rng.uniform([-4, -6, -10], [12, 6, 10])
        twist = stack.step(0.7 * k, pose, rng.uniform(-2, 2, 2), people, grid, goal).twist
        assert np.isfinite([twist.linear_x, twist.angular_z]).all()
        assert twist.linear_y == 0
