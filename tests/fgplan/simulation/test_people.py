"""People: those who react, those who do not, and where they go."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fgplan.occupancy import OccupancyGrid
from fgplan.simulation.extra import MissingExtra, needed
from fgplan.simulation.human_like import HumanLike
from fgplan.simulation.orca import Orca
from fgplan.simulation.people import Disc, heedless
from fgplan.simulation.walkers import Walker, Walkers
from fgplan.simulation.walls import rectangles

REACT = [Orca(), HumanLike()]


def crowd(walkers: list[Walker], settings: Any, walls: Any = ()) -> Walkers:
    radii = np.array([w.radius for w in walkers])
    return Walkers(walkers, settings.motion(radii, np.full(len(radii), 1.5), walls))


def head_on() -> list[Walker]:
    ends = np.array([[0.0, 0.0], [8.0, 0.05]])
    return [Walker(ends[0], ends[1:]), Walker(ends[1], ends[:1])]


@pytest.mark.parametrize("settings", REACT)
def test_people_who_meet_pass_each_other(settings: Any) -> None:
    people, apart = crowd(head_on(), settings), np.inf
    for _ in range(240):
        people.advance(0.05, None)
        apart = min(apart, float(np.linalg.norm(np.subtract(*people.positions))))
    assert apart > 0.58
    assert np.linalg.norm(people.positions - [[8.0, 0.05], [0.0, 0.0]], axis=1).max() < 0.4
    assert np.all(people.delays > 0)


def test_people_who_do_not_react_walk_through_each_other() -> None:
    people, apart = Walkers(head_on(), heedless), np.inf
    for _ in range(100):
        people.advance(0.05, None)
        apart = min(apart, float(np.linalg.norm(np.subtract(*people.positions))))
    assert apart < 0.1
    assert np.allclose(people.delays, 0)


@pytest.mark.parametrize("settings", REACT)
def test_people_avoid_a_robot_that_they_see_and_no_other(settings: Any) -> None:
    nearest = {}
    for sees in (True, False):
        robot = Disc(np.array([4.0, 0.05]), np.zeros(2), 0.25, sees)
        people = crowd([Walker(np.zeros(2), np.array([[8.0, 0.0]]))], settings)
        gaps = []
        for _ in range(160):
            people.advance(0.05, robot)
            gaps.append(np.linalg.norm(people.positions[0] - robot.position))
        nearest[sees] = min(gaps)
    assert nearest[True] > 0.53
    assert nearest[False] < 0.1


@pytest.mark.parametrize("settings", REACT)
def test_people_do_not_walk_through_walls(settings: Any) -> None:
    box = [(-1.0, 0.5), (6.0, 0.5), (6.0, 0.8), (-1.0, 0.8)]
    grid = OccupancyGrid.from_polygons([box], (-2, -2, 8, 3), 0.1)
    people = crowd([Walker(np.zeros(2), np.array([[5.0, 2.0]]))], settings, rectangles(grid))
    for _ in range(120):
        people.advance(0.05, None)
        assert grid.clearance(people.positions[0], 0.3) > -0.05


def test_who_leaves_comes_in_anew_as_somebody_else() -> None:
    walker = Walker(np.zeros(2), np.array([[2.0, 0.0]]), speed=1.0, ends="anew")
    people = Walkers([walker], heedless)
    names, seen = set(), []
    for _ in range(70):
        before = people.positions[0, 0]
        people.advance(0.1, None)
        # Gone for a while: nobody sees a person jump from the last waypoint to the entry.
        assert not seen or not (seen[-1] and people.present[0]) or people.positions[0, 0] >= before
        names.add(people.names[0])
        seen.append(bool(people.present[0]))
    assert names == {"p0", "p0.1", "p0.2", "p0.3"}
    # Nobody comes in where the robot is, whether they see it or not.
    for sees in (True, False):
        for _ in range(40):
            people.advance(0.1, Disc(np.array([0.5, 0.0]), np.zeros(2), 0.25, sees))
        assert not people.present[0]


def test_who_walks_back_and_forth_does() -> None:
    ends = np.array([[1.0, 0.0], [-1.0, 0.0]])
    people = Walkers([Walker(ends[0] * 0, ends, speed=1.0, ends="back")], heedless)
    x = []
    for _ in range(100):
        people.advance(0.1, None)
        x.append(people.positions[0, 0])
    assert max(x) == pytest.approx(0.8, abs=0.11)
    assert min(x) == pytest.approx(-0.8, abs=0.11)
    assert np.sum(np.diff(np.sign(np.diff(x))) != 0) >= 4


def test_who_waits_begins_when_it_is_time() -> None:
    people = Walkers([Walker(np.zeros(2), np.array([[9.0, 0.0]]), begins=1.0)], heedless)
    for _ in range(10):
        people.advance(0.1, None)
    assert np.allclose(people.positions, 0)
    for _ in range(10):
        people.advance(0.1, None)
    assert np.allclose(people.positions, [[1.2, 0.0]])
    assert np.allclose(people.delays, 0)


def test_who_waits_gives_no_way_before_it_is_time() -> None:
    """One who blocks an aisle does so whoever comes: ORCA alone would step aside."""
    walker = Walker(np.zeros(2), np.array([[9.0, 0.0]]), begins=1.0)
    people = crowd([walker], Orca())
    pushing = Disc(np.array([0.6, 0.05]), np.array([-1.0, 0.0]), 0.25)
    for _ in range(10):
        people.advance(0.1, pushing)
    assert np.array_equal(people.positions, np.zeros((1, 2)))
    people.advance(0.1, pushing)
    assert not np.array_equal(people.positions, np.zeros((1, 2)))


@settings(deadline=None)
@given(arrays(bool, st.tuples(st.integers(1, 7), st.integers(1, 7))), st.floats(-3, 3))
def test_rectangles_are_the_occupied_cells(occupied: Any, yaw: float) -> None:
    grid = OccupancyGrid.from_array(occupied, 0.5, (1.0, -2.0, yaw))
    found = rectangles(grid)
    area = sum(abs(_signed_area(four)) for four in found)
    assert area == pytest.approx(0.25 * occupied.sum())
    assert all(_signed_area(four) > 0 for four in found)  # counter-clockwise
    for cell in np.argwhere(occupied):
        centre = grid.cell_to_world(cell)
        assert sum(_inside(four, centre) for four in found) == 1


def test_a_missing_package_says_how_to_get_it() -> None:
    with pytest.raises(MissingExtra, match=r"pip install -e '.\[sim\]'"):
        needed("no_such_package_of_ours")


def _signed_area(four: Any) -> float:
    x, y = four.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _inside(four: Any, point: Any) -> bool:
    edges, offset = np.roll(four, -1, axis=0) - four, point - four
    return bool(np.all(edges[:, 0] * offset[:, 1] - edges[:, 1] * offset[:, 0] > 0))
