"""Weighted, timed global plans: weights from costs, weights as stated, and no goal at all."""

from __future__ import annotations

import numpy as np
import pytest

from fgplan import Density, GivenPlan, NoRoute, Robot, Scenario, plan
from fgplan.hypotheses import hypothesise
from tests.scenes import believed, blocks, fork, forked, track

TABLE_32 = {10.0: 0.729736, 10.5: 0.268455, 13.0: 0.001809}
"""Statement 32 of the acceptance list: J [s] and weight, beta = 2."""


def of_length(length: float, weight: float | None = None) -> GivenPlan:
    """A triangle of this length over the ten metres from (0, 0) to (10, 0)."""
    height = np.sqrt((length / 2) ** 2 - 25)
    path = np.array([[0.0, 0.0], [5.0, height], [10.0, 0.0]])
    return GivenPlan(f"{length} m", path, weight)


def weights(scenario: Scenario) -> dict[str, float]:
    return {h.label: np.exp(h.log_prior) for h in hypothesise(scenario, believed(scenario))}


def test_32_weights_are_the_softmax_of_the_costs():
    # Seen to fail with beta = 0.7.
    plans = tuple(of_length(length) for length in TABLE_32)
    found = weights(forked(plans=plans, density=Density(beta=2.0)))
    for length, weight in TABLE_32.items():
        assert found[f"{length} m"] == pytest.approx(weight, abs=5e-7)


def test_cost_is_in_seconds_at_the_preferred_speed():
    plans = tuple(of_length(length) for length in TABLE_32)
    robot = Robot(np.zeros(2), preferred_speed=0.5)
    scenario = forked(plans=plans, density=Density(beta=1.0)).replace(robot=robot)
    hypotheses = hypothesise(scenario, believed(scenario))
    assert [h.cost for h in hypotheses] == pytest.approx([20.0, 21.0, 26.0])
    for length, weight in TABLE_32.items():
        assert weights(scenario)[f"{length} m"] == pytest.approx(weight, abs=5e-7)


def test_beta_zero_makes_all_plans_alike():
    plans = tuple(of_length(length) for length in TABLE_32)
    found = weights(forked(plans=plans, density=Density(beta=0.0)))
    assert list(found.values()) == pytest.approx([1 / 3] * 3)


@pytest.mark.parametrize("scale", [1.0, 1e-9, 1e9])
def test_stated_weights_are_normalised(scale):
    found = weights(forked(plans=fork(3.0 * scale, 1.0 * scale)))
    assert found == pytest.approx({"left": 0.75, "right": 0.25})


def test_a_weight_of_one_is_as_good_as_the_shortest_path():
    plans = (of_length(10.0), of_length(10.5), of_length(13.0, weight=1.0))
    found = weights(forked(plans=plans, density=Density(beta=2.0)))
    assert found["13.0 m"] == pytest.approx(found["10.0 m"])
    assert found["10.5 m"] == pytest.approx(found["10.0 m"] * np.exp(-2 * 0.5))


def test_a_weight_of_zero_excludes_a_plan():
    assert weights(forked(plans=fork(1.0, 0.0))) == {"left": 1.0}


def test_weights_sum_to_one_beside_generated_plans():
    scenario = forked(grid=blocks(), goal=np.array([8.0, 0.0]), count=2, plans=fork(1.0, None))
    found = weights(scenario)
    assert set(found) >= {"left", "right"}
    assert len(found) > 2
    assert sum(found.values()) == pytest.approx(1.0)


def test_a_path_begins_where_the_robot_is():
    away = GivenPlan("away", np.array([[3.0, 4.0], [6.0, 4.0]]))
    scenario = forked(plans=(away,))
    (found,) = hypothesise(scenario, believed(scenario))
    np.testing.assert_array_equal(found.route, [[0, 0], [3, 4], [6, 4]])
    assert found.cost == pytest.approx(8.0)
    np.testing.assert_array_equal(found.plan.positions[0], [0, 0])


def test_every_plan_is_timed_over_the_horizon():
    scenario = forked()
    for hypothesis in hypothesise(scenario, believed(scenario)):
        np.testing.assert_array_equal(hypothesis.plan.times, scenario.density.times)
        speed = np.linalg.norm(hypothesis.plan.velocities, axis=1)
        assert speed.max() <= scenario.robot.preferred_speed + 1e-12


def test_no_goal_is_one_hypothesis_without_a_plan():
    scenario = Scenario(Robot(np.zeros(2), np.array([0.5, 0.2])))
    (found,) = hypothesise(scenario, believed(scenario))
    assert found.plan is None
    assert found.route is None
    assert found.log_prior == 0.0
    assert found.cost == 0.0


@pytest.mark.parametrize("crowd", ["joint", "predicted"])
def test_no_goal_and_nobody_near_plans_the_prior_mean(crowd):
    """Statement 11 of the density's decisions: no phantom goal."""
    robot = Robot(np.array([1.0, -1.0]), np.array([0.5, 0.2]))
    scenario = Scenario(robot, tracks=(track("far", 40.0, 40.0),), crowd=crowd)
    best = plan(scenario).best
    t = scenario.density.times[:, None]
    np.testing.assert_allclose(best.robot.positions, robot.position + t * robot.velocity, atol=1e-8)
    np.testing.assert_allclose(best.robot.velocities, np.tile(robot.velocity, (13, 1)), atol=1e-8)
    assert best.energy == pytest.approx(0.0, abs=1e-9)


def test_no_goal_among_people_still_avoids_them():
    robot = Robot(np.zeros(2), np.array([0.8, 0.0]), max_speed=2.0)
    scenario = Scenario(robot, tracks=(track("a", 2.5, 0.1),), crowd="predicted")
    assert plan(scenario).best.check.min_separation > 0.55


def test_an_unreachable_goal_is_no_hypothesis():
    scenario = forked(grid=blocks(), goal=np.array([4.0, 0.0]), count=1, plans=())
    with pytest.raises(NoRoute):
        hypothesise(scenario, believed(scenario))


@pytest.mark.parametrize("speed", [0.0, 0.4, 1.0])
def test_a_goal_is_passed_at_its_speed(speed):
    robot = Robot(np.zeros(2), np.array([1.0, 0.0]))
    scenario = Scenario(robot, np.array([2.0, 0.0]), goal_speed=speed, density=Density(horizon=6.0))
    (only,) = hypothesise(scenario, believed(scenario))
    end = only.plan.at(6.0)
    assert end[2:] == pytest.approx([speed, 0.0])
    assert end[0] == pytest.approx(2.0) if speed == 0 else end[0] > 2.0 + 2 * speed
