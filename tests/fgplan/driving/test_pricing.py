"""What people on a route cost: blockages that last, crowds that come the other way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgplan import OccupancyGrid, Robot, Scenario
from fgplan.crowd import Belief
from fgplan.driving.pricing import Blockage, Pricing, congestion, delay, update
from fgplan.driving.routing import Way

# An aisle 1.5 m wide along y = 0.
WALLS = [
    [(-1.0, 0.75), (20.0, 0.75), (20.0, 1.0), (-1.0, 1.0)],
    [(-1.0, -1.0), (20.0, -1.0), (20.0, -0.75), (-1.0, -0.75)],
]
AISLE = OccupancyGrid.from_polygons(WALLS, (-1, -2, 20, 2), 0.05)
WAY = Way("A", np.array([[0.0, 0.0], [18.0, 0.0]]))


def everywhere(points):
    return np.ones(len(points), dtype=bool)


def nowhere(points):
    return np.zeros(len(points), dtype=bool)


def scenario(now=0.0, grid=AISLE):
    return Scenario(Robot(np.zeros(2)), goal=np.array([18.0, 0.0]), grid=grid, now=now)


def belief(*people):
    mean = np.array(people, dtype=float).reshape(-1, 4)
    n = len(mean)
    names = tuple(f"p{i}" for i in range(n))
    return Belief(names, mean, np.tile(1e-4 * np.eye(4), (n, 1, 1)), np.full(n, 0.3), 0.03)


STANDING = belief([4.0, 0.0, 0.0, 0.0])


def looked(known, people, now, sees=everywhere, ways=(WAY,)):
    return update(known, scenario(now), people, ways, Pricing(), sees)


def test_who_stands_in_the_middle_of_an_aisle_blocks_it():
    (blockage,) = looked((), STANDING, 0.0)
    np.testing.assert_allclose(blockage.place, [4.0, 0.0], atol=0.1)


@pytest.mark.parametrize(
    "person",
    [[4.0, 0.45, 0, 0], [4.0, 0.0, 0.8, 0], [4.0, 2.0, 0, 0]],
    ids=["leaves room", "walks", "is elsewhere"],
)
def test_who_leaves_room_or_moves_does_not(person):
    assert looked((), belief(person), 0.0) == ()


def test_in_the_open_nobody_blocks_anything():
    empty = OccupancyGrid.from_polygons([], (-1, -4, 20, 4), 0.1)
    assert update((), scenario(0.0, empty), STANDING, (WAY,), Pricing(), everywhere) == ()


def test_a_blockage_is_expected_to_last_as_long_again():
    known = ()
    for now in np.arange(0.0, 10.1, 0.5):
        known = looked(known, STANDING, float(now))
    (blockage,) = known
    assert blockage.remaining(Pricing()) == pytest.approx(10.0)
    cost, at = delay(WAY, known, scenario(10.0), Pricing())
    assert at == pytest.approx(4.0, abs=0.15)
    assert cost == pytest.approx(10.0 - 4.0, abs=0.15)  # 4 s pass until the robot is there


def test_the_cost_of_waiting_and_then_going_round_is_bounded():
    """Leaving when the expected rest exceeds the detour wastes at most the detour's own time."""
    detour, known = 20.0, ()
    for now in np.arange(0.0, 100.0, 0.5):
        known = looked(known, STANDING, float(now))
        cost, _ = delay(WAY, known, scenario(float(now)), Pricing())
        if cost > detour:
            break
    assert now <= detour + 4.0 + 0.5


def test_out_of_sight_it_is_remembered_and_then_forgotten():
    known = looked((), STANDING, 0.0)
    (later,) = looked(known, belief(), 30.0, nowhere)
    assert (later.since, later.last, later.free) == (0.0, 0.0, False)
    assert looked(known, belief(), 61.0, nowhere) == ()


def test_a_free_place_in_sight_is_no_blockage_any_more():
    known = looked(looked((), STANDING, 0.0), belief(), 0.5)
    assert delay(WAY, known, scenario(0.5), Pricing()) == (0.0, np.inf)


def test_who_moves_for_a_moment_does_not_begin_to_stand_anew():
    known, stepping = (), belief([4.0, 0.0, 0.4, 0.0])
    for now in np.arange(0.0, 10.1, 0.5):
        known = looked(known, stepping if now in (4.0, 7.5, 8.0) else STANDING, float(now))
    (blockage,) = known
    assert blockage.remaining(Pricing()) == pytest.approx(10.0)


def test_what_was_free_for_as_long_as_it_was_blocked_is_forgotten():
    known = ()
    for now in (0.0, 1.0, 2.0, 3.0):
        known = looked(known, STANDING, now)
    assert looked(looked(known, belief(), 4.0), belief(), 6.5) == ()


def test_who_was_seen_once_does_not_stand():
    """Their velocity is not known yet, and its mean is 0."""
    new = replace(STANDING, covariance=np.tile(np.diag([1e-3, 1e-3, 1.0, 1.0]), (1, 1, 1)))
    assert looked((), new, 0.0) == ()


def test_a_crowd_beyond_the_horizon_costs_the_time_to_pass_each_of_them():
    """(d/w)² of the time where they just fit, wherever they are."""
    half = float(AISLE.distance_field.distance(np.array([[9.0, 0.0]]))[0])
    for n in (1, 2, 4):
        for x in (np.linspace(8.0, 12.0, n), np.full(n, 9.0)):
            people = belief(*([a, 0, -1.0, 0] for a in x))
            cost = congestion(WAY, scenario(), people, Pricing())
            assert cost == pytest.approx(3.5 * n * (0.55 / half) ** 2, rel=0.01)


def test_where_it_is_wider_a_crowd_costs_less():
    wide = OccupancyGrid.from_polygons([], (-1, -1.25, 20, 1.25), 0.05, border=True)
    people = belief([9.0, 0.0, -1.0, 0.0])
    narrow = congestion(WAY, scenario(), people, Pricing())
    assert 0 < congestion(WAY, scenario(grid=wide), people, Pricing()) < 0.5 * narrow


def test_a_way_along_a_wall_is_as_wide_as_the_passage():
    people = belief([9.0, 0.0, -1.0, 0.0])
    along_the_wall = Way("A", WAY.path + np.array([0.0, 0.45]))
    middle, side = (congestion(w, scenario(), people, Pricing()) for w in (WAY, along_the_wall))
    # Looked at every 0.1 m across: half the width, 0.675 m, is met to 0.05 m.
    assert side == pytest.approx(middle, rel=2 * 0.05 / 0.675)


def test_who_is_within_the_horizon_or_walks_along_costs_nothing():
    near = belief([3.0, 0.0, -1.0, 0.0])
    along = belief([9.0, 0.0, 1.0, 0.0], [10.0, 0.2, 1.2, 0.0])
    for people in (near, along, belief()):
        assert congestion(WAY, scenario(), people, Pricing()) == 0.0


def test_a_blockage_beside_the_route_costs_nothing():
    known = (Blockage(np.array([4.0, 3.0]), 0.0, 10.0),)
    assert delay(WAY, known, scenario(10.0), Pricing()) == (0.0, np.inf)
