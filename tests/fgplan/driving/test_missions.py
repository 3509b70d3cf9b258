"""Execution advances the mission: what is done is not done again, and new facts replan it."""

from __future__ import annotations

import numpy as np
import pytest

from fgplan import OccupancyGrid, Robot, Scenario
from fgplan.driving import Observation, Outcome, Planner, Settings
from fgplan.mission import Fact, Mission, satisfies
from fgplan.regions import Region, letter_at
from fgplan.shared_control import Joystick

PERIOD = 0.2

REGIONS = (
    Region.disc("A", (2.0, 0.0), 0.6),
    Region.disc("B", (8.5, 0.0), 0.7),
    Region.box("C", 4, -0.8, 6, 0.8),
    Region.disc("E", (5.0, 2.0), 0.5),
)


@pytest.fixture(scope="module")
def two_ways():
    """A lower way through C and an upper one by E, between two halls."""
    walls = [[(3, 0.9), (7, 0.9), (7, 1.3), (3, 1.3)], [(3, -3), (7, -3), (7, -0.9), (3, -0.9)]]
    return OccupancyGrid.from_polygons(walls, (0, -3, 10, 3), 0.1, border=True)


def driven(scenario, seconds=40.0, facts=()):
    """Decisions of a robot that does what it is told, until it comes to its end; `facts` are
    (step, facts)."""
    planner = Planner(scenario, Settings(period=PERIOD, deadline=None))
    x, v = scenario.robot.position, scenario.robot.velocity
    decisions, places, told = [], [x], dict(facts)
    for k in range(round(seconds / PERIOD)):
        decision = planner.step(Observation(PERIOD * k, x, v, facts=told.pop(k, {})))
        decisions.append(decision)
        if decision.outcome in (Outcome.GOAL_REACHED, Outcome.NO_VALID_PATH):
            break
        x, v = x + PERIOD / 2 * (v + decision.action.velocity), decision.action.velocity
        places.append(x)
    return decisions, np.array(places)


def test_a_mission_is_driven_to_its_end(two_ways):
    mission = Mission("F(A & F B) & G !C")
    robot = Robot(np.array([1.0, -2.0]))
    scenario = Scenario(robot, grid=two_ways, regions=REGIONS, mission=mission, count=2)
    decisions, places = driven(scenario)
    last = decisions[-1]
    assert (last.outcome, last.reason) == (Outcome.GOAL_REACHED, "mission done")
    assert satisfies(last.mission.trace, mission.formula)
    spoken = [r for r in REGIONS if r.name in mission.atoms]
    assert satisfies([letter_at(spoken, p) for p in places], mission.formula)


def test_a_goal_that_is_met_is_never_headed_for_again(two_ways):
    robot = Robot(np.array([1.0, -2.0]))
    mission = Mission("F A & F B")
    scenario = Scenario(robot, grid=two_ways, regions=REGIONS, mission=mission, count=2)
    decisions, _ = driven(scenario)
    assert decisions[-1].outcome == Outcome.GOAL_REACHED
    met = [any("A" in letter for letter in d.mission.trace) for d in decisions]
    stops = [d.label.split()[0] for d in decisions if d.label is not None]
    first = met.index(True)
    assert set(stops[:first]) == {"A"}
    assert set(stops[first:]) == {"B"}


def test_a_door_that_closes_replans_the_mission(two_ways):
    facts = (Fact("shut", closes="C"),)
    robot = Robot(np.array([1.0, 0.0]))
    scenario = Scenario(
        robot, grid=two_ways, regions=REGIONS, mission=Mission("F B & (F shut -> F E)", facts)
    )
    decisions, places = driven(scenario, facts=[(7, {"shut": True})])
    assert decisions[-1].outcome == Outcome.GOAL_REACHED
    read = decisions[-1].mission.trace
    assert satisfies(read, decisions[-1].mission.formula)
    assert any("E" in letter for letter in read)
    assert not REGIONS[2].contains(places).any()


def test_a_mission_that_can_no_longer_be_done_stops_and_says_so(two_ways):
    facts = (Fact("locked", closes="B"),)
    robot = Robot(np.array([1.0, 0.0]))
    scenario = Scenario(robot, grid=two_ways, regions=REGIONS, mission=Mission("F B", facts))
    decisions, _ = driven(scenario, facts=[(5, {"locked": True})])
    last = decisions[-1]
    assert last.outcome == Outcome.NO_VALID_PATH
    assert "B is closed" in last.reason
    assert not last.mission.done


def test_what_is_forbidden_and_entered_is_reported(two_ways):
    """Somebody puts the robot into C."""
    robot = Robot(np.array([5.0, 0.0]))
    mission = Mission("F B & G !C")
    scenario = Scenario(robot, grid=two_ways, regions=REGIONS, mission=mission)
    decisions, _ = driven(scenario, PERIOD)
    assert decisions[0].outcome == Outcome.NO_VALID_PATH
    assert "has failed" in decisions[0].reason
    assert decisions[0].mission.failed


def test_a_fact_that_nobody_knows_is_left_out(two_ways):
    robot = Robot(np.array([1.0, 0.0]))
    scenario = Scenario(robot, grid=two_ways, regions=REGIONS, mission=Mission("F B"))
    decision = Planner(scenario).step(Observation(0.0, robot.position, facts={"rain": True}))
    assert "fact 'rain' is none of the mission's: not used" in decision.repairs


def test_the_ways_to_a_stop_in_two_regions_at_once_are_told_apart():
    """Two ways round a block to where two regions overlap, and a stick for one of them."""
    grid = OccupancyGrid.from_polygons(
        [[(3, -1), (5, -1), (5, 1), (3, 1)]], (-1, -3, 10, 3), 0.1, border=True
    )
    regions = (Region.disc("A", (7.5, 0), 1.0), Region.disc("B", (8.2, 0), 1.0))
    scenario = Scenario(
        Robot(np.zeros(2)), grid=grid, regions=regions, mission=Mission("F(A & B)"), count=2
    )
    planner = Planner(scenario, Settings(period=PERIOD, deadline=None))
    stick = Joystick(PERIOD, np.array([0.7, -0.5]), 0.04 * np.eye(2))
    first = planner.step(Observation(0.0, np.zeros(2)))
    second = planner.step(Observation(PERIOD, np.zeros(2), operator=(stick,)))
    ways = {way.label for way in planner.memory.routes.ways}
    assert ways == {"A&B A", "A&B B"}
    assert first.label in ways
    assert set(second.intent.probability) >= ways
