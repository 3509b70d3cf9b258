"""New hypotheses where the operator points; candidates; what is believed and what is left of it."""

from __future__ import annotations

import numpy as np
import pytest

from fgplan import GivenPlan, Level, OccupancyGrid, Reading, Readings, Robot, Scenario, plan
from fgplan.crowd import believe
from fgplan.hypotheses import hypothesise
from fgplan.shared_control import (
    ON,
    STICK,
    VIA,
    Candidate,
    DrawnPath,
    Joystick,
    Waypoint,
    admit,
    deviation,
    find_candidates,
    operated,
    toward,
)

BLOCK = [(3.0, -1.0), (5.0, -1.0), (5.0, 1.0), (3.0, 1.0)]
GRID = OccupancyGrid.from_polygons([BLOCK], (-1, -4, 9, 4), 0.1, border=True)
NOBODY = believe((), 0.0, 0.03, 0.04, 1.5)
LINE = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])


def scenario(*data, **changes):
    robot = Robot(np.zeros(2), np.array([0.8, 0.0]))
    fields = {"goal": np.array([8.0, 0.0]), "grid": GRID, **changes}
    return Scenario(robot, data=data, **fields)


def place(x, y, sigma=0.3, **changes):
    return Waypoint(np.array([x, y]), sigma**2 * np.eye(2), **changes)


def stick(degrees, t=0.0, speed=0.8):
    a = np.deg2rad(degrees)
    return Joystick(t, speed * np.array([np.cos(a), np.sin(a)]), 0.04 * np.eye(2))


def labels(s):
    return {h.label: h for h in operated(hypothesise)(s, NOBODY)}


def test_without_data_the_source_is_itself():
    bare = hypothesise(scenario(), NOBODY)
    assert [h.label for h in operated(hypothesise)(scenario(), NOBODY)] == [h.label for h in bare]


def test_weights_sum_to_one():
    found = labels(scenario(place(1.0, -2.5), stick(-80)))
    assert set(found) >= {VIA, STICK}
    assert sum(np.exp(h.log_prior) for h in found.values()) == pytest.approx(1)


def test_a_waypoint_off_all_routes_gets_a_route_of_its_own():
    found = labels(scenario(place(1.0, -2.5)))
    gap = np.linalg.norm(found[VIA].along.at(np.linspace(0, 20, 400))[:, :2] - [1.0, -2.5], axis=1)
    assert gap.min() < 0.1
    assert VIA not in labels(scenario(place(4.0, 1.4, sigma=0.5)))  # the route passes there
    longer = found[VIA].cost - min(h.cost for h in found.values())
    assert longer > 0.5
    beta = scenario().density.beta
    best = max(h.log_prior for h in found.values())
    assert found[VIA].log_prior == pytest.approx(best - beta * longer)


def test_the_route_through_a_waypoint_is_chosen_and_passes_it():
    mixture = plan(scenario(place(1.0, -2.0)))
    assert mixture.components[0].label == VIA
    at = mixture.trajectory.at(np.linspace(0, 4.8, 100))[:, :2]
    assert np.linalg.norm(at - [1.0, -2.0], axis=1).min() < 0.4
    alone = plan(scenario())
    assert (
        np.linalg.norm(
            alone.trajectory.at(np.linspace(0, 4.8, 100))[:, :2] - [1.0, -2.0], axis=1
        ).min()
        > 0.8
    )


def test_a_stick_along_a_route_makes_no_new_plan_and_one_off_them_does():
    assert STICK not in labels(scenario(stick(20)))
    found = labels(scenario(stick(100), grid=None))
    ahead = found[STICK].plan.velocities[-1]
    np.testing.assert_allclose(
        ahead, 0.8 * np.array([np.cos(np.deg2rad(100)), np.sin(np.deg2rad(100))])
    )
    assert STICK not in labels(scenario(stick(100, t=-5.0)))  # let go long ago


def test_an_operator_who_steers_at_a_wall_slides_along_it():
    """The stick leads into the block; the plan does not, and is as near to it as is safe."""
    ahead = OccupancyGrid.from_polygons(
        [[(1.0, -4), (2.0, -4), (2.0, 4), (1.0, 4)]], (-1, -4, 9, 4), 0.1
    )
    held = [stick(40, t=-0.1 * k) for k in range(6)]
    s = scenario(*held, goal=None, grid=ahead)
    mixture = plan(s)
    assert mixture.components[0].label == STICK
    assert mixture.components[0].feasible
    assert mixture.components[0].check.clearance >= 0
    end = mixture.trajectory.positions[-1]
    assert end[1] > 0.8  # on along the wall
    left = deviation(s, mixture.trajectory)
    assert left is not None
    assert left.metres > 0.1
    assert left.nats > 0.1


