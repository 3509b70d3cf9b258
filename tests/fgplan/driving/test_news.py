"""What is said once is not lost with an observation that cannot be used."""

from __future__ import annotations

import numpy as np
import pytest

from fgplan import Density, OccupancyGrid, Robot, Scenario
from fgplan.driving import Observation, Outcome, Planner, Settings
from fgplan.driving import planner as module
from fgplan.driving.news import MOST, TRIES, News
from fgplan.mission import Fact, Mission
from fgplan.regions import Region
from fgplan.shared_control import Joystick, Waypoint

GRID, OTHER = (OccupancyGrid.from_polygons([], (-2, -3, 10, 3), 0.1) for _ in range(2))
REGIONS = (Region.disc("A", (7.5, 0), 1.0), Region.box("wet", 3, -3, 5, -1))
NAN = np.array([np.nan, 0.0])


def window():
    return Waypoint(np.array([2.0, 1.5]), 0.1 * np.eye(2), name="window")


def stick(t):
    return Joystick(t, np.array([0.5, 0.1]), 0.04 * np.eye(2))


def planner():
    mission = Mission("F A", facts=(Fact("shut", closes="wet"), Fact("dark")))
    scenario = Scenario(
        Robot(np.zeros(2)),
        grid=GRID,
        regions=REGIONS,
        mission=mission,
        density=Density(dt=0.4, horizon=4.0),
        count=1,
    )
    made = Planner(scenario, Settings(deadline=None))
    made.step(Observation(0.0, np.zeros(2)))
    return made


def facts(decision):
    return {fact.name: fact.holds for fact in decision.mission.facts}


@pytest.mark.parametrize(
    ("time", "position"), [(0.2, np.array([5.0, 5.0])), (0.2, NAN), (-0.1, np.zeros(2))]
)
def test_what_is_said_where_nobody_believes_the_robot_is_used_next(time, position):
    driven = planner()
    said = {"facts": {"shut": True}, "grid": OTHER, "operator": (window(),)}
    refused = driven.step(Observation(time, position, **said))
    assert refused.outcome is Outcome.BAD_OBSERVATION
    assert not facts(refused)["shut"]
    decision = driven.step(Observation(0.4, np.zeros(2), facts={"dark": True}))
    assert facts(decision) == {"shut": True, "dark": True}
    assert driven.memory.scenario.grid is OTHER
    assert [m.name for m in driven.memory.operated.data] == ["window"]
    driven.step(Observation(0.6, np.zeros(2)))
    assert len(driven.memory.operated.data) == 1  # once


def test_what_is_said_in_a_step_that_breaks_is_used_next(monkeypatch):
    driven = planner()
    with monkeypatch.context() as patch:
        patch.setattr(module, "progressed", None)
        broken = driven.step(Observation(0.2, np.zeros(2), facts={"shut": True}))
    assert broken.outcome is Outcome.NO_VALID_CONTROL
    assert facts(driven.step(Observation(0.4, np.zeros(2))))["shut"]


class Poison(Waypoint):
    """Breaks what looks at it closely."""

    def pieces(self, now, times):
        raise RuntimeError("poison")


def test_what_breaks_every_step_is_left_out_by_name_after_a_few():
    driven = planner()
    poison = Poison(np.array([2.0, 1.5]), 0.1 * np.eye(2))
    decisions = [driven.step(Observation(0.2, np.zeros(2), operator=(poison,)))]
    decisions += [driven.step(Observation(0.2 * k, np.zeros(2))) for k in range(2, TRIES + 3)]
    ended = [d.outcome is Outcome.NO_VALID_CONTROL for d in decisions]
    assert ended == [True] * (TRIES + 1) + [False]
    assert "what was said before is left out" in decisions[TRIES].reason


def test_what_makes_no_sense_in_it_is_named_and_does_not_wait():
    driven = planner()
    said = {"goal": NAN, "facts": ["shut"], "grid": "hall", "operator": window()}
    refused = driven.step(Observation(0.2, NAN, **said))
    assert len(refused.repairs) == 1 + len(said)
    decision = driven.step(Observation(0.4, np.zeros(2)))
    assert (decision.outcome, decision.repairs) == (Outcome.FOLLOWING, ())


def at(time, **said):
    return Observation(time, np.zeros(2), **said)


def test_what_is_said_later_stands():
    first, second = np.array([1.0, 0.0]), np.array([2.0, 0.0])
    waits = News().keep(at(0.2, goal=first, facts={"a": True, "b": True}))
    waits = waits.keep(at(0.4, goal=second, facts={"b": False}))
    assert waits.told(at(0.6)).goal is second
    told = waits.told(at(0.6, goal=first, facts={"a": False}))
    assert told.goal is first
    assert told.facts == {"a": False, "b": False}
    used = waits.used(told)
    assert used.told(at(0.8)).goal is None
    late = used.keep(at(0.5, goal=second, facts={"c": True}), stamp=0.5)
    assert late.told(at(0.8)).goal is None
    assert late.told(at(0.8)).facts == {"c": True}
    assert late.on_new_clock().told(at(0.8)).goal is second


def test_an_observation_that_comes_twice_says_it_once():
    used = News().used(at(0.2, operator=(stick(0.2),)))
    twice = used.keep(at(0.2, operator=(stick(0.2), window())), stamp=0.2)
    twice = twice.keep(at(0.2, operator=(stick(0.2), window())), stamp=0.2)
    assert [type(m) for m in twice.told(at(0.4)).operator] == [Waypoint]


def test_of_a_stick_that_waits_for_long_the_newest_is_kept_and_a_place_is_not_lost():
    news = News().keep(at(0.0, operator=(window(), *map(stick, np.arange(MOST + 5.0)))))
    kept = news.told(at(MOST + 5.0)).operator
    assert len(kept) == MOST + 1
    assert isinstance(kept[0], Waypoint)
    assert kept[1].time == 5.0
