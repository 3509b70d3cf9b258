"""Simulation files, and the worlds they make."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fgplan.errors import ScenarioError
from fgplan.scenario import Scenario
from fgplan.shared_control import Joystick, Waypoint
from fgplan.simulation.body import Body
from fgplan.simulation.episode import run
from fgplan.simulation.file import FromFile
from fgplan.simulation.metrics import row
from fgplan.simulation.peers import Straight

DATA = Path(__file__).parents[3] / "data" / "simulations"
FILES = sorted(DATA.glob("*.toml"))

SMALL = """
[robot]
position = [0.0, 0.0]
max_speed = 1.0

[goal]
position = [4.0, 0.0]

[world]
motion = "heedless"
time_limit = 9.0

[[world.people]]
count = 2
area = [1.0, 1.0, 4.0, 3.0]
waypoints = [[0.0, 2.0]]
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


def test_the_suite_is_there() -> None:
    told = {path.stem.partition("_")[0] for path in FILES} - {"hour"}
    assert told == {
        "s1", "s2", "s3", "s4", "s5", "s6a", "s6b", "s6c", "s7", "s8", "s10", "s11"
    }  # fmt: skip


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_world_of_the_suite_makes_sense(path: Path) -> None:
    for seed in range(3):
        world = FromFile(path)(seed)
        scenario, people = world.scenario, world.people
        assert world.grid is not None
        assert world.reference is not None
        ends = np.array([scenario.robot.position, scenario.goal])
        assert world.grid.clearance(ends, scenario.robot.radius).min() > 0
        for i, place in enumerate(people.positions):
            assert world.grid.clearance(place, people.radii[i]) > 0
            gap = np.linalg.norm(place - scenario.robot.position) - people.radii[i]
            assert gap > scenario.robot.radius
            rest = np.linalg.norm(people.positions[:i] - place, axis=1)
            assert np.all(rest > people.radii[:i] + people.radii[i])


def test_a_world_is_that_of_its_seed(small: Path) -> None:
    setup = FromFile(small)
    one, again, other = (setup(seed).people.positions for seed in (1, 1, 2))
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)


def test_a_simulation_file_is_a_scenario_file(small: Path) -> None:
    assert np.array_equal(Scenario.load(small).goal, [4.0, 0.0])


def test_keys_can_be_changed(small: Path) -> None:
    changes = (("world.people[0].count", "5"), ("world.motion", "orca"), ("robot.radius", "0.2"))
    setup = FromFile(small, changes)
    world = setup(0)
    assert len(world.people.names) == 5
    assert world.scenario.robot.radius == 0.2
    assert setup.name == "small world.people[0].count=5 world.motion=orca robot.radius=0.2"


def test_every_mistake_is_named_at_once(small: Path) -> None:
    small.write_text(
        SMALL.replace("heedless", "flying")
        .replace("count = 2", "count = -1\nspeeed = 3")
        .replace("position = [4.0, 0.0]", 'position = "there"')
        .replace("time_limit = 9.0", "time_limit = 9.0\nfaults = 2\n")
    )
    with pytest.raises(ScenarioError) as caught:
        FromFile(small).check()
    text = str(caught.value)
    assert "world.people[0].speeed: got 3; is not a key; did you mean 'speed'?" in text
    assert "goal.position" in text
    small.write_text(small.read_text().replace("speeed = 3", ""))
    with pytest.raises(ScenarioError) as caught:
        FromFile(small).check()
    paths = {m.path for m in caught.value.mistakes}
    assert paths >= {"world.motion", "world.people[0].count", "world.faults", "goal.position"}


@pytest.mark.parametrize(
    ("change", "path"),
    [
        (("world.people[0].area", "[1, 1, 0, 0]"), "world.people[0].area"),
        (("world.people[0].ends", "gone"), "world.people[0].ends"),
        (("world.people[0].speed", "0"), "world.people[0].speed"),
        (("world.people[0].waypoints", "[]"), "world.people[0].waypoints"),
        (("world.people[7].count", "1"), "--set"),
        (("world.period", "0"), "world.period"),
        (("world.substeps", "0"), "world.substeps"),
        (("world.sensor.dropout", "1.5"), "world.sensor.dropout"),
        (("world.sensor.noise", "-1"), "world.sensor.noise"),
        (("world.start_spread", "-1"), "world.start_spread"),
    ],
)
def test_what_makes_no_sense_is_refused(small: Path, change: tuple[str, str], path: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        FromFile(small, (change,)).check()
    assert path in [m.path for m in caught.value.mistakes]


def test_a_full_area_is_refused(small: Path) -> None:
    with pytest.raises(ScenarioError, match=r"people\[0\].area: .*no room left"):
        FromFile(small, (("world.people[0].count", "60"),))(0)


def test_a_file_without_a_world_says_so(small: Path) -> None:
    small.write_text(SMALL.partition("[world]")[0])
    with pytest.raises(ScenarioError, match="world: got None; is missing"):
        FromFile(small).check()


def test_straight_drives_a_world(small: Path) -> None:
    world = FromFile(small)(0)
    numbers = row(run(world, Straight(world)))
    assert numbers["end"] == "goal"
    assert numbers["time"] == pytest.approx(4.4, abs=0.3)  # 3.7 m, and getting up to speed


def test_an_operator_holds_the_stick_and_names_places(small: Path) -> None:
    places = """
[[world.waypoints]]
name = "window"
position = [2.0, 1.0]
sigma = 0.3
said = 0.2
"""
    small.write_text(small.read_text().replace("[world]", "[world]\noperator = 'left'") + places)
    world = FromFile(small)(0)
    body = Body(world.scenario, world.limits)
    assert world.operator is not None
    said = [world.operator(0.1 * k, body, world.people) for k in range(25)]
    named = [(k, m) for k, items in enumerate(said) for m in items if isinstance(m, Waypoint)]
    assert [(k, m.name) for k, m in named] == [(2, "window")]
    sticks = [k for k, items in enumerate(said) if any(isinstance(m, Joystick) for m in items)]
    assert 10 <= sticks[0] <= 12
    assert FromFile(small, (("world.operator", "noisy"),))(0).operator is not None


def test_an_operator_that_nobody_knows_is_a_mistake(small: Path) -> None:
    changes = (
        ("world.operator", "lefty"),
        ("world.waypoints", "[{name='a', position=[1, inf], sigma=0}]"),
    )
    with pytest.raises(ScenarioError) as caught:
        FromFile(small, changes).check()
    text = str(caught.value)
    assert "world.operator" in text
    assert "left" in text
    assert "world.waypoints[0].position" in text
    assert "world.waypoints[0].sigma" in text
