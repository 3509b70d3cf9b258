"""Tactical data in a whole plan: it does what it says, at the level it is on."""

from __future__ import annotations

import numpy as np
import pytest

from fgplan import GivenPlan, Level, Robot, Scenario, ScenarioError, plan
from fgplan.regions import Region
from fgplan.tactical import Deadline, Formation, KeepIn, KeepOut, PassOn, SpeedZone, StayBehind
from tests.scenes import track

AHEAD = Region.disc("ahead", (2.5, 0.1), 0.5)
TWO = (Level("mission", sigma=0.5, h=0.5), Level("tactics", sigma=np.inf, h=0.2))
GOAL = np.array([6.0, 0.0])


def planned(*data, people=(), levels=TWO, **changes):
    robot = Robot(np.zeros(2), np.array([0.8, 0.0]))
    scenario = Scenario(robot, goal=GOAL, levels=levels, tracks=people, data=data, **changes)
    return plan(scenario).components[0]


@pytest.mark.parametrize("on", ["mission", "tactics", "robot"])
def test_keep_out_bends_the_plan_at_its_level(on):
    with_it = planned(KeepOut(AHEAD, on=on, sigma=0.02))
    name = on if on != "robot" else None
    bent = with_it.robot if name is None else with_it.levels[name]
    assert AHEAD.shape.distance(bent.positions[1:]).min() > 0.25
    assert AHEAD.shape.distance(planned().robot.positions).min() < 0


def test_keep_in_holds_for_a_while():
    lane = Region.box("lane", -1, 0.5, 8, 1.5)
    held = planned(KeepIn(lane, on="robot", sigma=0.02, begins=2.0, ends=3.0)).robot
    while_held = (held.times >= 2.0) & (held.times <= 3.0)
    assert lane.shape.distance(held.positions[while_held]).max() < 0.05
    assert lane.shape.distance(held.positions[-1]) > 0.1


def test_a_speed_zone_slows_the_robot_inside():
    zone = Region.box("zone", 1.5, -2, 3.0, 2)
    slowed = planned(SpeedZone(zone, 0.5, on="robot", sigma=0.02)).robot
    inside = zone.contains(slowed.positions)
    speed = np.linalg.norm(slowed.velocities, axis=1)
    assert inside.any()
    assert speed[inside].max() < 0.56
    assert speed.max() > 0.75


@pytest.mark.parametrize("time", [2.0, 2.5, 3.3])
def test_a_deadline_is_met(time):
    place = Region.disc("place", (1.5, 1.2), 0.2)
    there = planned(Deadline(place, time, on="robot", sigma=0.02)).robot.at(time)[:2]
    assert place.shape.distance(there) < 0.05


def test_a_deadline_beyond_the_horizon_asks_to_be_near_enough():
    place = Region.disc("place", (0.0, 6.0), 0.2)
    end = planned(Deadline(place, 8.0, on="robot", sigma=0.02, speed=1.0)).robot.positions[-1]
    assert place.shape.distance(end) == pytest.approx(8.0 - 4.8, abs=0.1)
    assert place.shape.distance(planned().robot.positions[-1]) > 5


def test_a_deadline_that_has_passed_says_nothing():
    place = Region.disc("place", (0.0, 6.0), 0.2)
    late = planned(Deadline(place, -1.0, on="robot"))
    np.testing.assert_array_equal(late.robot.states, planned().robot.states)


def test_a_region_opens_later():
    place = Region.disc("place", (1.2, 0.1), 0.5)
    window = Deadline(place, 4.0, opens=2.4, on="robot", sigma=0.02)
    robot = planned(window).robot
    inside = place.shape.distance(robot.positions) < -0.05
    assert not inside[robot.times < 2.4].any()
    assert place.shape.distance(robot.at(4.0)[:2]) < 0.05


@pytest.mark.parametrize(("side", "sign"), [("left", 1), ("right", -1)])
def test_somebody_is_passed_on_the_side_that_is_said(side, sign):
    anna = track("anna", 4.0, 0.0, -0.8)
    passed = planned(PassOn(side, person="anna", on="robot"), people=(anna,)).robot
    person = 4.0 - 0.8 * passed.times
    abeam = int(np.argmin(np.abs(passed.positions[:, 0] - person)))
    assert sign * passed.positions[abeam, 1] > 0.5


def test_who_stands_is_passed_on_the_side_that_is_said_where_a_direction_is():
    stands = track("anna", 2.5, 0.0, 0.0)
    side = PassOn("right", person="anna", direction=np.array([1.0, 0.0]), on="robot")
    robot = planned(side, people=(stands,), crowd="predicted").robot
    assert robot.positions[np.argmin(np.abs(robot.positions[:, 0] - 2.5)), 1] < -0.5
    nobodys = PassOn("right", person="anna", on="robot")  # against which direction?
    bare = planned(people=(stands,), crowd="predicted").robot
    free = planned(nobodys, people=(stands,), crowd="predicted").robot
    np.testing.assert_array_equal(free.states, bare.states)