def test_without_goal_and_data_the_plan_is_the_prior_mean():
    best = plan(scenario(goal=None, grid=None)).components[0]
    times = best.robot.times
    np.testing.assert_allclose(best.robot.positions, np.outer(times, [0.8, 0.0]), atol=1e-6)


def test_without_goal_the_stick_is_followed_and_fades():
    free = {"goal": None, "grid": None, "levels": (Level(sigma=0.5, length=2.0),)}
    now = plan(scenario(stick(60), **free))
    assert now.components[0].label == STICK
    ages = [
        plan(scenario(stick(60, t=-age), **free)).trajectory.positions[-1, 1]
        for age in (1.5, 3, 30)
    ]
    assert now.trajectory.positions[-1, 1] > ages[0] > ages[1] > ages[2]
    assert ages[2] == pytest.approx(0, abs=1e-6)
    assert {c.label for c in plan(scenario(stick(60, t=-3), **free)).components} == {ON}


def test_without_the_goal_the_frame_of_the_map_does_not_matter():
    """Corrupted localisation: dropping G makes the plan independent of the map frame's offset."""

    def planned(offset, goal=None):
        data = () if goal is not None else (stick(40), stick(35, t=-0.5))
        s = scenario(*data, goal=goal, grid=None, levels=(Level(sigma=0.5),))
        robot = Robot(np.zeros(2) + offset, np.array([0.8, 0.0]))
        return plan(s.replace(robot=robot)).trajectory.positions - offset

    offset = np.array([37.5, -12.25])
    np.testing.assert_allclose(planned(offset), planned(np.zeros(2)), atol=1e-8)
    goal = np.array([8.0, 0.0])
    assert np.abs(planned(offset, goal) - planned(np.zeros(2), goal)).max() > 0.5


@pytest.mark.parametrize(
    ("bad", "why"),
    [
        (Joystick(0.0, np.array([np.nan, 0.0]), np.eye(2)), "finite numbers"),
        (Joystick(0.0, np.ones(2) * 0.1, -np.eye(2)), "positive definite"),
        (Joystick(2.0, np.ones(2) * 0.1, np.eye(2)), "2.00 s in the future"),
        (place(np.inf, 0.0), "finite numbers"),
        (Waypoint(np.zeros(2), np.array([[1.0, 2.0], [2.0, 1.0]])), "positive definite"),
        (place(1.0, 1.0, on="strategy"), "is not measured"),
        (place(1.0, 1.0, on=np.zeros(2)), "is not measured"),
        (Readings((Reading(np.nan, np.zeros(2), np.eye(2)),)), "time in seconds"),
        ("left, please", "measurement"),
        (DrawnPath(LINE, np.eye(2), times=np.array([1.0, 2.0])), "one for each vertex"),
        (DrawnPath(LINE, np.eye(2), spacing=0.0), "spacing is 0.0; give a finite length"),
        (DrawnPath([[0, 0], [1]], np.eye(2)), "its readings cannot be made"),
        (DrawnPath(np.arange(3.0), np.eye(2)), "give shape (N, 2)"),
        (DrawnPath(np.zeros((0, 2)), np.eye(2)), "give shape (N, 2)"),
        (Joystick(None, np.zeros(2), np.eye(2)), "time is None; give a time in seconds"),
        (Joystick(0.0, np.zeros(2), np.eye(2), window="long"), "window is 'long'"),
        (Readings(None), "its readings cannot be made"),
        (Readings((3.0,)), "give a Reading"),
        (Readings((Reading(0.0, np.zeros(2), np.eye(2), said=np.nan),)), "said"),
    ],
)
def test_bad_data_is_refused_by_name_and_the_rest_is_used(bad, why):
    good = place(1.0, 1.0)
    admitted = admit((bad, good), scenario())
    assert admitted.data == (good,)
    assert len(admitted.notes) == 1
    assert why in admitted.notes[0]
    assert "refused" in admitted.notes[0]


