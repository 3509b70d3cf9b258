"""From a scenario to a mixture and an action."""

from __future__ import annotations

import json
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgplan import (
    Density,
    GivenPlan,
    GtsamLM,
    Level,
    Mixture,
    OccupancyGrid,
    Robot,
    Scenario,
    Track,
    keys,
    plan,
    selection,
)
from fgplan.crowd import Belief, believe
from fgplan.hypotheses import hypothesise
from fgplan.hypothesis import Hypothesis
from fgplan.safety import Check, People, check
from fgplan.trajectory import Trajectory
from tests.scenes import CORRIDOR, blocks, fork, forked, random_scene, track

STRAIGHT = GivenPlan("straight", np.array([[0.0, 0.0], [8.0, 0.0]]))


def components(mixture: Mixture) -> dict[str, object]:
    return {component.label: component for component in mixture.components}


def softmax(scores: np.ndarray) -> np.ndarray:
    weights = np.exp(scores - np.max(scores))
    return weights / weights.sum()


SCENES = {
    "alone": forked(),
    "among people": random_scene(1, 3),
    "predicted people on a map": random_scene(2, 2, True, crowd="predicted"),
    "random level": random_scene(3, 2, levels=(CORRIDOR,)),
    "no goal": forked(track("a", 4.0, 1.0), plans=()),
    "boxed in": forked(track("a", 0.3, 0.0), track("b", 0.0, 0.3), track("c", -0.3, -0.2)),
}


def strict(text: str) -> None:
    raise AssertionError(f"{text} is not JSON")


@pytest.mark.parametrize("name", SCENES)
def test_the_dictionary_is_strict_json(name):
    data = plan(SCENES[name]).to_dict()
    text = json.dumps(data, allow_nan=False)
    assert json.loads(text, parse_constant=strict) == data


def test_the_dictionary_says_everything_it_must():
    scenario = random_scene(3, 2, True, levels=(CORRIDOR,))
    data = plan(scenario).to_dict()
    assert {"selected", "action", "timing", "hypotheses"} <= set(data)
    for hypothesis in data["hypotheses"]:
        assert {
            "label", "log_prior", "energy", "log_evidence", "probability_height",
            "probability_mass", "converged", "iterations", "min_separation", "clearance",
            "feasible", "robot", "crowd", "levels",
        } <= set(hypothesis)  # fmt: skip
        assert np.shape(hypothesis["robot"]) == (13, 5)
        np.testing.assert_allclose(np.array(hypothesis["robot"])[:, 0], scenario.density.times)
        assert set(hypothesis["crowd"]) == {"p0", "p1"}
        assert np.shape(hypothesis["crowd"]["p0"]) == (13, 5)
        assert np.shape(hypothesis["levels"]["corridor"]) == (13, 5)
    assert data["selected"] in {hypothesis["label"] for hypothesis in data["hypotheses"]}


@pytest.mark.parametrize("name", SCENES)
def test_probabilities_are_the_softmax_of_the_scores(name):
    mixture = plan(SCENES[name])
    prior = np.array([c.log_prior for c in mixture.components])
    energy = np.array([c.energy for c in mixture.components])
    np.testing.assert_allclose(mixture.probability_height, softmax(prior - energy), rtol=1e-12)
    if all(c.log_evidence is not None for c in mixture.components):
        evidence = np.array([c.log_evidence for c in mixture.components])
        np.testing.assert_allclose(mixture.probability_mass, softmax(prior + evidence), rtol=1e-12)
        assert mixture.probability_mass.sum() == pytest.approx(1)


def test_components_come_best_first_and_the_best_feasible_one_is_selected():
    for seed in range(6):
        mixture = plan(random_scene(seed, 3))
        scores = [c.log_prior - c.energy for c in mixture.components]
        assert scores == sorted(scores, reverse=True)
        first = next(i for i, c in enumerate(mixture.components) if c.feasible)
        assert mixture.selected == first
        assert mixture.best is mixture.components[first]
        np.testing.assert_array_equal(mixture.trajectory.states, mixture.best.robot.states)


def test_the_action_is_the_next_state_of_the_selected_plan():
    mixture = plan(SCENES["among people"])
    action = mixture.action
    assert action.kind == "follow"
    assert action.safe
    assert action.time == 0.4
    np.testing.assert_array_equal(action.position, mixture.best.robot.positions[1])
    np.testing.assert_array_equal(action.velocity, mixture.best.robot.velocities[1])
    assert mixture.best.label in action.reason


