"""What is seen may be wrong in every way, and anything may break: the robot ends at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgplan.driving import Detection, Observation, Outcome, Planner, unplanned
from fgplan.driving import planner as module
from tests.fgplan.driving.driven import (
    GRID,
    PERIOD,
    SETTINGS,
    World,
    is_sound,
    scenario,
)


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
