"""What a mission requires of every place now, as tactical data and as obstacles."""

from __future__ import annotations

import numpy as np
import pytest

from fgplan import Level, OccupancyGrid, Robot, Scenario, plan
from fgplan.measuring import ROBOT
from fgplan.mission import Mission, rules
from fgplan.obeying import closed, obeying, tau
from fgplan.regions import Region
from fgplan.tactical import KeepIn, KeepOut

REGIONS = (
    Region.disc("A", (2.0, 2.0), 0.5),
    Region.disc("B", (8.0, 0.0), 0.7),
    Region.box("C", 3.5, -0.6, 5.5, 0.6),
    Region.box("lane", -1, -3, 9.5, 3),
)
HALL = OccupancyGrid.from_polygons([], (-1, -3, 10, 3), 0.1, border=True)
TWO = (Level("mission", sigma=0.5, h=0.5), Level("tactics", sigma=np.inf, h=0.2))


def scenario(text, read=(), levels=TWO, grid=HALL):
    mission = Mission(text)
    for inside in read:
        mission = mission.advance(inside)
    robot = Robot(np.zeros(2), np.array([0.8, 0.0]))
    return Scenario(robot, grid=grid, regions=REGIONS, mission=mission, count=1, levels=levels)


@pytest.mark.parametrize(
    ("text", "read", "forbidden", "held"),
    [
        ("F B & G !C", (), ("C",), ()),
        ("F A & F B", (), (), ()),
        ("!B U A", (), ("B",), ()),
        ("(!B U A) & F B", (("A",), ()), (), ()),
        ("F B & G lane", (("lane",),), (), ("lane",)),
        ("F A & (F A -> G !C) & F B", (), ("C",), ()),
        ("G(A -> G !C)", (), (), ()),
        ("G(A -> G !C) & F B", (("A",), ()), ("C",), ()),
    ],
)
def test_rules_are_read_off_the_automaton(text, read, forbidden, held):
    s = scenario(text, read)
    found = rules(s.mission, HALL, REGIONS, np.zeros(2), 0.25)
    assert (found.forbidden, found.held) == (forbidden, held)


def test_rules_become_data_of_the_level_below_the_mission():
    out, into = tau(scenario("F B & G !C & G lane", [("lane",)]))
    assert (type(out), out.region.name, out.on) == (KeepOut, "C", "tactics")
    assert (type(into), into.region.name, into.on) == (KeepIn, "lane", "tactics")


def test_without_such_a_level_they_are_obstacles_or_data_of_the_robot():
    alone = (Level(),)
    assert tau(scenario("F B & G !C", levels=alone)) == ()
    (only,) = tau(scenario("F B & G !C", levels=alone, grid=None))
    assert (type(only), only.on) == (KeepOut, ROBOT)


def test_forbidden_regions_are_obstacles_until_they_are_no_more():
    inside = np.array([4.5, 0.0])
    before, after = scenario("!C U A"), scenario("!C U A", [("A",), ()])
    assert closed(before).grid.is_occupied(inside)
    assert closed(after).grid is HALL
    assert obeying(after) is after
    assert closed(before).grid is closed(before).grid  # measured once


@pytest.mark.parametrize("grid", [HALL, None])
@pytest.mark.parametrize("levels", [TWO, (Level(),)])
def test_a_plan_keeps_out_of_what_is_forbidden(levels, grid):
    asked = scenario("F B & G !C", levels=levels, grid=grid)
    best = plan(asked).best
    c = REGIONS[2]
    assert not c.contains(best.robot.at(np.linspace(0, 4.8, 100))[:, :2]).any()
    assert best.check.feasible
    if "tactics" in best.levels:
        assert c.shape.distance(best.levels["tactics"].positions).min() > 0.2


def test_who_asks_nothing_is_obeyed_as_it_is():
    plain = scenario("F B").replace(mission=None)
    assert obeying(plain) is plain