def test_a_stick_beyond_its_range_is_taken_at_the_top_speed():
    (limited,), (note,) = (lambda a: (a.data, a.notes))(admit((stick(30, speed=3.0),), scenario()))
    assert np.linalg.norm(limited.velocity) == pytest.approx(1.2)
    assert "3.00 m/s; 1.20 m/s taken" in note


def test_a_stick_may_say_its_velocity_as_a_list():
    (limited,) = admit((Joystick(0.0, [9.0, 0.0], np.eye(2)),), scenario()).data
    np.testing.assert_allclose(limited.velocity, [1.2, 0.0])
    said, listed = (
        scenario(Joystick(0.0, velocity, 0.04 * np.eye(2)))
        for velocity in (np.array([0.5, 0.1]), [0.5, 0.1])
    )
    (h, *_) = hypothesise(said, NOBODY)
    assert deviation(listed, h.plan) == deviation(said, h.plan)


@pytest.mark.parametrize(
    ("x", "where"),
    [(4.0, "inside an obstacle"), (2.7, "too near a wall"), (12.0, "outside the map")],
)
def test_a_place_where_the_robot_cannot_be_is_reported_and_the_plan_goes_on(x, where):
    s = scenario(place(x, 0.0, name="kitchen"))
    admitted = admit(s.data, s)
    assert len(admitted.data) == 1
    assert "kitchen" in admitted.notes[0]
    assert where in admitted.notes[0]
    mixture = plan(s)
    assert mixture.components[0].feasible


def test_who_rests_in_an_obstacle_and_has_no_goal_may_stay_there():
    """Nothing to slide along: no speed, no direction."""
    resting = Robot(np.array([3.05, 0.0]))
    components = plan(scenario(stick(180), goal=None).replace(robot=resting)).components
    assert {c.label for c in components} >= {ON}


def test_candidates_are_doors_ends_and_corners():
    walls = [
        [(4.0, 0.0), (4.2, 0.0), (4.2, 1.6), (4.0, 1.6)],  # a door of 0.8 m at y = 2
        [(4.0, 2.4), (4.2, 2.4), (4.2, 4.0), (4.0, 4.0)],
        [(8.0, 0.0), (12.0, 0.0), (12.0, 1.4), (8.0, 1.4)],  # a corridor of 1.2 m at y = 2
        [(8.0, 2.6), (12.0, 2.6), (12.0, 4.0), (8.0, 4.0)],
    ]
    grid = OccupancyGrid.from_polygons(walls, (0, 0, 12, 4), 0.05, border=True)
    found = find_candidates(grid, np.array([1.0, 2.0]), 0.25)
    by_kind = {
        kind: [c.position for c in found if c.kind == kind] for kind in ("door", "end", "corner")
    }
    assert np.linalg.norm(np.array(by_kind["door"]) - [4.1, 2.0], axis=1).min() < 0.3
    ends = np.array(by_kind["end"])
    assert np.linalg.norm(ends - [11.7, 2.0], axis=1).min() < 0.4
    assert np.linalg.norm(ends - [8.0, 2.0], axis=1).min() < 0.6
    assert len(by_kind["corner"]) >= 2
    assert all(grid.clearance(c.position[None], 0.25)[0] >= 0 for c in found)
    assert len(find_candidates(grid, np.array([1.0, 2.0]), 0.25, most=2)) == 2


def test_a_candidate_whose_name_would_be_read_as_two_is_refused():
    with pytest.raises(ValueError, match=r"candidate 'door/left' has '/', which ends a name"):
        Candidate("door/left", np.zeros(2))


def test_candidates_nothing_leads_to_are_left_out():
    candidates = [
        Candidate("in the block", np.array([4.0, 0.0])),
        Candidate("b", np.array([8, 2.0])),
    ]
    found = toward(candidates)(scenario(goal=None), NOBODY)
    assert [h.label for h in found] == ["b"]
    assert found[0].log_prior == 0.0


def test_a_plan_that_does_as_asked_deviates_by_nothing():
    s = scenario(
        stick(0), plans=(GivenPlan("on", np.array([[0, 0], [8, 0.0]])),), count=0, grid=None
    )
    (h,) = hypothesise(
        s.replace(robot=Robot(np.zeros(2), np.array([0.8, 0.0]), preferred_speed=0.8)), NOBODY
    )
    found = deviation(s, h.plan)
    assert found is not None
    assert (found.metres, found.nats) == pytest.approx((0, 0), abs=1e-9)
    assert deviation(s.replace(data=()), h.plan) is None
