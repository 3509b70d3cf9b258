"""Where the optimiser starts from."""

from __future__ import annotations

import numpy as np
import pytest

from fgplan import Density, GivenPlan, OccupancyGrid, Robot, Scenario, Track
from fgplan.hypotheses import hypothesise
from fgplan.hypothesis import Start
from fgplan.starts import ARCS, CROWDED, MOST_CONFLICTS, coast
from fgplan.timing import timed
from tests.scenes import believed, forked, random_scene, track

STRAIGHT = (GivenPlan("straight", np.array([[0.0, 0.0], [8.0, 0.0]])),)


def tried(scenario: Scenario) -> dict[str, Start]:
    """The starts of the first hypothesis, by label."""
    first = hypothesise(scenario, believed(scenario))[0].starts
    assert len({start.label for start in first}) == len(first)
    return {start.label: start for start in first}


def ahead(*people: Track, **changes: object) -> Scenario:
    return forked(*people, **{"plans": STRAIGHT, **changes})


def test_alone_the_plan_comes_first_and_then_waiting():
    assert list(tried(ahead())) == ["plan", "wait"]


def test_the_plan_is_the_timed_path():
    scenario = ahead()
    robot = scenario.robot
    expected = timed(
        STRAIGHT[0].path, scenario.density.times, robot.preferred_speed, robot.max_acceleration,
        robot.velocity,
    )  # fmt: skip
    np.testing.assert_array_equal(tried(scenario)["plan"].robot.states, expected.states)


def test_waiting_stays_on_the_path_and_far_behind_the_plan():
    starts = tried(ahead())
    wait, plan = starts["wait"].robot, starts["plan"].robot
    np.testing.assert_allclose(wait.positions[:, 1], 0.0, atol=1e-12)
    assert 0 < wait.positions[-1, 0] < 0.4 * plan.positions[-1, 0]


@pytest.mark.parametrize("seed", range(6))
def test_every_start_begins_where_the_robot_is(seed):
    scenario = random_scene(seed, 6, True)
    for hypothesis in hypothesise(scenario, believed(scenario)):
        for start in hypothesis.starts:
            assert start.robot.states.shape == (scenario.density.steps + 1, 4)
            np.testing.assert_array_equal(start.robot.times, scenario.density.times)
            np.testing.assert_allclose(start.robot.positions[0], scenario.robot.position)


@pytest.mark.parametrize("direction", [0.0, 0.7, 2.5, -1.9])
def test_sides_are_named_as_the_robot_sees_them(direction):
    c, s = np.cos(direction), np.sin(direction)
    R = np.array([[c, -s], [s, c]])
    path = (GivenPlan("straight", STRAIGHT[0].path @ R.T),)
    person = track("a", *(R @ [3.0, 0.1]))
    robot = Robot(np.zeros(2), R @ [0.8, 0.0])
    starts = tried(Scenario(robot, tracks=(person,), plans=path, count=0))
    assert list(starts) == ["plan", "wait", "left of a", "right of a"]
    for label, sign in (("left of a", 1), ("right of a", -1)):
        local = starts[label].robot.positions @ R
        beside = local[np.argmin(np.abs(local[:, 0] - 3.0))]
        assert sign * (beside[1] - 0.1) > 0.5  # robot and person: 0.55 m
        assert sign * local[1:, 1].min() >= 0 if sign > 0 else local[1:, 1].max() <= 0.0


def test_a_person_who_walks_is_passed_where_they_will_be():
    starts = tried(ahead(track("a", 6.0, 0.0, -1.0, 0.0)))
    # Robot and person meet at about 3.2 m, after about 3 s; from there the shift fades again.
    offset = np.abs(starts["left of a"].robot.positions[:, 1])
    when = starts["plan"].robot.times[int(np.argmax(offset))]
    assert 2.4 <= when <= 3.6


def test_a_velocity_is_the_slope_of_its_start():
    for start in tried(ahead(track("a", 3.0, 0.1), density=Density(dt=0.1))).values():
        robot = start.robot
        slope = np.gradient(robot.positions, robot.times, axis=0)[2:-2]
        np.testing.assert_allclose(robot.velocities[2:-2], slope, atol=0.1)