def test_plans_that_end_in_one_optimum_are_merged_and_their_weights_add():
    left, right = fork(2.0, 3.0)
    twin = GivenPlan("twin", left.path, 5.0)
    mixture = plan(forked(track("a", 3.0, -1.0), plans=(left, right, twin)))
    found = components(mixture)
    assert set(found) == {"left+twin", "right"}
    assert np.exp(found["left+twin"].log_prior) == pytest.approx(0.7)
    once = components(plan(forked(track("a", 3.0, -1.0), plans=fork(7.0, 3.0))))
    assert found["left+twin"].energy == pytest.approx(once["left"].energy, abs=1e-9)
    height = dict(zip(found, mixture.probability_height, strict=True))
    expected = dict(zip(once, plan(forked(track("a", 3.0, -1.0), plans=fork(7.0, 3.0)))
                        .probability_height, strict=True))  # fmt: skip
    assert height["left+twin"] == pytest.approx(expected["left"], abs=1e-9)


def test_three_plans_of_one_optimum_make_one_component():
    plans = tuple(replace(STRAIGHT, label=name) for name in "abc")
    mixture = plan(forked(plans=plans))
    assert [c.label for c in mixture.components] == ["a+b+c"]
    assert mixture.components[0].log_prior == pytest.approx(0.0, abs=1e-12)


def test_plans_that_differ_beyond_the_horizon_only_are_one():
    far = tuple(
        GivenPlan(name, np.array([[0.0, 0.0], [20.0, 0.0], [30.0, y]]), 1.0)
        for name, y in (("up", 5.0), ("down", -5.0))
    )
    assert [c.label for c in plan(forked(plans=far)).components] == ["up+down"]


def disagreeing() -> Scenario:
    """Two plans alike but for their widths in number: the left one is passed on either side of
    somebody, which adds a second mode and thus mass, but no height."""
    return forked(
        track("a", 4.0, 1.5), track("b", 4.5, -1.45, 0.0, 0.0), plans=fork(1.0, 1.0),
        crowd="predicted",
    )  # fmt: skip


def between(scenario: Scenario) -> Scenario:
    """The weights set such that height prefers one plan and mass the other, by half of the
    distance between where each of them flips."""
    found = components(plan(scenario))
    height = found["right"].energy - found["left"].energy
    mass = found["left"].log_evidence - found["right"].log_evidence
    assert abs(height - mass) > 0.02
    # At log w_left − log w_right = −(height + mass)/2 the two rules point apart.
    return scenario.replace(plans=fork(float(np.exp(-(height + mass) / 2)), 1.0))


def test_mass_and_height_can_disagree_and_the_rule_decides():
    scenario = between(disagreeing())
    by_height, by_mass = plan(scenario), plan(scenario, select=selection.mass)
    assert by_height.best.label != by_mass.best.label
    assert by_height.best is by_height.components[int(np.argmax(by_height.probability_height))]
    assert by_mass.best is by_mass.components[int(np.argmax(by_mass.probability_mass))]
    assert any("mass prefers" in warning for warning in by_height.warnings)
    # Both are always reported, and neither depends on the rule.
    for label, component in components(by_height).items():
        other = components(by_mass)[label]
        assert component.energy == other.energy
        assert component.log_evidence == other.log_evidence


def test_a_users_prior_bends_the_plan():
    wish = np.array([1.8, 0.7, 0.9, 0.2])
    tight = gtsam.noiseModel.Isotropic.Sigma(4, 0.01)
    factor = gtsam.PriorFactorVector(keys.robot(5), wish, tight)
    before = plan(forked(plans=(STRAIGHT,)))
    after = plan(forked(plans=(STRAIGHT,)), factors=[factor])
    assert np.abs(before.best.robot.states[5] - wish).max() > 0.5
    # Within reach of the robot: all that holds it back is a few of the prior's sigmas.
    np.testing.assert_allclose(after.components[0].robot.states[5], wish, atol=0.02)
    assert after.components[0].energy > before.best.energy


