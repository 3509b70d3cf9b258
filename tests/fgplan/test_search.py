"""Warm starts, deadlines, and hypotheses that are dropped because they cannot win."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgplan import (
    Density,
    DifferentialDrive,
    GivenPlan,
    Holonomic,
    Robot,
    Scenario,
    Track,
    plan,
)
from fgplan.assembly import Assembly
from fgplan.hypotheses import hypothesise
from fgplan.hypothesis import Hypothesis, Start
from fgplan.model import build
from fgplan.safety import Check, People, check
from fgplan.search import search, shifted, worth_solving
from fgplan.solver import SecondOrder, Solution, Stop
from fgplan.trajectory import Trajectory
from tests.scenes import believed

STEP = 0.2


def walking(names: str, now: float = 0.0) -> tuple[Track, ...]:
    """People who cross in front of the robot, seen up to `now`."""
    t = np.round(np.arange(-0.8, now + 1e-9, 0.2), 6)
    lanes = {"a": (3.0, 1.5, -0.1, -0.7), "b": (4.0, -1.4, -0.3, 0.6), "c": (2.5, -0.5, -0.9, 0.0)}
    return tuple(
        Track(n, t, np.column_stack([lanes[n][0] + lanes[n][2] * t, lanes[n][1] + lanes[n][3] * t]))
        for n in names
    )


def fork(
    names: str = "ab", weights: tuple[float, float] = (1.0, 1.0), now: float = 0.0
) -> Scenario:
    here = np.array([0.8 * now, 0.0])
    paths = (
        GivenPlan("left", np.array([here, [3.0, 1.2], [8.0, 1.2]]), weights[0]),
        GivenPlan("right", np.array([here, [3.0, -1.2], [8.0, -1.2]]), weights[1]),
    )
    return Scenario(
        Robot(here, np.array([0.8, 0.0])),
        plans=paths,
        count=0,
        tracks=walking(names, now),
        now=now,
        density=Density(dt=0.2, horizon=4.0),
    )


def later(previous, scenario: Scenario) -> Scenario:
    """The scenario when the first step of a plan has been driven."""
    state = previous.trajectory.at(scenario.now - previous.now)
    robot = replace(scenario.robot, position=state[:2], velocity=state[2:])
    paths = tuple(
        GivenPlan(p.label, np.vstack([state[:2], p.path[1:]]), p.weight) for p in scenario.plans
    )
    return scenario.replace(robot=robot, plans=paths)


def test_a_warm_start_needs_fewer_iterations_and_is_never_worse():
    first = plan(fork())
    second = later(first, fork(now=STEP))
    belief = believed(second)
    hypotheses = hypothesise(second, belief)
    only = [replace(h, starts=h.starts[:1]) for h in hypotheses]
    assembly = Assembly(build(second, belief, only))
    warm = shifted(first, second, belief)
    initial = np.stack([assembly.models[0].initial(s) for s in (only[0].starts[0], *warm)])
    cold, *others = SecondOrder(meeting=0.0, patience=np.inf).solve(
        assembly, initial, np.zeros(3, dtype=int)
    )
    assert min(o.iterations for o in others) < cold.iterations
    both = search(assembly, only, SecondOrder(), warm)
    assert min(f.solution.energy for f in both.found if f.which == 0) <= cold.energy + 1e-9


@pytest.mark.parametrize(("before", "after"), [("ab", "abc"), ("abc", "b"), ("", "ab"), ("ab", "")])
def test_people_may_appear_and_vanish_between_plans(before, after):
    first = plan(fork(before))
    second = later(first, fork(after, now=STEP))
    warm, cold = plan(second, warm=first), plan(second)
    assert warm.best is not None
    assert set(warm.best.crowd) == set(after)
    assert warm.components[0].energy <= cold.components[0].energy + 1e-6


def test_the_best_of_the_previous_components_is_taken_whatever_its_label():
    first = plan(fork())
    swapped = fork(now=STEP)
    swapped = later(first, swapped.replace(plans=swapped.plans[::-1]))
    belief = believed(swapped)
    hypotheses = hypothesise(swapped, belief)
    assembly = Assembly(build(swapped, belief, hypotheses))
    found = search(assembly, hypotheses, SecondOrder(), shifted(first, swapped, belief)).found
    for i, hypothesis in enumerate(hypotheses):
        (start,) = [f for f in found if f.which == i and f.label == "warm"]
        robot = assembly.models[i].columns["robot"].start
        side = np.sign(start.solution.state[-1, robot + 1])
        assert side == (1 if hypothesis.label == "left" else -1)


def test_without_a_deadline_everything_is_finished_and_nothing_dropped():
    mixture = plan(fork(weights=(1.0, 1e-6)))
    assert all(c.finished for c in mixture.components)
    assert not any("dropped" in w or "finished" in w for w in mixture.warnings)


def test_a_hypothesis_whose_bound_cannot_win_is_dropped_and_reported():
    mixture = plan(fork(weights=(1.0, 1e-12)), deadline=30.0)
    assert "right: dropped, its bound cannot win" in mixture.warnings
    assert mixture.best is not None
    assert mixture.best.label == "left"
    free = plan(fork(weights=(1.0, 1e-12)))
    assert mixture.best.energy == pytest.approx(free.components[0].energy, abs=1e-6)


def test_what_the_check_refuses_drops_nobody():
    """The bound of the right one is far below the left's best optimum, which may not be driven."""

    def right_only(scenario: Scenario, robot: Trajectory, people: People) -> Check:
        found = check(scenario, robot, people)
        wrong = robot.positions[-1, 1] > 0
        return replace(found, problems=("on the left",)) if wrong else found

    scenario = fork("ab", weights=(1.0, 1e-12))
    for deadline in (None, 30.0):
        mixture = plan(scenario, check=right_only, deadline=deadline)
        assert mixture.best is not None
        assert mixture.best.label == "right"
        assert not any("dropped" in warning for warning in mixture.warnings)


