"""Simulated operators: they say what they should, when they should, and lose what they should."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.operator import COSTLIER, fork, rooms, send, steer
from fgplan.errors import FgplanError
from fgplan.scenario import Robot
from fgplan.shared_control import JoySample, Stick, write_joy
from fgplan.simulation.arbitration import BlendingPlanner, TwistMuxPlanner
from fgplan.simulation.body import Body
from fgplan.simulation.episode import run
from fgplan.simulation.file import FromFile
from fgplan.simulation.operators import (
    OPERATORS,
    Adversary,
    Held,
    Replay,
    Steady,
    UnknownOperator,
    WithOperator,
    goal_of,
    operator_named,
)
from fgplan.simulation.peers import Straight
from fgplan.simulation.planners import named

DATA = Path(__file__).parents[3] / "data" / "simulations"


def listen(operator, world, steps=40):
    """What is said in the first seconds to a robot that stands."""
    body = Body(world.scenario, world.limits)
    return [operator(0.1 * k, body, world.people) for k in range(steps)]


def test_a_steady_hand_holds_the_stick_for_its_time():
    world = fork(0)
    said = listen(Held(Steady(0.5, 1.0, 2.5), 0.1, np.random.default_rng(0), sigma=0.0), world)
    times = [k for k, items in enumerate(said) if items]
    assert times == list(range(10, 25))
    np.testing.assert_allclose(said[10][0].velocity, [np.cos(0.5), np.sin(0.5)], atol=1e-12)


@pytest.mark.parametrize(
    ("robot", "ahead"),
    [
        ({"heading": 0.7, "velocity": np.array([1.0, 0.0])}, 0.7),
        ({"velocity": np.array([0.0, -1.0])}, -np.pi / 2),
        ({}, 0.0),
    ],
)
def test_without_a_goal_an_operator_goes_straight_on(robot, ahead):
    world = fork(0)
    scenario = world.scenario.replace(goal=None, robot=Robot(np.array([1.0, 2.0]), **robot))
    offset = goal_of(replace(world, scenario=scenario)) - [1.0, 2.0]
    np.testing.assert_allclose(offset, 5.0 * np.array([np.cos(ahead), np.sin(ahead)]), atol=1e-12)


def test_noise_losses_and_delay_are_what_they_are_called():
    world, hand = fork(0), Steady(0.0, 0.0, 1e9, speed=0.5)
    rng = np.random.default_rng
    said = listen(Held(hand, 0.1, rng(1), sigma=0.1), world, 2000)
    values = np.array([items[0].velocity for items in said])
    assert values.std(axis=0) == pytest.approx([0.1, 0.1], rel=0.1)
    kept = sum(bool(items) for items in listen(Held(hand, 0.1, rng(2), dropped=0.2), world, 2000))
    assert kept / 2000 == pytest.approx(0.8, abs=0.03)
    late = listen(Held(hand, 0.1, rng(3), delay=0.3), world)
    assert [bool(items) for items in late[:4]] == [False, False, False, True]
    assert late[3][0].time == pytest.approx(0.0)  # and the stamp says so


def test_an_adversary_steers_at_the_nearest():
    world = rooms(3)
    body = Body(world.scenario, world.limits)
    wish = Adversary(world).wish(0.0, body, world.people)
    people = np.linalg.norm(world.people.positions - body.position, axis=1)
    ahead = body.position + np.outer(np.arange(0, 4, 0.02), wish / np.linalg.norm(wish))
    wall = np.flatnonzero(world.grid.clearance(ahead, 0.0) < 0)
    to_wall = 0.02 * wall[0] if len(wall) else np.inf
    nearest = int(np.argmin(people))
    to_person = np.linalg.norm(ahead - world.people.positions[nearest], axis=1).min()
    assert to_person < 1e-2 or to_wall <= people.min() + 0.2


def test_runs_are_the_same_again():
    for name in ("left", "noisy", "dropping"):
        first, again = (listen(WithOperator(fork, name)(4).operator, fork(4), 4) for _ in range(2))
        for a, b in zip(first, again, strict=True):
            assert len(a) == len(b)
            for x, y in zip(a, b, strict=True):
                np.testing.assert_array_equal(x.velocity, y.velocity)


def test_a_log_is_replayed_until_its_timeout(tmp_path: Path):
    held, let_go = (0, 0, 0, 0, 1), (0, 0, 0, 0, 0)
    samples = [
        JoySample(100.0, (0.0, 0.5), held), JoySample(100.3, (0.0, 1.0), held),
        JoySample(100.5, (0.0, 0.0), let_go), JoySample(101.5, (0.5, 0.0), held),
    ]  # fmt: skip
    write_joy(tmp_path / "log.jsonl", samples)
    operator = Replay(tmp_path / "log.jsonl", 0.1, Stick(timeout=0.25))
    said = listen(operator, fork(0), 25)
    assert [k for k, items in enumerate(said) if items] == [0, 1, 2, 3, 4, 15, 16, 17]
    assert np.linalg.norm(said[1][0].velocity) == pytest.approx(0.5)
    assert np.linalg.norm(said[3][0].velocity) == pytest.approx(1.0)


@pytest.mark.parametrize("operator", ["left", "delayed", "log"])
def test_what_is_said_counts_from_the_start_of_the_run(tmp_path: Path, operator: str):
    """Whatever the scenario's clock says then; the stamps are on that clock."""
    if operator == "log":
        operator = str(tmp_path / "log.jsonl")
        write_joy(operator, [JoySample(50.0 + t, (0.0, 0.5), (0, 0, 0, 0, 1)) for t in (0, 1.0)])
    places = "[{name = 'desk', position = [6, 4], sigma = 0.3, said = 1.5, time = 2.0}]"
    told = []
    for now in (0.0, 10.0):
        changes = ("crowd.now", str(now)), ("world.operator", operator), ("world.waypoints", places)
        world = FromFile(DATA / "s6a_operator.toml", (*changes, ("world.time_limit", "2.6")))(0)
        heard = []
        run(world, Straight(world), lambda moment, heard=heard: heard.append(moment.observation))
        told.append([[said.time - now for said in seen.operator] for seen in heard])
    assert any(told[0])
    for first, again in zip(*told, strict=True):
        assert again == pytest.approx(first, abs=1e-9)