def test_a_users_factor_may_be_a_generator():
    """`factors` is any iterable, also one that can be read only once."""
    noise = gtsam.noiseModel.Isotropic.Sigma(4, 0.1)
    wish = np.array([1.8, 0.3, 0.9, 0.1])
    one = plan(forked(), factors=[gtsam.PriorFactorVector(keys.robot(5), wish, noise)])
    other = plan(
        forked(), factors=(gtsam.PriorFactorVector(keys.robot(5), wish, noise) for _ in range(1))
    )
    np.testing.assert_array_equal(one.trajectory.states, other.trajectory.states)


def test_a_users_factor_can_change_the_choice():
    right = np.array([2.0, -0.8, 0.8, -0.3])
    factor = gtsam.PriorFactorVector(keys.robot(6), right, gtsam.noiseModel.Isotropic.Sigma(4, 0.3))
    scenario = forked(plans=fork(1.2, 1.0))
    assert plan(scenario).best.label == "left"
    assert plan(scenario, factors=[factor]).best.label == "right"


@pytest.mark.parametrize("solver", [None, GtsamLM()], ids=["second order", "gtsam"])
def test_a_factor_between_steps_that_are_no_neighbours_makes_a_plan(solver):
    """Any GTSAM factor of the user's works: here one that wants the robot to be where it was."""
    noise = gtsam.noiseModel.Isotropic.Sigma(4, 0.1)
    factor = gtsam.BetweenFactorVector(keys.robot(3), keys.robot(7), np.zeros(4), noise)
    mixture = plan(forked(), factors=[factor], **({} if solver is None else {"solver": solver}))
    states = mixture.components[0].robot.states
    assert np.linalg.norm(states[7, :2] - states[3, :2]) < 0.5
    free = plan(forked()).components[0].robot.states
    assert np.linalg.norm(free[7, :2] - free[3, :2]) > 1.0


@pytest.mark.parametrize("seed", range(4))
def test_people_held_at_their_prediction_are_not_displaced(seed):
    held = plan(random_scene(seed, 3, crowd="predicted"))
    joint = plan(random_scene(seed, 3))
    assert all(d == 0 for c in held.components for d in c.displacement.values())
    assert all(set(c.displacement) == {"p0", "p1", "p2"} for c in held.components)
    assert all(max(c.displacement.values()) > 0 for c in joint.components)


def test_who_makes_room_is_reported():
    """One stands in the way, one far off: the first yields, the other does not."""
    people = (track("near", 2.5, 0.3), track("far", 30.0, 30.0))
    best = plan(forked(*people, plans=(STRAIGHT,))).components[0]
    assert best.displacement["near"] > 0.01
    assert best.displacement["far"] < 1e-8


def test_passing_sides_are_named():
    best = plan(forked(track("a", 2.5, -0.9), plans=(STRAIGHT,), crowd="predicted")).best
    assert best.sides == {"a": "right"}
    best = plan(forked(track("a", 2.5, 0.9), plans=(STRAIGHT,), crowd="predicted")).best
    assert best.sides == {"a": "left"}


def walled() -> OccupancyGrid:
    """A wall across the left branch of the fork."""
    wall = np.array([[2.0, 0.7], [2.2, 0.7], [2.2, 3.9], [2.0, 3.9]])
    return OccupancyGrid.from_polygons([wall], (-2, -4, 10, 4), 0.1)


def test_an_infeasible_best_hypothesis_is_flagged_and_the_next_is_taken():
    # Seen to fail without the hard check: the obstacle hinge alone is off here.
    density = Density(obstacle_sigma=np.inf)
    mixture = plan(forked(plans=fork(5.0, 1.0), grid=walled(), density=density))
    first, second = mixture.components
    assert first.label == "left"
    assert not first.feasible
    assert any("obstacle" in problem for problem in first.check.problems)
    assert mixture.best is second
    assert second.label == "right"
    assert second.feasible
    assert mixture.action.kind == "follow"
    np.testing.assert_array_equal(mixture.action.position, second.robot.positions[1])


def test_when_no_hypothesis_is_safe_the_action_is_a_stop_that_says_why():
    across = np.array([[1.5, -3.9], [1.7, -3.9], [1.7, 3.9], [1.5, 3.9]])
    grid = OccupancyGrid.from_polygons([across], (-2, -4, 10, 4), 0.1)
    mixture = plan(forked(grid=grid, density=Density(obstacle_sigma=np.inf)))
    assert mixture.selected is None
    assert mixture.best is None
    assert mixture.to_dict()["selected"] is None
    action = mixture.action
    assert action.kind == "stop"
    assert action.safe
    for label in ("left", "right"):
        assert label in action.reason
    assert "obstacle" in action.reason
    # 0.8²/(2·1.5) = 0.21 m to a standstill.
    np.testing.assert_allclose(mixture.trajectory.positions[-1], [0.8**2 / 3, 0.0], atol=1e-9)
    np.testing.assert_array_equal(action.position, mixture.trajectory.positions[1])