@pytest.mark.parametrize("usable", [False, True])
def test_who_may_not_be_followed_and_has_starts_left_when_the_time_is_up_is_unfinished(
    usable, monkeypatch
):
    """All turns are over, and those that were given up wait to be followed."""
    turns, now = [], [0.0]
    monkeypatch.setattr("fgplan.search.perf_counter", lambda: now[0])

    class LastTurn:
        def solve(self, assembly, initial, which, until=np.inf):
            turns.append(len(initial))
            if len(turns) == 3:
                now[0] = 2 * until
            stops = [Stop.CONVERGED] + [Stop.GIVEN_UP] * (len(initial) - 1)
            return tuple(Solution(x, 1.0, 1, s, 0.0) for x, s in zip(initial, stops, strict=True))

    scenario = fork("abc").replace(plans=fork().plans[:1])
    belief = believed(scenario)
    hypotheses = hypothesise(scenario, belief)
    assembly = Assembly(build(scenario, belief, hypotheses))
    ended = search(
        assembly, hypotheses, LastTurn(), until=50.0, usable=lambda which, solution: usable
    )  # fmt: skip
    assert len(turns) == 3
    assert len(ended.found) == len(hypotheses[0].starts)
    assert ended.unfinished == (frozenset() if usable else frozenset({0}))


def test_pruning_keeps_to_the_time():
    """With no time left nobody is solved, so that nobody is left out."""
    long_over, far_off = -np.inf, 1e18
    asked = []

    class Spy:
        def solve(self, assembly, initial, which, until=np.inf):
            asked.append(until)
            return SecondOrder().solve(assembly, initial, which)

    scenario = fork("ab", weights=(1.0, 1e-30))
    belief = believed(scenario)
    hypotheses = hypothesise(scenario, belief)
    assembly = Assembly(build(scenario, belief, hypotheses))
    assert worth_solving(assembly, hypotheses, Spy(), 10.0, long_over) == [0, 1]
    assert asked == []
    assert worth_solving(assembly, hypotheses, Spy(), 10.0, far_off) == [0]
    assert asked == [far_off]


@pytest.mark.parametrize("names", ["", "ab", "abc"])
def test_no_start_ends_below_the_bound(names):
    # Seen to fail with the sign of ½ gᵀH⁻¹g turned in search.py.
    from fgplan.search import _bound

    scenario = fork(names)
    belief = believed(scenario)
    hypotheses = hypothesise(scenario, belief)
    assembly = Assembly(build(scenario, belief, hypotheses))
    for f in search(assembly, hypotheses, SecondOrder(meeting=0.0, patience=np.inf)).found:
        own = assembly.models[f.which].log_normalizer_own
        assert f.solution.energy - own >= _bound(assembly, f.which) - 1e-9


@pytest.mark.parametrize("deadline", [0.0, 1e-4, 1e-2])
def test_no_time_gives_a_checked_plan_or_a_stop_and_says_so(deadline):
    mixture = plan(fork("abc"), deadline=deadline)
    assert mixture.action.kind in {"follow", "stop"}
    assert np.isfinite(mixture.trajectory.states).all()
    if mixture.selected is not None:
        assert mixture.best.feasible
    late = [w for w in mixture.warnings if w.endswith("not finished in time")]
    assert len(late) == sum(not c.finished for c in mixture.components)
    assert late or deadline > 1e-3


def test_enough_time_gives_the_plan_without_a_deadline():
    free, bounded = plan(fork()), plan(fork(), deadline=60.0)
    assert bounded.best is not None
    assert free.best is not None
    assert bounded.best.energy == pytest.approx(free.best.energy, abs=1e-6)