def test_a_mirrored_scene_has_mirrored_starts():
    mirror = np.array([1.0, -1.0])
    people = [("a", 3.0, 0.2, -0.3, 0.1), ("b", 4.0, -0.4, 0.0, 0.2)]
    one = tried(ahead(*(track(*p) for p in people)))
    other = tried(ahead(*(track(n, x, -y, vx, -vy) for n, x, y, vx, vy in people)))
    assert {"left of a", "right of a", "left of b", "right of b"} <= set(one)
    swap = {"left": "right", "right": "left"}
    for label, start in one.items():
        side, _, rest = label.partition(" ")
        twin = other[f"{swap.get(side, side)} {rest}".strip()]
        np.testing.assert_allclose(twin.robot.positions, start.robot.positions * mirror, atol=1e-9)
        np.testing.assert_allclose(
            twin.robot.velocities, start.robot.velocities * mirror, atol=1e-9
        )


def test_nobody_in_the_way_has_no_sides():
    assert list(tried(ahead(track("a", 3.0, 2.5)))) == ["plan", "wait"]


def test_only_the_first_people_in_the_way_have_sides():
    people = [track(f"p{i}", 1.2 + 0.9 * i, 0.05) for i in (2, 0, 1)]
    sides = [label for label in tried(ahead(*people)) if " of " in label]
    assert sides == ["left of p0", "right of p0", "left of p1", "right of p1"]
    assert len(sides) == 2 * MOST_CONFLICTS


def test_wide_arcs_are_for_crowds():
    def arcs(count: int) -> list[str]:
        people = [track(f"p{i}", 1.0 + 0.7 * i, (-1) ** i * 1.2) for i in range(count)]
        return [label for label in tried(ahead(*people)) if label.startswith("arc")]

    assert arcs(CROWDED - 1) == []
    assert arcs(CROWDED) == [f"arc {offset:+.1f} m" for offset in ARCS]


def test_an_arc_is_as_wide_as_its_name_says_and_to_the_left_when_positive():
    people = [track(f"p{i}", 1.0 + 0.7 * i, 2.0) for i in range(CROWDED)]
    starts = tried(ahead(*people))
    for offset in ARCS:
        lateral = starts[f"arc {offset:+.1f} m"].robot.positions[:, 1]
        assert lateral[np.argmax(np.abs(lateral))] == pytest.approx(offset, rel=1e-6)


def test_starts_through_walls_are_dropped():
    # A wall along the left: what would pass the person there leads through it.
    wall = np.array([[-1.0, 0.45], [9.0, 0.45], [9.0, 0.55], [-1.0, 0.55]])
    grid = OccupancyGrid.from_polygons([wall], (-2, -5, 10, 5), 0.05)
    starts = tried(ahead(track("a", 3.0, 0.0), grid=grid))
    assert list(starts) == ["plan", "wait", "right of a"]
    assert "left of a" in tried(ahead(track("a", 3.0, 0.0)))


def test_the_plan_stays_even_where_it_leads_through_a_wall():
    """It is the user's, or the router's: where it leads is not for the starts to judge."""
    wall = np.array([[3.0, -4.0], [3.2, -4.0], [3.2, 4.0], [3.0, 4.0]])
    grid = OccupancyGrid.from_polygons([wall], (-2, -5, 10, 5), 0.1)
    assert next(iter(tried(ahead(grid=grid)))) == "plan"


def test_coasting_is_constant_velocity():
    scenario = ahead()
    found = coast(scenario)
    np.testing.assert_allclose(found.positions[:, 0], 0.8 * scenario.density.times)
    np.testing.assert_array_equal(found.velocities, np.tile([0.8, 0.0], (len(found.times), 1)))


def test_a_robot_at_rest_on_its_goal_has_finite_starts():
    here = (GivenPlan("here", np.zeros((2, 2))),)
    scenario = Scenario(Robot(np.zeros(2)), plans=here, count=0, tracks=(track("a", 0.3, 0.0),))
    for start in tried(scenario).values():
        assert np.isfinite(start.robot.states).all()