def test_a_stop_that_is_not_clear_either_says_so():
    rush = forked(track("a", 1.2, 0.0, -2.0, 0.0), track("b", 0.0, 0.9, 0.0, -0.5),
                  track("c", 0.0, -0.9, 0.0, 0.5), track("d", -0.9, 0.0, 0.5, 0.0),
                  crowd="predicted")  # fmt: skip
    mixture = plan(rush)
    assert mixture.action.kind == "stop"
    assert not mixture.action.safe
    assert "no stop is clear" in mixture.action.reason
    assert np.isfinite(mixture.trajectory.states).all()


def mirrored(scenario: Scenario) -> Scenario:
    flip = np.array([1.0, -1.0])
    tracks = tuple(
        Track(t.identity, t.times, t.positions * flip, t.radius) for t in scenario.tracks
    )
    robot = replace(
        scenario.robot, position=scenario.robot.position * flip,
        velocity=scenario.robot.velocity * flip,
    )  # fmt: skip
    swap = {"left": "right", "right": "left"}
    plans = tuple(GivenPlan(swap[p.label], p.path * flip, p.weight) for p in scenario.plans)
    return scenario.replace(robot=robot, tracks=tracks, plans=plans)


@pytest.mark.parametrize("crowd", ["joint", "predicted"])
@pytest.mark.parametrize("seed", range(4))
def test_a_mirrored_scenario_swaps_left_and_right(seed, crowd):
    scenario = random_scene(seed, 3, crowd=crowd)
    one, other = plan(scenario), plan(mirrored(scenario))
    swap = {"left": "right", "right": "left"}
    twins = components(other)
    for label, component in components(one).items():
        twin = twins[swap[label]]
        assert twin.energy == pytest.approx(component.energy, abs=1e-6)
        assert twin.log_evidence == pytest.approx(component.log_evidence, abs=1e-4)
        assert twin.sides == {name: swap[side] for name, side in component.sides.items()}
        np.testing.assert_allclose(
            twin.robot.states, component.robot.states * [1, -1, 1, -1], atol=1e-4
        )
    assert swap[one.best.label] == other.best.label


