"""Missions in closed loop: the run judges by where the robot was, not by what it reports."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fgplan.driving import Observation
from fgplan.errors import ScenarioError
from fgplan.mission import Fact, Mission
from fgplan.regions import Region
from fgplan.scenario import Robot, Scenario
from fgplan.simulation.driver import Fgplan
from fgplan.simulation.episode import End, run
from fgplan.simulation.errand import State
from fgplan.simulation.file import FromFile
from fgplan.simulation.metrics import row
from fgplan.simulation.peers import Straight
from fgplan.simulation.policy import Command
from fgplan.simulation.world import Event, Rules, World
from tests.fgplan.simulation.worlds import passer, world

REGIONS = (
    Region.disc("A", (2.0, 1.5), 0.5),
    Region.disc("B", (4.0, 0.0), 0.5),
    Region.disc("C", (2.0, 0.0), 0.5),
)


def errand(
    formula: str, goal: object = None, facts: tuple[Fact, ...] = (), **changes: object
) -> World:
    robot = Robot(np.zeros(2), radius=0.3, max_speed=1.0)
    mission = Mission(formula, facts)
    scenario = Scenario(robot, goal=goal, regions=REGIONS, mission=mission, count=2)  # type: ignore[arg-type]
    return world(**{"scenario": scenario, "rules": Rules(time_limit=15.0), **changes})


class Along:
    """Drives with constant velocity, whatever is asked."""

    def __init__(self, vx: float) -> None:
        self.velocity = np.array([vx, 0.0])

    def step(self, observation: Observation) -> Command:
        return Command(self.velocity)


def test_a_mission_is_driven_among_people_to_its_end() -> None:
    made = errand("F (A & F B) & G !C", people=world([passer(4.0, -4.0, 0.0, 1.0)]).people)
    episode = run(made, Fgplan()(made))
    assert (episode.end, episode.mission) == (End.GOAL, State.SATISFIED)
    assert [sorted(letter) for letter in episode.word] == [[], ["A"], [], ["B"]]
    numbers = row(episode)
    assert numbers["success"]
    assert 0.7 < numbers["path_ratio"] < 1.1  # the shortest way leads to the middle of the regions
    assert numbers["stopped_fraction"] < 0.2


def test_the_goal_does_not_count_before_the_mission() -> None:
    made = errand("F A", goal=np.array([5.0, 0.0]), rules=Rules(time_limit=6.0))
    episode = run(made, Straight(made))
    assert np.linalg.norm(episode.robot[-1, :2] - [5.0, 0.0]) < 0.3
    assert (episode.end, episode.mission) == (End.TIMEOUT, State.OPEN)


def test_what_is_forbidden_is_seen_even_where_nobody_reports_it() -> None:
    made = errand("F B & G !C", rules=Rules(time_limit=6.0))
    episode = run(made, Along(1.0))
    assert (episode.end, episode.mission) == (End.TIMEOUT, State.FAILED)
    assert not row(episode)["success"]


def test_a_fact_that_becomes_true_is_part_of_the_word() -> None:
    facts = (Fact("shut"),)
    made = errand("F B & (F shut -> F A)", facts=facts, events=(Event(1.0, facts={"shut": True}),))
    episode = run(made, Fgplan()(made))
    assert episode.mission == State.SATISFIED
    assert any("shut" in letter for letter in episode.word)
    assert any("A" in letter for letter in episode.word)


def test_without_a_mission_nothing_is_said_of_one() -> None:
    made = world()
    episode = run(made, Straight(made))
    assert (episode.mission, episode.word) == (State.NONE, ())
    assert row(episode)["mission"] == ""


def test_a_run_without_goal_has_finite_numbers() -> None:
    made = errand("F C", rules=Rules(time_limit=4.0))
    numbers = row(run(made, Along(1.0)))
    assert numbers["success"]
    assert numbers["path_ratio"] == pytest.approx(0.75, abs=0.03)  # 1.5 of 2.0 m: to the rim


@pytest.mark.parametrize("name", ["delivery", "three_levels", "hospital"])
def test_scenario_files_with_levels_and_missions_are_simulated(name: str) -> None:
    path = Path(__file__).parents[3] / "data" / "scenarios" / f"{name}.toml"
    made = FromFile(path, (("world.time_limit", "1.0"),))(0)
    assert made.reference is not None
    episode = run(made, Fgplan()(made))
    assert (episode.end, episode.error) == (End.TIMEOUT, "")
    assert np.linalg.norm(episode.robot[-1, :2] - episode.robot[0, :2]) > 0.1
    assert episode.unsafe == 0


def test_a_door_that_shuts_in_a_file_replans_the_round(tmp_path: Path) -> None:
    file = tmp_path / "door.toml"
    file.write_text(DOOR)
    made = FromFile(file)(0)
    episode = run(made, Fgplan()(made))
    assert (episode.end, episode.mission) == (End.GOAL, State.SATISFIED)
    assert any({"shut"} == letter for letter in episode.word)
    assert any("stairs" in letter for letter in episode.word)


@pytest.mark.parametrize(
    ("event", "says"),
    [
        ("time = 1.0", "world.events[0]: got 1.0; says nothing; give a goal, or facts"),
        ("time = 1.0\nfacts = {open = true}", "is no fact of the mission; it has shut"),
    ],
)
def test_events_that_make_no_sense_are_named(tmp_path: Path, event: str, says: str) -> None:
    file = tmp_path / "door.toml"
    file.write_text(DOOR.replace("time = 0.5\nfacts = {shut = true}", event))
    with pytest.raises(ScenarioError) as caught:
        FromFile(file).check()
    assert says in str(caught.value)


DOOR = """
[map]
polygons = [[[2.5, -0.6], [3.5, -0.6], [3.5, 0.6], [2.5, 0.6]]]
bounds = [0, -2, 6, 2]
resolution = 0.1

[robot]
position = [0.6, 0.0]
max_speed = 1.0

[[regions]]
name = "passage"
polygon = [[2.6, 0.6], [3.4, 0.6], [3.4, 2.0], [2.6, 2.0]]

[[regions]]
name = "stairs"
polygon = [[2.6, -2.0], [3.4, -2.0], [3.4, -0.6], [2.6, -0.6]]

[[regions]]
name = "ward"
centre = [5.2, 0.5]
radius = 0.4

[mission]
formula = "F ward & (F shut -> F stairs)"

[[mission.facts]]
name = "shut"
closes = "passage"

[plans]
count = 2

[world]
time_limit = 15.0

[[world.events]]
time = 0.5
facts = {shut = true}
"""
