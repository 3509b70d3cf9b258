"""Interaction and contact between all pairs and all steps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.contact import Contact
from factors.interaction import Interaction
from factors.pairwise import CrowdPairs, PredictedPairs, pair_index
from tests.factor_testing import check_derivatives


def bodies(seed, n, spread=1.0):
    rng = np.random.default_rng(seed)
    return spread * rng.normal(size=4), spread * rng.normal(size=4 * n)


@pytest.mark.parametrize("pairs", ["all", "robot"])
@pytest.mark.parametrize("n", [1, 2, 4])
@pytest.mark.parametrize(
    "potential", [Interaction(0.99, 0.5, 0.5), Contact(2.5, 0.2, 0.25)], ids=["psi", "contact"]
)
def test_derivatives_of_a_crowd(potential, n, pairs):
    check_derivatives(CrowdPairs(potential, n, pairs), *bodies(n, n), atol=1e-5)


def test_derivatives_with_predicted_people():
    rng = np.random.default_rng(0)
    S, n = 4, 3
    interaction = Interaction(0.9, 0.4, variance=rng.uniform(0.1, 1, (S, n)))
    people = rng.normal(size=(S, n, 2))
    check_derivatives(PredictedPairs(interaction, people), rng.normal(size=(S, 4)))
    contact = Contact(np.array([0.8, 1.5, 3.0]), 0.3)
    check_derivatives(PredictedPairs(contact, people), rng.normal(size=(S, 4)), atol=1e-5)


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 5), st.floats(0, 1), st.floats(0.05, 3), st.integers(0, 1000))
def test_energy_is_the_sum_over_pairs_one_by_one(n, alpha, h_c, seed):
    robot, crowd = bodies(seed, n)
    points = np.vstack([robot[:2], crowd[: 2 * n].reshape(n, 2)])
    expected = 0.0
    for i in range(n + 1):
        for j in range(i + 1, n + 1):
            d2 = np.sum((points[i] - points[j]) ** 2)
            expected -= np.log(1 - alpha * np.exp(-d2 / (2 * h_c**2)))
    found = CrowdPairs(Interaction(alpha, h_c), n).energy(robot, crowd)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_held_people_are_the_robot_pairs_of_a_crowd():
    robot, crowd = bodies(7, 3)
    for potential in (Interaction(0.95, 0.7), Contact(1.5, 0.4)):
        joint = CrowdPairs(potential, 3, "robot").energy(robot, crowd)
        held = PredictedPairs(potential, crowd[:6].reshape(3, 2)).energy(robot)
        assert joint == pytest.approx(float(held), rel=1e-12)


def test_uncertainty_of_a_prediction_widens_the_interaction():
    people, robot = np.zeros((1, 2)), np.array([1.0, 0, 0, 0])
    wide = Interaction(0.9, 0.3, variance=np.array([0.16]))
    assert PredictedPairs(wide, people).energy(robot) == pytest.approx(
        float(PredictedPairs(Interaction(0.9, 0.5), people).energy(robot))
    )


def test_mirrored_bodies_have_mirrored_gradients():
    robot, crowd = bodies(3, 2)
    mirror = np.array([1.0, -1.0])
    psi = CrowdPairs(Interaction(), 2)
    one = psi.expand(robot, crowd)
    other = psi.expand(
        (robot.reshape(2, 2) * mirror).ravel(), (crowd.reshape(4, 2) * mirror).ravel()
    )
    np.testing.assert_allclose(one.energy, other.energy)
    np.testing.assert_allclose(
        (one.gradient.reshape(3, 2) * mirror).ravel(), other.gradient, atol=1e-12
    )


@pytest.mark.parametrize("potential", [Interaction(1.0, 0.5), Interaction(0.99), Contact(0.6, 0.1)])
@pytest.mark.parametrize("d", [0.0, 1e-9, 1e3, 1e6])
def test_coincident_and_distant_bodies_give_numbers(potential, d):
    people = np.zeros((1, 2))
    pairs = PredictedPairs(potential, people)
    robot = np.array([d, 0.0, 0.0, 0.0])
    e, (J,) = pairs.linearize(robot)
    energy, gradient, hessian = pairs.expand(robot)
    assert not np.isnan(np.concatenate([e, J.ravel(), [energy], gradient.ravel()])).any()
    assert not np.isnan(hessian).any()
    if d >= 1e3:
        assert energy == 0
        assert np.all(J == 0)


def test_contact_stops_at_its_reach():
    contact = Contact(np.array([0.8]), 0.1)
    assert contact.energy(np.array([0.8**2]))[0] == pytest.approx(0, abs=1e-9)
    assert contact.energy(np.array([0.7**2]))[0] == pytest.approx(0.5, rel=1e-4)
    assert contact.energy(np.array([0.9**2]))[0] == 0


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Interaction(1.2), "alpha must lie"),
        (lambda: Interaction(0.5, 0.0), "h_c must be positive"),
        (lambda: Interaction(0.5, 1.0, -1.0), "weight must be positive"),
        (lambda: Interaction(0.5, 1.0, 1.0, np.array([-0.1])), "variance must not be negative"),
        (lambda: Contact(-0.1, 0.1), "reach must not be negative"),
        (lambda: Contact(0.6, 0.0), "sigma must be positive"),
        (lambda: pair_index(0, "all"), "at least one person"),
    ],
)
def test_bad_parameters_are_named(make, says):
    with pytest.raises(ValueError, match=says):
        make()