def test_a_point_is_passed_on_the_side_that_is_said():
    side = PassOn("right", point=np.array([2.5, 0.0]), direction=np.array([1.0, 0]), on="tactics")
    robot = planned(side).robot
    assert robot.positions[np.argmin(np.abs(robot.positions[:, 0] - 2.5)), 1] < -0.1


def test_a_formation_keeps_its_place():
    leader = track("leader", 1.5, 1.0, 0.7)
    beside = Formation("leader", (-1.0, -0.5), on="robot", sigma=0.02)
    followed = planned(beside, people=(leader,), crowd="predicted")
    where = followed.crowd["leader"].positions[-1] + [-1.0, -0.5]
    np.testing.assert_allclose(followed.robot.positions[-1], where, atol=0.1)


def test_staying_behind_somebody():
    slow = track("slow", 1.5, 0.6, 0.3)
    behind = planned(StayBehind("slow", 0.5, on="robot", sigma=0.02), people=(slow,))
    ahead = behind.robot.positions[3:, 0] - behind.crowd["slow"].positions[3:, 0]
    assert ahead.max() < -0.4
    free = planned(people=(slow,))
    assert (free.robot.positions[:, 0] - free.crowd["slow"].positions[:, 0]).max() > 0


def test_who_is_not_there_is_not_followed():
    alone = planned(StayBehind("nobody", on="robot"), Formation("nobody"), PassOn("left"))
    np.testing.assert_array_equal(alone.robot.states, planned().robot.states)


def test_data_on_a_level_without_width_weighs_hypotheses():
    """The paper's δ cannot bend: what leads through the region loses its weight."""
    left = Region.box("left side", 1, 0.5, 5, 3)
    plans = tuple(
        GivenPlan(name, np.array([[0, 0], [3.0, y], [6, 0]])) for name, y in (("a", 1), ("b", -1))
    )
    robot = Robot(np.zeros(2), np.array([0.8, 0.0]))
    asked = Scenario(robot, plans=plans, count=0, data=(KeepOut(left, sigma=0.1),))
    found = {c.label: c.log_prior for c in plan(asked).components}
    assert found["b"] - found["a"] > 5


FILE = """
[robot]
position = [0.0, 0.0]
[goal]
position = [6.0, 0.0]
[[levels]]
name = "mission"
sigma = 0.5
[[levels]]
name = "tactics"
sigma = inf
[[regions]]
name = "ahead"
centre = [2.5, 0.1]
radius = 0.5
[[tactics]]
"""


def loaded(tmp_path, text):
    path = tmp_path / "s.toml"
    path.write_text(FILE + text, encoding="utf-8")
    return Scenario.load(path)


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ('kind = "keep_out"\nregion = "ahead"\non = "tactics"\nmargin = 0.2', KeepOut),
        ('kind = "keep_in"\nregion = "ahead"\nbegins = 1.0\nends = 2.0', KeepIn),
        ('kind = "speed_zone"\nregion = "ahead"\nlimit = 0.4\non = "robot"', SpeedZone),
        ('kind = "deadline"\nregion = "ahead"\ntime = 3.0\nopens = 1.0', Deadline),
        ('kind = "pass"\nside = "left"\npoint = [3.0, 0.0]\ndirection = [1.0, 0.0]', PassOn),
        ('kind = "formation"\nleader = "anna"\noffset = [-1.0, 0.0]', Formation),
        ('kind = "stay_behind"\nperson = "anna"\ngap = 0.5', StayBehind),
    ],
)
def test_tactics_are_read_from_a_file(tmp_path, text, kind):
    (only,) = loaded(tmp_path, text).data
    assert type(only) is kind


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('kind = "keep_of"', "tactics[0].kind: got 'keep_of'; give one of 'keep_out'"),
        ('kind = "keep_out"', "tactics[0].region: got None; is missing"),
        (
            'kind = "keep_out"\nregion = "a"',
            "tactics[0].region: got 'a'; is no region; the regions",
        ),
        (
            'kind = "keep_out"\nregion = "ahead"\ngap = 1.0',
            "tactics[0].gap: got 1.0; is no property",
        ),
        (
            'kind = "keep_out"\nregion = "ahead"\non = "x"',
            "is not measured; give 'robot' or a level",
        ),
        ('kind = "keep_in"\nregion = "ahead"\nsigma = 0.0', "sigma must be positive"),
        ('kind = "pass"\nside = "up"\npoint = [1, 1]\ndirection = [1, 0]', "side must be 'left'"),
    ],
)
def test_what_makes_no_sense_is_named(tmp_path, text, says):
    with pytest.raises(ScenarioError) as caught:
        loaded(tmp_path, text)
    assert says in str(caught.value)
