"""A plan that is clear is driven on as long as a way goes on from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgplan import OccupancyGrid, Robot, Scenario
from fgplan.crowd import Belief
from fgplan.driving import Detection, Observation, Planner, Settings
from fgplan.driving.guard import Judge
from fgplan.driving.leading_on import leads_on
from fgplan.driving.way_out import WayOut
from fgplan.safety import People, check
from fgplan.trajectory import Trajectory

ABREAST = (-0.9, -0.3, 0.3, 0.9)


def corridor():
    """Along the x axis, 2.4 m wide."""
    walls = [[(-19, y), (29, y), (29, y + 0.3), (-19, y + 0.3)] for y in (-1.5, 1.2)]
    return OccupancyGrid.from_polygons(walls, bounds=(-19, -3, 29, 3), resolution=0.1)


def abreast(x, speed):
    """Four who fill the corridor."""
    mean = np.array([[x, y, -speed, 0.0] for y in ABREAST])
    covariance = np.tile(1e-4 * np.eye(4), (4, 1, 1))
    return Belief(tuple("abcd"), mean, covariance, np.full(4, 0.3), 0.03)


def onward(crowd="predicted", goal=None):
    """A robot in the corridor, and its plan: on at the speed of now."""
    robot = Robot(np.zeros(2), np.array([0.5, 0.0]), heading=0.0)
    scenario = Scenario(robot, goal, grid=corridor(), crowd=crowd)
    times = scenario.density.times
    velocities = np.tile(robot.velocity, (len(times), 1))
    return scenario, Trajectory(times, times[:, None] * robot.velocity, velocities)


def asked(scenario, plan, people, until=np.inf):
    judge = Judge(scenario, people, 0.1)
    return leads_on(WayOut(), judge, plan, 0.25, until)


def test_a_plan_that_is_clear_may_not_lead_on():
    """Who fill the corridor and are much faster reach the robot after the plan's end."""
    scenario, plan = onward()
    people = abreast(18.0, 3.0)
    times = scenario.density.times
    assert check(scenario, plan, People(times, people.expected(times), people.radii)).feasible
    assert not asked(scenario, plan, people)


@pytest.mark.parametrize("speed", [-1.0, 0.0, 0.5])
def test_from_whom_one_can_get_away_leads_on(speed):
    scenario, plan = onward()
    assert asked(scenario, plan, abreast(8.0, speed))


def test_people_who_are_planned_make_way():
    scenario, plan = onward("joint")
    assert asked(scenario, plan, abreast(18.0, 3.0))


def test_who_arrives_needs_no_way_on():
    _, plan = onward()
    scenario, _ = onward(goal=plan.positions[-1])
    assert asked(scenario, plan, abreast(18.0, 3.0))


def test_what_there_is_no_time_to_look_at_is_driven():
    scenario, plan = onward()
    assert asked(scenario, plan, abreast(18.0, 3.0), until=-np.inf)


def stepped(monkeypatch, leads):
    """What a planner does first, that of a plan past two who stand aside, which leads on or not."""
    monkeypatch.setattr("fgplan.driving.planner.leads_on", lambda *_: leads)
    seen = tuple(Detection(np.array([6.0, y]), f"p{y}", 0.3, np.zeros(2)) for y in (-0.8, 0.8))
    scenario, _ = onward(goal=np.array([15.0, 0.0]))
    planner = Planner(scenario, Settings(deadline=None))
    return planner.step(Observation(0.0, np.zeros(2), detections=seen))


def test_a_plan_that_does_not_lead_on_is_left_for_a_way(monkeypatch):
    """And what is done is clear of everybody."""
    assert stepped(monkeypatch, leads=True).action.kind == "follow"
    left = stepped(monkeypatch, leads=False)
    assert left.action.kind == "avoid"
    assert left.action.safe
    assert left.reason.endswith("it does not lead on: a way out")


def test_a_clear_plan_is_not_left_for_a_way_that_ends(monkeypatch):
    search = WayOut.search
    monkeypatch.setattr(
        WayOut, "search", lambda self, *asked: search(replace(self, horizon=6.0), *asked)
    )
    assert stepped(monkeypatch, leads=False).action.kind == "follow"
