"""The suite and the hour of driving, in their short forms."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.hour import problems
from benchmarks.hour.__main__ import main as hour
from benchmarks.suite import SUITE, Case, beats, lines, regrets, spoilt
from benchmarks.suite.__main__ import main as suite
from fgplan.driving import Observation
from fgplan.mixture import Action
from fgplan.robots import Twist
from fgplan.scenario import Robot
from fgplan.simulation.planners import PLANNERS
from fgplan.wheeled import DifferentialDrive


def test_the_short_suite_passes_a_doorway(capsys):
    suite(["--short", "--planner", "fgplan", "--planner", "straight", "--json", "-"])
    ours, straight = json.loads(capsys.readouterr().out)
    assert (ours["planner"], ours["success"], ours["episodes"]) == ("fgplan", 1.0, 2)
    assert straight["more_than_fgplan"] == straight["value"] - ours["value"]


def test_every_case_names_a_file_and_planners_that_there_are():
    for case in SUITE:
        case.setup.check()
        assert set(case.without) <= PLANNERS.keys()
        for corridor, path in case.corridors:
            told = case.told(corridor, path)(0).scenario
            assert [given.label for given in told.plans] == [corridor]


def test_the_oracle_takes_the_better_corridor_of_each_seed():
    case = Case("s1_corridors", "time", corridors=(("A", "[]"), ("B", "[]")))
    runs = {"fgplan": [30.0, 31.0], "told A": [25.0, None], "told B": [28.0, 27.0]}
    driven = {
        (case.name, name): [_row(t, seed) for seed, t in enumerate(times)]
        for name, times in runs.items()
    }
    found = {line["planner"]: line for line in lines(case, driven)}
    assert found["oracle"]["value"] == pytest.approx(26.0)
    assert found["oracle"]["more_than_fgplan"] == pytest.approx(-4.5)
    assert found["told A"]["value"] == pytest.approx((25.0 + 60.0) / 2)
    assert beats(found["oracle"], found["fgplan"])
    assert not beats(found["fgplan"], found["oracle"])


def test_runs_are_compared_with_those_of_their_own_seed():
    case = Case("s7_doorway_0.8", "time")
    driven = {
        (case.name, "fgplan"): [_row(10.0, 0), _row(12.0, 1), _row(14.0, 2)],
        (case.name, "straight"): [_row(15.0, 2), _row(13.0, 1)],
    }
    found = {line["planner"]: line for line in lines(case, driven)}
    assert found["straight"]["more_than_fgplan"] == pytest.approx(1.0)


def test_regret_is_what_is_lost_to_the_oracle_over_all_cases_of_a_file():
    first = Case("s5_aisle", "time", corridors=(("A", "[]"), ("B", "[]")))
    second = Case(
        "s5_aisle", "time", changes=(("world.time_limit", "40.0"),), corridors=first.corridors
    )
    driven = {
        (first.name, "fgplan"): [_row(20.0, 0), _row(21.0, 1)],
        (first.name, "told A"): [_row(18.0, 0), _row(19.0, 1)],
        (first.name, "told B"): [_row(30.0, 0), _row(17.0, 1)],
        (second.name, "fgplan"): [_row(36.0, 0), _row(None, 1)],
        (second.name, "told A"): [_row(None, 0), _row(None, 1)],
        (second.name, "told B"): [_row(30.0, 0), _row(31.0, 1)],
    }
    found = {row["planner"]: row for row in regrets((first, second), driven)}
    assert found["fgplan"]["value"] == pytest.approx((2 + 6 + 4 + 9) / 4)
    assert found["told B"]["value"] == pytest.approx((12 + 0 + 0 + 0) / 4)
    alone = {row["planner"]: row for row in regrets((first,), driven)}
    assert alone["fgplan"]["value"] == pytest.approx((2 + 4) / 2)
    assert alone["fgplan"]["scenario"] == "s5_aisle"


def test_a_spoilt_case_differs_in_what_is_seen():
    case = next(case for case in SUITE if case.file == "s10_discs")
    changed = spoilt(case, 0.05)
    assert changed.setup(0).tamper is not None
    assert changed.name != case.name


def test_the_short_hour_finds_nothing_wrong(capsys):
    hour(["--short", "--json", "-"])
    for row in json.loads(capsys.readouterr().out):
        assert (row["steps"], row["error"], row["broken"]) == (20, "", [])
        assert row["unsafe"] == 0


@pytest.mark.parametrize(
    ("velocity", "position", "twist", "says"),
    [
        ((0.9, 0.0), (0.085, 0.0), (0.9, 0.0), None),
        ((0.9, 0.0), (0.085, 0.0), (0.0, -0.9), None),  # the robot looks along y
        ((1.01, 0.0), (0.085, 0.0), (1.01, 0.0), "speed 1.01 m/s above 1.00 m/s"),
        ((0.65, 0.0), (0.085, 0.0), (0.65, 0.0), "acceleration 1.50 m/s² above 1.00 m/s²"),
        ((0.8, 0.2), (0.085, 0.0), (0.8, 0.2), "acceleration 2.00 m/s² above 1.00 m/s²"),
        ((0.9, 0.0), (0.085, 0.0), (0.5, 0.0), "twist of 0.500 m/s for a velocity of 0.900 m/s"),
        ((0.9, 0.0), (0.2, 0.0), (0.9, 0.0), "next position 0.2000 m away"),
        ((0.9, 0.0), (np.nan, 0.0), (0.9, 0.0), "not finite"),
        ((0.9, 0.0), (0.085, 0.0), (0.9, np.inf), "not finite"),
    ],
)
def test_the_hour_names_what_is_wrong_with_an_action(velocity, position, twist, says):
    robot = Robot(np.zeros(2), max_speed=1.0, max_acceleration=1.0)
    truth = Observation(0.0, np.zeros(2), np.array([0.8, 0.0]), heading=np.pi / 2)
    told = Twist(*twist, 0.0)
    action = Action("follow", 0.1, np.array(position), np.array(velocity), told, True, "")
    found = problems(robot, truth, truth, action, 0.1)
    assert found == [] if says is None else says in "; ".join(found)


def test_the_hour_asks_of_a_next_position_what_can_be_known_of_it():
    """Who was told late where the robot is has had longer to get there."""
    robot, ahead = Robot(np.zeros(2), max_speed=1.0), np.array([1.0, 0.0])
    truth, late = (Observation(t, np.array([t, 0.0]), ahead) for t in (0.1, 0.0))
    action = Action("follow", 0.1, np.array([0.1999, 0.0]), ahead, Twist(1.0, 0.0, 0.0), True, "")
    assert problems(robot, truth, late, action, 0.1) == []
    action = replace(action, position=np.array([0.21, 0.0]))
    assert len(problems(robot, truth, late, action, 0.1)) == 1


def test_the_hour_knows_how_fast_wheels_may_turn():
    robot = Robot(np.zeros(2), max_speed=1.0, max_acceleration=1.0, model=DifferentialDrive())
    truth = Observation(0.0, np.zeros(2), heading=0.0)
    still = np.zeros(2)
    most = robot.model.max_yaw_acceleration * 0.1
    for rate, broken in ((most, 0), (most + 0.1, 1)):
        action = Action("follow", 0.1, still, still, Twist(0.0, 0.0, rate), True, "")
        assert len(problems(robot, truth, truth, action, 0.1)) == broken


def _row(time, seed):
    return {
        "seed": seed, "time": time, "success": time is not None, "collisions": 0,
        "path_ratio": None, "stopped_fraction": 0.0, "switches": 0, "people_delay": None,
        "unsafe": 0, "step_ms_p50": 1.0,
    }  # fmt: skip