def test_an_unknown_operator_is_named(tmp_path: Path):
    with pytest.raises(UnknownOperator, match="adversary"):
        operator_named("adversery")
    with pytest.raises(FgplanError, match="cannot be read"):
        operator_named(str(tmp_path / "nothing.jsonl"))
    assert all(operator_named(name) is OPERATORS[name] for name in OPERATORS)


def test_peers_arbitrate_after_the_fact():
    """The mux is the stick itself while it is held; blending is half of each."""
    commands = {}
    for name, maker in (
        ("mux", TwistMuxPlanner()), ("blend", BlendingPlanner()), ("alone", named("fgplan"))
    ):  # fmt: skip
        world = fork(0)
        world = replace(world, rules=replace(world.rules, time_limit=0.3))
        if name != "alone":
            hand = Held(Steady(1.0, 0.1, 0.2), 0.1, np.random.default_rng(0), sigma=0.0)
            world = replace(world, operator=hand)
        seen = []
        run(world, maker(world), lambda moment, seen=seen: seen.append(moment.command.velocity))
        commands[name] = np.array(seen)
    wish = np.array([np.cos(1.0), np.sin(1.0)])
    np.testing.assert_allclose(commands["mux"][0], commands["alone"][0])
    np.testing.assert_allclose(commands["mux"][1], wish, atol=1e-9)
    np.testing.assert_allclose(commands["blend"][1], 0.5 * (commands["alone"][1] + wish), atol=1e-9)


def test_s6a_the_robot_commits_at_once_and_does_not_turn_back():
    steered = steer("fgplan", 0)
    assert steered.commits <= 1.0
    assert steered.taken
    assert not steered.reversed
    assert steered.collisions == 0


def test_s6b_an_adversary_makes_no_contact():
    world = WithOperator(rooms, "adversary")(11)
    world = replace(world, rules=replace(world.rules, time_limit=3.0))
    episode = run(world, named("fgplan")(world))
    assert episode.end != "error"
    assert episode.gaps.min() >= 0
    assert not episode.blocked.any()


def test_s6c_a_place_in_the_costlier_corridor_is_met():
    sent = send(0, COSTLIER, "window")
    assert sent.reached
    assert sent.reports == ("window is reached",)
    assert sent.nearest <= 0.3
