"""The benchmark of missions in short form: how a run is judged, and one run of a small file."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.mission import headed_back, measured, summary
from benchmarks.mission.__main__ import main
from fgplan import Mission, Region, Robot, Scenario
from fgplan.driving import Outcome
from fgplan.simulation.episode import End, Episode
from fgplan.simulation.errand import State

REGIONS = (Region.disc("A", (2.0, 0.0), 0.5), Region.disc("B", (4.0, 0.0), 0.5))
ASKED = Scenario(Robot(np.zeros(2)), regions=REGIONS, mission=Mission("F A & F B"))

FILE = """
[robot]
position = [0.0, 0.0]
max_speed = 1.0

[[regions]]
name = "A"
centre = [1.0, 0.6]
radius = 0.4

[[regions]]
name = "B"
centre = [2.4, 0.0]
radius = 0.4

[mission]
formula = "F (A & F B)"

[world]
time_limit = 10.0

[[world.people]]
area = [3.0, 1.0, 4.0, 2.0]
waypoints = [[-3.0, 1.5]]
"""


def straight(labels, outcome=Outcome.GOAL_REACHED, mission=State.SATISFIED) -> Episode:
    """A run along x at 1 m a step."""
    steps = len(labels)
    robot = np.zeros((steps + 1, 4))
    robot[:, 0] = np.arange(steps + 1)
    return Episode(
        name="test", end=End.GOAL, times=np.arange(steps + 1.0), robot=robot,
        headings=np.zeros(steps + 1), people=np.zeros((steps + 1, 0, 2)), radii=np.array([0.3]),
        gaps=np.full(steps, np.inf), blocked=np.zeros(steps, dtype=bool),
        outcomes=(outcome,) * steps, labels=tuple(labels), seconds=np.full(steps, 0.01),
        goal=np.full(2, np.nan), reference=4.0, delays=np.zeros(0), discomfort=0.2,
        mission=mission,
    )  # fmt: skip


def test_heading_for_a_goal_that_was_met_is_seen():
    assert headed_back(ASKED, straight(["A A", "A A", "B A", "B A"])) == 0
    assert headed_back(ASKED, straight(["A A", "A A", "A B", "B A"])) == 1
    assert headed_back(ASKED, straight([None, "A A", "A", "A A"])) == 2


@pytest.mark.parametrize(
    ("outcome", "mission", "satisfied", "claims", "reported"),
    [
        (Outcome.GOAL_REACHED, State.SATISFIED, True, True, False),
        (Outcome.GOAL_REACHED, State.OPEN, False, True, False),  # a false claim is no report
        (Outcome.NO_VALID_PATH, State.FAILED, False, False, True),
        (Outcome.FOLLOWING, State.OPEN, False, False, False),
    ],
)
def test_a_failure_counts_as_reported_only_where_it_is(
    outcome, mission, satisfied, claims, reported
):
    row = measured(ASKED, straight(["A", "A"], outcome, mission))
    found = (row["satisfied"], row["claims"], row["reported"])
    assert found == (satisfied, claims, reported)


def test_summary_counts_what_is_neither_done_nor_reported():
    ended = [(Outcome.FOLLOWING, State.SATISFIED), (Outcome.FOLLOWING, State.OPEN)]
    rows = [{**measured(ASKED, replace(straight(["A"], *one))), "scenario": "s"} for one in ended]
    line = summary(rows)
    assert (line["runs"], line["satisfied"], line["neither"]) == (2, 1, 1)


def test_the_command_prints_strict_json(tmp_path, capsys, monkeypatch):
    (tmp_path / "small.toml").write_text(FILE)
    monkeypatch.setattr("benchmarks.mission.DATA", tmp_path)
    main(["--short", "--scenario", "small", "--json", "-"])
    (line,) = json.loads(capsys.readouterr().out, parse_constant=lambda name: 1 / 0)
    assert (line["runs"], line["satisfied"], line["headed_back"]) == (1, 1, 0)
