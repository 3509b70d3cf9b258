"""The object a robot program holds: it always answers, and what it answers can be driven."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgplan import (
    CarLike,
    Density,
    DifferentialDrive,
    FieldOfView,
    OccupancyGrid,
    Robot,
    Scenario,
    ScenarioError,
    Track,
)
from fgplan.driving import Detection, Observation, Outcome, Planner, Settings, unplanned
from fgplan.driving import planner as module
from fgplan.driving.choice import chosen, taken
from fgplan.driving.guard import Tier
from fgplan.safety import Check
from fgplan.trajectory import Trajectory

PERIOD = 0.2
SETTINGS = Settings(period=PERIOD, deadline=None)
DENSITY = Density(dt=0.4, horizon=4.0)
BLOCK = [(3.0, -1.0), (4.0, -1.0), (4.0, 1.0), (3.0, 1.0)]
GRID = OccupancyGrid.from_polygons([BLOCK], (-1, -3, 9, 3), 0.1, border=True)


def scenario(**changes):
    fields = {"goal": np.array([6.0, 0.0]), "crowd": "predicted", "density": DENSITY, **changes}
    return Scenario(Robot(np.zeros(2)), **fields)


class World:
    """A robot that does what it is told, and people who walk straight on."""

    def __init__(self, planner, *people, position=(0.0, 0.0)):
        self.planner, self.people = planner, np.array(people, dtype=float).reshape(-1, 4)
        self.position, self.velocity = np.array(position, dtype=float), np.zeros(2)
        self.heading, self.yaw_rate, self.time = None, 0.0, 0.0
        self.decisions = []

    def observation(self, **changes):
        detections = tuple(Detection(p[:2].copy(), f"p{i}") for i, p in enumerate(self.people))
        fields = {
            "detections": detections,
            "heading": self.heading,
            "yaw_rate": self.yaw_rate,
            **changes,
        }
        return Observation(self.time, self.position.copy(), self.velocity.copy(), **fields)

    def step(self, **changes):
        decision = self.planner.step(self.observation(**changes))
        self.follow(decision)
        return decision

    def follow(self, decision):
        self.decisions.append(decision)
        new = decision.action.velocity
        if self.heading is None:
            self.position = self.position + PERIOD / 2 * (self.velocity + new)
        else:
            self.position = decision.action.position
            self.heading += PERIOD / 2 * (self.yaw_rate + decision.action.twist.angular_z)
            self.yaw_rate = decision.action.twist.angular_z
        self.velocity = new
        self.people[:, :2] += PERIOD * self.people[:, 2:]
        self.time += PERIOD

    def run(self, steps):
        for _ in range(steps):
            if self.step().outcome is Outcome.GOAL_REACHED:
                break
        return self

    def gap(self):
        if not len(self.people):
            return np.inf
        return np.linalg.norm(self.people[:, :2] - self.position, axis=1).min() - 0.55


def is_sound(decision, limit=1.2):
    action = decision.action
    numbers = [*action.position, *action.velocity, action.twist.linear_x, action.twist.angular_z]
    return np.all(np.isfinite(numbers)) and np.linalg.norm(action.velocity) <= limit + 1e-6


def test_alone_it_reaches_the_goal_and_stays():
    world = World(Planner(scenario(), SETTINGS)).run(60)
    last = world.decisions[-1]
    assert last.outcome is Outcome.GOAL_REACHED
    assert np.linalg.norm(world.position - [6.0, 0.0]) < 0.3
    for _ in range(5):
        assert world.step().outcome is Outcome.GOAL_REACHED
    assert np.linalg.norm(world.velocity) < 0.05


def test_round_a_block_and_a_person_nobody_is_touched():
    planner = Planner(scenario(grid=GRID), SETTINGS)
    world = World(planner, [5.5, 1.6, -0.9, 0.0])
    for _ in range(80):
        decision = world.step()
        assert world.gap() > 0
        assert GRID.clearance(world.position, 0.25) > -1e-6
        if decision.outcome is Outcome.GOAL_REACHED:
            break
    assert decision.outcome is Outcome.GOAL_REACHED
    assert {d.label for d in world.decisions if d.label} <= {"A", "B"}


def test_a_robot_with_wheels_is_driven_by_its_twist():
    robot = Robot(np.zeros(2), heading=2.0, model=DifferentialDrive())
    plan = Planner(Scenario(robot, goal=np.array([3.0, 1.0]), density=DENSITY), SETTINGS)
    world = World(plan)
    world.heading = 2.0
    world.run(60)
    assert world.decisions[-1].outcome is Outcome.GOAL_REACHED
    assert all(d.action.twist.linear_y == 0 for d in world.decisions)


@pytest.mark.parametrize("model", [DifferentialDrive(), CarLike()])
def test_a_robot_with_wheels_that_is_as_fast_as_it_likes_drives(model):
    robot = Robot(np.zeros(2), heading=0.0, max_acceleration=20.0, model=model)
    world = World(Planner(scenario().replace(robot=robot), SETTINGS))
    world.heading = 0.0
    assert {world.step().outcome for _ in range(4)} == {Outcome.FOLLOWING}
    assert world.position[0] > 0.5


def test_who_is_out_of_range_changes_no_bit_and_who_is_within_does():
    """Statement 16, in closed loop."""

    def driven(*people):
        view = FieldOfView(range=3.0)
        world = World(Planner(scenario(field_of_view=view), SETTINGS), *people)
        for _ in range(6):
            world.step()
        return np.array([d.action.velocity for d in world.decisions])

    alone = driven()
    np.testing.assert_array_equal(driven([0.0, 3.01, 0.0, 0.1], [-3.5, 0.0, -1.0, 0.0]), alone)
    assert not np.array_equal(driven([2.5, 0.3, 0.0, 0.0]), alone)


def test_people_of_the_scenario_are_known_before_they_are_detected():
    """With a past somebody has a velocity; on another clock it is not theirs."""
    t = np.array([-0.8, -0.4, 0.0])
    walker = Track("anna", t, np.column_stack([3.0 - t, 0.3 + 0 * t]))
    step = Observation(0.0, np.zeros(2), np.zeros(2), detections=None)
    planner = Planner(scenario(tracks=(walker,)), Settings(deadline=None))
    planner.step(step)
    assert planner.memory.people.names == ("anna",)
    np.testing.assert_allclose(planner.memory.people.mean[0, 2:], [-1.0, 0.0], atol=0.05)
    late = Planner(scenario(tracks=(walker,)), Settings(deadline=None))
    late.step(replace(step, time=1e6))
    assert late.memory.people.names == ()
    early = Planner(scenario(tracks=(walker,)), Settings(deadline=None))
    early.step(replace(step, time=-5.0))
    assert early.memory.people.names == ()


def test_the_same_observations_give_the_same_bits():
    def driven():
        world = World(Planner(scenario(grid=GRID), SETTINGS), [4.5, 1.5, -0.7, 0.0]).run(10)
        return np.array([d.action.velocity for d in world.decisions])

    np.testing.assert_array_equal(driven(), driven())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"position": np.array([np.nan, 0.0])}, "not finite"),
        ({"velocity": np.array([0.0, np.inf])}, "not finite"),
        ({"time": 0.0}, "older than the last"),
        ({"time": 0.8}, "repeated"),
        ({"time": np.nan}, "not finite"),
        ({"position": np.array([3.0, 3.0])}, "jumped"),
        ({"position": np.zeros(3)}, "need two numbers"),
        ({"position": np.zeros((1, 2))}, "need two numbers"),
        ({"position": "here"}, "need two numbers"),
        ({"velocity": 0.5}, "need two numbers"),
        ({"heading": np.zeros(2)}, "heading"),
        ({"time": None}, "not finite"),
        ({"time": "now"}, "time 'now' must be a number"),
        ({"covariance": np.eye(3)}, "(3, 3), its model needs (4, 4)"),
        ({"covariance": np.diag([1.0, 1.0, 1.0, np.nan])}, "not finite"),
        ({"covariance": -np.eye(4)}, "positive definite"),
    ],
)
def test_an_impossible_observation_is_refused_by_name_and_the_plan_goes_on(changes, words):
    world = World(Planner(scenario(), SETTINGS)).run(5)
    bad = replace(world.observation(), **changes)
    decision = world.planner.step(bad)
    assert decision.outcome is Outcome.BAD_OBSERVATION
    assert words in decision.reason
    assert is_sound(decision)
    assert decision.action.velocity[0] > 0.5  # it goes on
    world.follow(decision)
    assert world.step().outcome is Outcome.FOLLOWING


def test_without_observations_the_robot_ends_at_rest():
    world = World(Planner(scenario(), SETTINGS)).run(5)
    for _ in range(40):
        world.time += PERIOD
        bad = replace(world.observation(), position=np.array([np.nan, 0.0]))
        decision = world.planner.step(bad)
        assert is_sound(decision)
    assert np.linalg.norm(decision.action.velocity) < 0.05


def test_the_first_observation_may_be_bad():
    planner = Planner(scenario(), SETTINGS)
    decision = planner.step(Observation(0.0, np.array([np.nan, 0.0])))
    assert decision.outcome is Outcome.BAD_OBSERVATION
    assert np.all(decision.action.velocity == 0)


def test_a_robot_that_stays_where_it_jumped_is_believed():
    world = World(Planner(scenario(), SETTINGS)).run(5)
    world.position[1] += 2.5
    assert world.step().outcome is Outcome.BAD_OBSERVATION
    world.position = world.decisions[-2].action.position + np.array([0.0, 2.5])
    decision = world.step()
    assert decision.outcome is not Outcome.BAD_OBSERVATION
    assert abs(decision.trajectory.positions[0, 1] - 2.5) < 0.3


def test_a_robot_that_jumps_to_and_fro_is_not_believed():
    world = World(Planner(scenario(), SETTINGS)).run(5)
    here = world.position
    for away in ([0.0, 2.5], [0.0, -2.5], [0.0, 2.5]):
        world.position = here + away
        decision = world.step()
        assert decision.outcome is Outcome.BAD_OBSERVATION
        assert "jumped" in decision.reason
    world.position = decision.action.position
    assert world.step().outcome is not Outcome.BAD_OBSERVATION


@pytest.mark.parametrize("ahead", [-100.0, -1e9, 1e6])
def test_a_clock_that_is_set_anew_is_believed_after_a_few_steps(ahead):
    """Set back, or one stamp far in the future, after which the true ones seem to be old."""
    world = World(Planner(scenario(), SETTINGS), [5.0, 2.0, -0.3, 0.0]).run(5)
    if ahead > 0:
        bad = replace(world.observation(), time=world.time + ahead)
        world.follow(world.planner.step(bad))
    else:
        world.time += ahead
    ended = [world.step().outcome for _ in range(6)]
    assert ended[:2] == [Outcome.BAD_OBSERVATION] * 2
    assert Outcome.BAD_OBSERVATION not in ended[2:]
    memory = world.planner.memory
    assert memory.started == memory.observation.time == pytest.approx(world.time - PERIOD)
    assert memory.people.names == ("p0",)
    np.testing.assert_allclose(memory.people.mean[0, 2:], [-0.3, 0.0], atol=0.1)
    assert np.linalg.norm(world.velocity) > 0.5


@pytest.mark.parametrize("stamps", [[0.5, 0.6], [0.8] * 5, [0.7, 0.6, 0.5, 0.4]])
def test_what_comes_late_or_again_is_no_new_clock(stamps):
    world = World(Planner(scenario(), SETTINGS)).run(5)
    for stamp in stamps:
        bad = replace(world.observation(), time=stamp)
        assert world.planner.step(bad).outcome is Outcome.BAD_OBSERVATION
    assert world.step().outcome is Outcome.FOLLOWING


def test_impossible_detections_are_left_out_and_named():
    world = World(Planner(scenario(), SETTINGS)).run(2)
    here = np.array([3.0, 2.0])
    bad = (
        Detection(np.array([np.nan, 1.0])),
        Detection(np.array([1.0, np.inf]), "x"),
        Detection(np.array([3.0, 2.0, 0.0])),
        Detection(here[None]),
        Detection(None),
        Detection(here, velocity=np.zeros(3)),
        Detection(here, velocity=np.array([np.nan, 0.0])),
        Detection(here, radius=-0.3),
        Detection(here, radius=np.full(2, 0.3)),
    )
    decision = world.step(detections=bad)
    assert decision.repairs == ("9 impossible detection(s) left out",)
    assert decision.outcome is Outcome.FOLLOWING


@pytest.mark.parametrize("goal", [np.zeros(3), np.array([np.nan, 0.0]), "home", 4.0])
def test_an_impossible_goal_is_not_taken_and_named(goal):
    world = World(Planner(scenario(), SETTINGS)).run(2)
    decision = world.step(goal=goal)
    assert "the old one is kept" in decision.repairs[0]
    assert decision.outcome is Outcome.FOLLOWING


def test_an_unreachable_goal_is_a_stop_with_nav2s_name():
    planner = Planner(scenario(grid=GRID, goal=np.array([3.5, 0.0])), SETTINGS)
    world = World(planner).run(3)
    assert world.decisions[-1].outcome is Outcome.GOAL_OCCUPIED
    assert np.linalg.norm(world.velocity) < 1e-9
    world.step(goal=np.array([6.0, 2.0]))
    assert world.decisions[-1].outcome is not Outcome.GOAL_OCCUPIED


def test_a_goal_that_moves_is_driven_to_without_a_stop():
    """S11: the plan after the change is that of a planner that never knew another goal."""
    world = World(Planner(scenario(), SETTINGS)).run(12)
    speed = np.linalg.norm(world.velocity)
    world.step(goal=np.array([6.0, 2.0]))
    for _ in range(3):
        world.step()
        assert np.linalg.norm(world.velocity) > 0.6 * speed
    fresh = Planner(scenario(goal=np.array([6.0, 2.0])), SETTINGS)
    observation = world.observation()
    a, b = world.planner.step(observation), fresh.step(observation)
    np.testing.assert_allclose(a.action.velocity, b.action.velocity, atol=0.02)


def test_where_the_way_that_is_followed_is_closed_another_one_is_taken_and_said():
    world = World(Planner(scenario(grid=GRID, count=1), SETTINGS)).run(5)
    assert world.decisions[-1].label == "A"
    side = np.sign(world.decisions[-1].trajectory.positions[-1, 1])
    wall = [(3.3, 0.9 * side), (3.7, 0.9 * side), (3.7, 3.0 * side), (3.3, 3.0 * side)]
    closed = OccupancyGrid.from_polygons([BLOCK, wall], (-1, -3, 9, 3), 0.1, border=True)
    decision = world.step(grid=closed)
    assert decision.outcome is Outcome.REPLANNING
    assert decision.label == "B"
    assert world.step().outcome is Outcome.FOLLOWING


def test_a_robot_that_stalls_says_that_it_makes_no_progress():
    planner = Planner(scenario(grid=GRID), replace(SETTINGS, stall=1.0))
    world, ended = World(planner), []
    for _ in range(9):
        ended.append(world.step().outcome)
        world.position, world.velocity = np.zeros(2), np.zeros(2)
    assert set(ended[:5]) == {Outcome.FOLLOWING}
    assert set(ended[-2:]) == {Outcome.NO_PROGRESS}


def test_whatever_breaks_inside_is_a_stop_that_says_so(monkeypatch):
    world = World(Planner(scenario(), SETTINGS)).run(5)

    def broken(*args, **kwargs):
        raise RuntimeError("indeterminate linear system")

    monkeypatch.setattr(module, "plan", broken)
    decision = world.step()
    assert decision.outcome is Outcome.NO_VALID_CONTROL
    assert "indeterminate linear system" in decision.reason
    assert is_sound(decision)
    assert np.linalg.norm(decision.action.velocity) < np.linalg.norm(
        world.decisions[-2].action.velocity
    )


def stops(decisions, speed, acceleration=1.5):
    """Whether commands from a speed on never get faster, and end at rest as soon as they can."""
    speeds = [speed, *(float(np.linalg.norm(d.action.velocity)) for d in decisions)]
    assert np.diff(speeds).max() <= 1e-6
    return max(speeds[1 + int(np.ceil(speed / acceleration / PERIOD)) :]) < 1e-6


@pytest.mark.parametrize("sees", [True, False])
@pytest.mark.parametrize("broken", ["plan", "Judge", "progressed"])
def test_a_stop_goes_on_until_the_robot_rests_whatever_breaks(monkeypatch, broken, sees):
    """Also where the guard breaks, and where the robot does not do as it is told."""

    def breaks(*args, **kwargs):
        raise RuntimeError(broken)

    world = World(Planner(scenario(), SETTINGS)).run(5)
    before = world.decisions[-1].action
    for home in (module, unplanned):
        if hasattr(home, broken):
            monkeypatch.setattr(home, broken, breaks)
    decisions = []
    for _ in range(20):
        decisions.append(world.planner.step(world.observation()))
        world.follow(decisions[-1])
        if not sees:
            world.velocity = before.velocity
    assert {d.outcome for d in decisions} == {Outcome.NO_VALID_CONTROL}
    assert decisions[-1].action.kind == "stop"
    assert all(is_sound(d) for d in decisions)
    assert stops(decisions, np.linalg.norm(before.velocity))


def test_a_robot_of_which_nothing_usable_was_ever_seen_comes_to_rest():
    moving = replace(scenario().robot, velocity=np.array([1.0, 0.0]))
    planner = Planner(scenario().replace(robot=moving), SETTINGS)
    bad = [Observation(1e9 + PERIOD * k, np.full(2, np.nan)) for k in range(20)]
    assert stops([planner.step(observation) for observation in bad], 1.0)


def test_a_scenario_that_makes_no_sense_is_refused_before_any_step():
    with pytest.raises(ScenarioError, match="goal"):
        Planner(scenario(goal=np.array([np.nan, 0.0])), SETTINGS)


def test_without_goal_it_goes_on_as_it_did():
    robot = Robot(np.zeros(2), np.array([0.5, 0.0]))
    planner = Planner(Scenario(robot, density=DENSITY), SETTINGS)
    decision = planner.step(Observation(0.0, np.zeros(2), np.array([0.5, 0.0])))
    np.testing.assert_allclose(decision.action.velocity, [0.5, 0.0], atol=1e-3)


def direction(rng):
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])


def with_detection(seen, **changes):
    """The observation with one more detection, spoilt in some way."""
    spoilt = replace(Detection(np.array([3.0, 2.0]), "p0"), **changes)
    return {"detections": (*seen.detections, spoilt)}


FAULTS = {
    "nothing": lambda seen, rng: {},
    "nothing sensed": lambda seen, rng: {"detections": None},
    "nobody in sight": lambda seen, rng: {"detections": ()},
    "late": lambda seen, rng: {"time": seen.time - 1.0},
    "repeated": lambda seen, rng: {"time": seen.time - PERIOD},
    "from the future": lambda seen, rng: {"time": seen.time + 10.0 ** rng.uniform(1, 12)},
    "no time": lambda seen, rng: {"time": rng.choice([np.nan, np.inf, -np.inf])},
    "no place": lambda seen, rng: {"position": np.full(2, np.nan)},
    "no velocity": lambda seen, rng: {"velocity": np.array([0.0, np.nan])},
    "no heading": lambda seen, rng: {"heading": np.nan},
    "too fast": lambda seen, rng: {"velocity": rng.normal(0, 100, 2)},
    "jump": lambda seen, rng: {"position": seen.position + 20 * direction(rng)},
    "place of three numbers": lambda seen, rng: {"position": np.zeros(3)},
    "velocity of one number": lambda seen, rng: {"velocity": np.zeros(1)},
    "covariance too small": lambda seen, rng: {"covariance": np.eye(3)},
    "covariance below zero": lambda seen, rng: {"covariance": -np.eye(4)},
    "goal of three numbers": lambda seen, rng: {"goal": np.zeros(3)},
    "goal nowhere": lambda seen, rng: {"goal": np.full(2, np.inf)},
    "somebody twice": lambda seen, rng: with_detection(seen, position=rng.uniform(-5, 5, 2)),
    "somebody nowhere": lambda seen, rng: with_detection(seen, position=np.full(2, np.inf)),
    "somebody of three numbers": lambda seen, rng: with_detection(seen, velocity=np.zeros(3)),
    "somebody in a row": lambda seen, rng: with_detection(seen, position=np.zeros((1, 2))),
    "nobody": lambda seen, rng: {"detections": (None,)},
}
"""What may be wrong with an observation: changes of it."""
UNUSABLE = {
    "repeated",
    "no time",
    "no place",
    "no velocity",
    "no heading",
    "jump",
    "place of three numbers",
    "velocity of one number",
    "covariance too small",
    "covariance below zero",
    "nobody",
}
"""Those after which nothing of it is known."""


def spoilt(observation, fault, rng):
    return replace(observation, **FAULTS[fault](observation, rng))


@settings(max_examples=12, deadline=None)
@given(st.lists(st.sampled_from(sorted(FAULTS)), min_size=15, max_size=15), st.integers(0, 9))
def test_faults_of_every_kind_never_make_an_unsound_action(faults, seed):
    """One after another: dropped, repeated, late, early, NaN, of no shape, jumping."""
    rng = np.random.default_rng(seed)
    people = np.hstack([rng.uniform([1, -2], [5, 2], (3, 2)), rng.normal(0, 0.5, (3, 2))])
    world = World(Planner(scenario(grid=GRID), SETTINGS), *people)
    for fault in faults:
        decision = world.planner.step(spoilt(world.observation(), fault, rng))
        assert is_sound(decision)
        world.follow(decision)


@pytest.mark.parametrize("fault", sorted(FAULTS))
def test_each_fault_alone_is_survived(fault):
    """The next good observations are driven on with, whatever came before."""
    rng = np.random.default_rng(0)
    world = World(Planner(scenario(), SETTINGS), [5.0, 2.0, -0.3, 0.0]).run(4)
    world.follow(world.planner.step(spoilt(world.observation(), fault, rng)))
    ended = [world.step().outcome for _ in range(4)]
    assert ended[-1] is Outcome.FOLLOWING


@pytest.mark.parametrize("fault", sorted(UNUSABLE))
def test_where_nothing_usable_comes_any_more_the_robot_comes_to_rest(fault):
    """A second on the last plan, then a stop."""
    rng = np.random.default_rng(0)
    world = World(Planner(scenario(), SETTINGS)).run(6)
    decisions = []
    for _ in range(20):
        decisions.append(world.planner.step(spoilt(world.observation(), fault, rng)))
        world.follow(decisions[-1])
        if fault == "repeated":
            world.time -= PERIOD
    assert all(is_sound(decision) for decision in decisions)
    goes_on = int(np.ceil(SETTINGS.blind / PERIOD))
    speed = np.linalg.norm(decisions[goes_on].action.velocity)
    assert stops(decisions[goes_on + 1 :], speed)


@pytest.mark.parametrize(
    ("grade", "tier", "expected"),
    [(1, Tier.LATEST_CONTACT, "A"), (2, Tier.AVOIDING, "A"), (2, Tier.LATEST_CONTACT, "B")],
)
def test_a_route_is_left_for_a_better_one_not_for_a_clear_command(grade, tier, expected):
    # Seen to fail without it: in S3 the route flipped twenty times a run.
    path = Trajectory(np.array([0.0, 1.0]), np.zeros((2, 2)), np.zeros((2, 2)))
    best, other = (
        SimpleNamespace(label=label, robot=path, crowd={}, check=Check(1.0, 1.0, np.inf, (), g))
        for label, g in (("A", grade), ("B", 0))
    )
    mixture = SimpleNamespace(best=best, components=(best, other), selected=0)
    judge = SimpleNamespace(
        scenario=scenario(),
        belief=SimpleNamespace(radii=np.zeros(0)),
        command=lambda plan, people: SimpleNamespace(tier=tier),
    )
    assert chosen(mixture, judge).label == expected


@pytest.mark.parametrize(
    ("tier", "known", "expected"),
    [
        (Tier.CLEAR, {"A", "B"}, "B"),
        (Tier.AVOIDING, {"A", "B"}, "B"),
        (Tier.YIELDING, {"A", "B"}, "A"),
        (Tier.LATEST_CONTACT, {"A", "B"}, "A"),
        (Tier.LATEST_CONTACT, {"B"}, "B"),
    ],
)
def test_who_only_gets_out_of_the_way_takes_no_other_route(tier, known, expected):
    # Seen to fail without it: in S5 the route flipped twice while somebody was dodged.
    assert taken("B, waiting", tier, "A", known) == expected


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("period", 0.0), ("period", -0.1), ("period", np.nan), ("period", np.inf),
        ("deadline", 0.0), ("deadline", np.nan), ("goal_tolerance", -1.0), ("lag", -5.0),
        ("commitment", -1.0), ("blind", np.nan), ("stall", 0.0),
    ],
)  # fmt: skip
def test_settings_that_make_no_sense_are_refused_by_name(name, value):
    with pytest.raises(ValueError, match=f"^{name} .* got {value}"):
        Settings(**{name: value})
