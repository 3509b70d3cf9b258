"""Routes keep their names while the robot drives, and are joined to where it is."""

from __future__ import annotations

import numpy as np
import pytest

from fgplan import GivenPlan, OccupancyGrid, Robot, Scenario
from fgplan.driving.routing import Routes, Routing, densified, is_free, simplified

BLOCK = [(4.0, -1.5), (6.0, -1.5), (6.0, 1.5), (4.0, 1.5)]
GRID = OccupancyGrid.from_polygons([BLOCK], (-1, -4, 11, 4), 0.1, border=True)


def scenario(x=0.0, y=0.1, now=0.0, **changes):
    robot = Robot(np.array([x, y]))
    fields = {"goal": np.array([10.0, 0.0]), "grid": GRID, "now": now, "count": 2, **changes}
    return Scenario(robot, **fields)


def side(way):
    """Which side of the block a way passes."""
    at = np.argmin(np.abs(way.path[:, 0] - 5.0))
    return np.sign(way.path[at, 1])


def test_names_follow_the_route_and_not_the_rank():
    """Walking to the other side of the middle swaps which route is shorter, not its name."""
    routes = Routes().update(scenario(), Routing(), None)
    names = {way.label: side(way) for way in routes.ways}
    assert names == {"A": 1.0, "B": -1.0}
    for k, y in enumerate([0.0, -0.2, -0.5, -0.8]):
        routes = routes.update(scenario(0.5 * k, y, 1.5 * (k + 1)), Routing(), "A")
        assert {way.label: side(way) for way in routes.ways} == names
        assert routes.searched == 1.5 * (k + 1)
    lengths = {way.label: way.length for way in routes.ways}
    assert lengths["B"] < lengths["A"]


def test_between_searches_every_route_starts_where_the_robot_is_and_is_free():
    routes = Routes().update(scenario(), Routing(), None)
    for k in range(1, 9):
        here = scenario(0.1 * k, 0.1 + 0.05 * k, 0.1 * k)
        routes = routes.update(here, Routing(), None)
        assert routes.searched == 0.0
        for way in routes.ways:
            np.testing.assert_allclose(way.path[0], here.robot.position)
            np.testing.assert_allclose(way.path[-1], [10.0, 0.0])
            assert is_free(GRID, way.path, 0.25)


def test_a_new_goal_is_searched_at_once():
    routes = Routes().update(scenario(), Routing(), None)
    routes = routes.update(scenario(now=0.1, goal=np.array([9.0, 2.0])), Routing(), None)
    assert routes.searched == 0.1
    for way in routes.ways:
        np.testing.assert_allclose(way.path[-1], [9.0, 2.0])


def test_a_map_that_closes_a_route_takes_it_away():
    routes = Routes().update(scenario(), Routing(), None)
    wall = [(4.5, 1.0), (5.5, 1.0), (5.5, 4.0), (4.5, 4.0)]
    closed = OccupancyGrid.from_polygons([BLOCK, wall], (-1, -4, 11, 4), 0.1, border=True)
    routes = routes.update(scenario(now=0.1, grid=closed), Routing(), "A")
    assert [way.label for way in routes.ways] == ["B"]


def passages(*closed):
    """A map of three ways past two blocks, some of them closed."""
    blocks = [[(4.0, y), (6.0, y), (6.0, y + 2.4), (4.0, y + 2.4)] for y in (-3.0, 0.6)]
    at = {"top": (3.0, 5.0), "middle": (-0.6, 0.6), "bottom": (-5.0, -3.0)}
    blocks += [[(4.5, a), (5.5, a), (5.5, b), (4.5, b)] for a, b in (at[name] for name in closed)]
    return OccupancyGrid.from_polygons(blocks, (-1, -5, 11, 5), 0.1, border=True)


def test_the_name_of_a_lost_route_is_not_that_of_a_new_one():
    """Until it has been gone for a search, or as long as it is followed."""

    def labels(routes, now, grid, keep="A"):
        routes = routes.update(scenario(now=now, grid=grid), Routing(), keep)
        return routes, {way.label: float(np.abs(way.path).max(axis=0)[1]) for way in routes.ways}

    routes, ways = labels(Routes(), 0.0, passages())
    assert list(ways) == ["A", "B"]
    assert ways["A"] < 1 < ways["B"]
    routes, ways = labels(routes, 0.1, passages("middle"))
    assert set(ways) == {"B", "C"}
    closed = passages("middle", "bottom")
    assert set(labels(routes, 0.2, closed)[1]) == {"B"}
    routes, _ = labels(routes, 0.2, closed)
    assert set(labels(routes, 0.3, passages("middle"))[1]) == {"B", "C"}
    assert set(labels(routes, 0.3, passages("middle"), "B")[1]) == {"A", "B"}


def test_no_route_is_said_by_its_name():
    routes = Routes().update(scenario(goal=np.array([5.0, 0.0])), Routing(), None)
    assert routes.ways == ()
    assert routes.trouble is not None
    assert routes.trouble.code == "GOAL_OCCUPIED"


def test_a_path_may_lead_out_of_a_wall_and_not_into_one():
    out = np.array([[3.8, 0.0], [2.0, 0.0]])
    assert is_free(GRID, out, 0.25)
    assert not is_free(GRID, np.vstack([out, [3.78, 0.0]]), 0.25)


def test_a_given_plan_keeps_its_name_and_weight_and_is_not_driven_back():
    plan = GivenPlan("left", np.array([[0.0, 0.0], [2.0, 2.0], [8.0, 2.0]]), 0.25)
    robot = Robot(np.array([4.0, 1.8]))
    routes = Routes().update(Scenario(robot, plans=(plan,), count=0), Routing(), None)
    (way,) = routes.ways
    assert way.label == "left"
    assert way.log_weight == pytest.approx(np.log(0.25))
    assert np.all(np.diff(way.path[:, 0]) >= 0)


def test_densified_and_simplified_are_the_same_curve():
    path = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    dense = densified(path, 0.3)
    assert np.linalg.norm(np.diff(dense, axis=0), axis=1).max() <= 0.3 + 1e-12
    np.testing.assert_allclose(simplified(dense), path, atol=1e-9)