def moved(scenario: Scenario, angle: float, shift: np.ndarray) -> Scenario:
    """The whole scenario turned about the origin and shifted."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, s], [-s, c]])  # on rows
    robot = replace(
        scenario.robot, position=scenario.robot.position @ R + shift,
        velocity=scenario.robot.velocity @ R,
    )  # fmt: skip
    tracks = tuple(
        Track(t.identity, t.times, t.positions @ R + shift, t.radius) for t in scenario.tracks
    )
    plans = tuple(GivenPlan(p.label, p.path @ R + shift, p.weight) for p in scenario.plans)
    return scenario.replace(robot=robot, tracks=tracks, plans=plans)


@settings(max_examples=10, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 50),
    angle=st.floats(-3.1, 3.1),
    shift=st.tuples(st.floats(-100, 100), st.floats(-100, 100)),
    crowd=st.sampled_from(["joint", "predicted"]),
)
def test_a_moved_scenario_moves_the_plan(seed, angle, shift, crowd):
    scenario, shift = random_scene(seed, 2, crowd=crowd), np.array(shift)
    one, other = plan(scenario), plan(moved(scenario, angle, shift))
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, s], [-s, c]])
    found = components(other)
    for label, component in components(one).items():
        assert found[label].energy == pytest.approx(component.energy, abs=1e-5)
        np.testing.assert_allclose(
            found[label].robot.positions, component.robot.positions @ R + shift, atol=1e-3
        )
        np.testing.assert_allclose(
            found[label].robot.velocities, component.robot.velocities @ R, atol=1e-3
        )


@pytest.mark.parametrize("name", SCENES)
def test_planning_twice_is_bit_identical(name):
    one, other = plan(SCENES[name]), plan(SCENES[name])
    np.testing.assert_array_equal(one.trajectory.states, other.trajectory.states)
    for a, b in zip(one.components, other.components, strict=True):
        assert (a.label, a.energy, a.log_evidence) == (b.label, b.energy, b.log_evidence)
        np.testing.assert_array_equal(a.robot.states, b.robot.states)


@pytest.mark.parametrize(
    ("seed", "people", "grid", "crowd"),
    [(0, 0, True, "joint"), (1, 1, True, "predicted"), (2, 2, False, "joint"),
     (4, 3, False, "predicted"), (5, 1, True, "joint")],
)  # fmt: skip
def test_both_solvers_select_the_same(seed, people, grid, crowd):
    scenario = random_scene(seed, people, grid, crowd=crowd)
    ours, theirs = plan(scenario), plan(scenario, solver=GtsamLM())
    assert ours.best.label == theirs.best.label
    assert ours.best.energy == pytest.approx(theirs.best.energy, abs=1e-5)
    np.testing.assert_allclose(ours.best.robot.states, theirs.best.robot.states, atol=1e-2)


def test_hypotheses_may_come_from_elsewhere():
    def only_right(scenario: Scenario, belief: Belief) -> tuple[Hypothesis, ...]:
        return tuple(h for h in hypothesise(scenario, belief) if h.label == "right")

    mixture = plan(forked(plans=fork(9.0, 1.0)), hypotheses=only_right)
    assert [c.label for c in mixture.components] == ["right"]


def test_the_scenario_is_left_as_it_was():
    scenario = random_scene(2, 2, True)
    before = scenario.robot.state.copy(), scenario.tracks[0].positions.copy()
    plan(scenario)
    np.testing.assert_array_equal(scenario.robot.state, before[0])
    np.testing.assert_array_equal(scenario.tracks[0].positions, before[1])


def test_generated_and_given_plans_stand_side_by_side():
    scenario = forked(goal=np.array([8.0, 0.0]), count=2, grid=blocks())
    labels = {label for c in plan(scenario).components for label in c.label.split("+")}
    assert {"left", "right", "A"} <= labels


def test_an_uncertain_robot_is_drawn_to_its_plan():
    """The first state is then a variable, and its prior is what the covariance says."""
    path = (GivenPlan("beside", np.array([[0.0, 0.0], [0.01, 1.0], [8.0, 1.0]])),)
    robot = Robot(np.zeros(2), np.array([0.8, 0.0]), covariance=np.diag([0.5, 0.5, 0.2, 0.2]) ** 2)
    scenario = forked(plans=path, levels=(Level(h=0.05),))
    exact = plan(scenario).components[0].robot.states[0]
    loose = plan(scenario.replace(robot=robot)).components[0].robot.states[0]
    np.testing.assert_array_equal(exact, [0, 0, 0.8, 0])
    assert np.abs(loose - exact).max() > 0.02


def test_of_a_hypothesis_optima_the_one_with_the_better_grade_is_followed():
    """A person straight ahead is passed on either side; a check that grades one side down is
    obeyed, though the optimum on the other has the higher energy."""
    scenario = Scenario(Robot(np.zeros(2), np.array([1.0, 0.0])), np.array([6.0, 0.0]))
    scenario = scenario.replace(tracks=(track("p", 3.0, 0.03),), crowd="predicted", count=1)
    free = plan(scenario).components[0]

    def other_side(scenario: Scenario, robot: Trajectory, people: People) -> Check:
        found = check(scenario, robot, people)
        lies = float(np.sign(robot.at(3.0)[1]))
        return replace(found, grade=int(lies == np.sign(free.robot.at(3.0)[1])))

    graded = plan(scenario, check=other_side).components[0]
    assert free.check.grade == graded.check.grade == 0
    assert graded.feasible
    assert free.robot.at(3.0)[1] * graded.robot.at(3.0)[1] < 0
    assert graded.energy >= free.energy
    assert graded.lowest == pytest.approx(free.lowest, abs=1e-6)


def test_a_belief_of_the_callers_replaces_the_tracks():
    scenario = forked(track("anna", 4.0, 0.4, -0.8), track("ben", 5.0, -1.0))
    d = scenario.density
    belief = believe(scenario.tracks, scenario.now, d.Qc_people, d.sigma_track, d.sigma_speed)
    given = plan(scenario.replace(tracks=()), belief=belief)
    expected = plan(scenario)
    np.testing.assert_array_equal(given.trajectory.states, expected.trajectory.states)
    np.testing.assert_array_equal(given.probability_height, expected.probability_height)