def test_a_warm_start_closes_the_gap_to_where_the_robot_really_is():
    first = plan(fork())
    scenario = fork(now=STEP)
    starts = shifted(first, scenario, believed(scenario))
    assert all(isinstance(s, Start) for s in starts)
    for start, component in zip(starts, first.components, strict=True):
        np.testing.assert_allclose(start.robot.positions[0], scenario.robot.position, atol=1e-12)
        expected = component.robot.at(scenario.density.times[-1] + STEP)[:2]
        np.testing.assert_allclose(start.robot.positions[-1], expected, atol=1e-12)


def crowded() -> tuple[Assembly, tuple[Hypothesis, ...]]:
    """One hypothesis, a person in the way, and starts that end in several optima."""
    scenario = fork("abc")
    belief = believed(scenario)
    hypotheses = hypothesise(scenario, belief)[:1]
    return Assembly(build(scenario, belief, hypotheses)), hypotheses


def test_who_is_given_up_would_have_ended_higher():
    assembly, hypotheses = crowded()
    margin = 0.5
    some = search(assembly, hypotheses, SecondOrder(meeting=0.0, margin=margin)).found
    every = search(assembly, hypotheses, SecondOrder(meeting=0.0, patience=np.inf)).found
    end = {f.rank: f.solution.energy for f in every}
    given_up = [f for f in some if f.solution.stop is Stop.GIVEN_UP]
    assert given_up
    assert min(f.solution.energy for f in some) == pytest.approx(min(end.values()), abs=1e-6)
    for f in given_up:
        assert end[f.rank] > min(end.values()) + margin
        assert f.solution.energy >= end[f.rank] - 1e-9


def test_who_was_given_up_is_followed_where_nothing_better_is_of_use():
    assembly, hypotheses = crowded()
    solver = SecondOrder(meeting=0.0, margin=0.5)
    lowest = min(f.solution.energy for f in search(assembly, hypotheses, solver).found)
    every = search(assembly, hypotheses, SecondOrder(meeting=0.0, patience=np.inf)).found
    higher = min(f.solution.energy for f in every if f.solution.energy > lowest + 0.5)

    def usable(which: int, solution: Solution) -> bool:
        return solution.energy > lowest + 0.5

    found = search(assembly, hypotheses, solver, usable=usable).found
    assert sorted(f.rank for f in found) == sorted(f.rank for f in every)
    best = min((f for f in found if usable(0, f.solution)), key=lambda f: f.solution.energy)
    assert best.solution.converged
    assert best.solution.energy == pytest.approx(higher, abs=1e-6)


def test_turns_under_a_deadline_find_what_all_at_once_find():
    assembly, hypotheses = crowded()
    solver = SecondOrder(margin=0.0)
    together = search(assembly, hypotheses, solver)
    in_turns = search(assembly, hypotheses, solver, until=1e12)  # finite, and never
    assert [f.rank for f in sorted(in_turns.found, key=lambda f: f.rank)] == list(
        range(len(hypotheses[0].starts))
    )
    assert min(f.solution.energy for f in in_turns.found) == pytest.approx(
        min(f.solution.energy for f in together.found), abs=1e-6
    )


def test_a_warm_start_keeps_what_was_planned_for_people_relative_to_where_they_go():
    first = plan(fork("ab"))
    scenario = fork("abc", now=STEP)
    belief = believed(scenario)
    times = scenario.density.times
    prediction = belief.predict(times)[0]
    for start, component in zip(shifted(first, scenario, belief), first.components, strict=True):
        assert set(start.crowd) == {"a", "b"}
        for name, person in start.crowd.items():
            i = belief.names.index(name)
            np.testing.assert_allclose(person.states[0], belief.mean[i], atol=1e-12)
            planned = component.crowd[name].at(times + STEP)
            straight = planned[0, :2] + times[:, None] * planned[0, 2:]
            np.testing.assert_allclose(
                person.positions - prediction[:, i, :2], planned[:, :2] - straight, atol=1e-9
            )


@pytest.mark.parametrize("model", [Holonomic(), DifferentialDrive()])
def test_a_warm_start_where_nothing_changed_is_the_plan(model):
    """Also with wheels, whose headings are a part of it."""
    scenario = fork("").replace(robot=Robot(np.zeros(2), np.array([0.8, 0.0]), model=model))
    first = plan(scenario)
    assert first.best is not None
    belief = believed(scenario)
    hypotheses = hypothesise(scenario, belief)
    assembly = Assembly(build(scenario, belief, hypotheses))
    best = first.best
    i = next(i for i, h in enumerate(hypotheses) if h.label == best.label)
    start = shifted(first, scenario, belief)[first.selected]
    state = assembly.models[i].initial(start)
    energy = float(assembly.energy(state[None], np.array([i]))[0])
    assert energy - assembly.models[i].log_normalizer_own == pytest.approx(best.energy, abs=1e-3)
