"""People are followed as the density means them, however they are detected."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgplan import Track
from fgplan.crowd import believe
from fgplan.driving import Detection
from fgplan.driving.tracking import People, Tracker, Tracking

TRACKER = Tracker(Qc=0.03, sigma_track=0.04, sigma_speed=1.5)


def everywhere(points):
    return np.ones(len(points), dtype=bool)


def nowhere(points):
    return np.zeros(len(points), dtype=bool)


def followed(times, positions, identity=None, tracker=TRACKER):
    """One person, detected at (m, 2) positions."""
    people = People(time=times[0])
    for t, p in zip(times, positions, strict=True):
        people, _ = tracker.update(people, t, [Detection(p, identity)], everywhere)
    return people


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_the_filter_is_the_posterior_of_the_whole_track(seed):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.05, 0.5, 8))
    positions = np.outer(times, rng.normal(size=2)) + 0.04 * rng.standard_normal((8, 2))
    loose = Tracker(0.03, 0.04, 1.5, Tracking(jump=100.0))
    people = loose.predict(followed(times, positions, "anna", loose), times[-1] + 0.3)
    expected = believe([Track("anna", times, positions)], times[-1] + 0.3, 0.03, 0.04, 1.5)
    belief = people.belief(0.03)
    np.testing.assert_allclose(belief.mean, expected.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(belief.covariance, expected.covariance, rtol=1e-9, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 7))
def test_who_was_seen_before_is_followed_on(seed, before):
    """Half of a track told at first, the rest detected: the same as all of it, also where the
    last of the track is detected once more."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.05, 0.5, 8))
    positions = np.outer(times, rng.normal(size=2)) + 0.04 * rng.standard_normal((8, 2))
    loose = Tracker(0.03, 0.04, 1.5, Tracking(jump=100.0))
    known = Track("anna", times[:before], positions[:before], 0.2)
    people = loose.recall([known], times[before - 1])
    assert people.radii.tolist() == [0.2]
    for t, p in zip(times[before - 1 :], positions[before - 1 :], strict=True):
        people, _ = loose.update(people, t, [Detection(p, "anna", 0.2)], everywhere)
    expected = believe([Track("anna", times, positions)], times[-1], 0.03, 0.04, 1.5)
    np.testing.assert_allclose(people.belief(0.03).mean, expected.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(people.belief(0.03).covariance, expected.covariance, atol=1e-12)


def test_a_detected_velocity_is_a_measurement_of_it():
    detection = Detection(np.array([1.0, 2.0]), "anna", velocity=np.array([0.6, -0.8]))
    people = People(time=0.0)
    people, _ = TRACKER.update(people, 0.0, [detection], everywhere)
    once = people.mean[0].copy()
    people, _ = TRACKER.update(people, 0.1, [detection], everywhere)
    prior, noise = 1.5**2, 0.05**2
    np.testing.assert_allclose(once[2:], prior / (prior + noise) * np.array([0.6, -0.8]))
    assert people.spread[0, 2] < noise


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_people_without_identity_are_told_apart_whatever_the_order(seed):
    rng = np.random.default_rng(seed)
    start = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 3.0], [3.0, 3.0]])
    velocity = rng.uniform(-0.7, 0.7, (4, 2))
    people = People(time=0.0)
    for k in range(12):
        where = start + 0.1 * k * velocity + 0.02 * rng.standard_normal((4, 2))
        order = rng.permutation(4)
        people, _ = TRACKER.update(
            people, 0.1 * k, [Detection(where[i]) for i in order], everywhere
        )
        if k == 0:
            named = {name: int(i) for name, i in zip(people.names, order, strict=True)}
    assert len(people.names) == 4
    for name, mean in zip(people.names, people.mean, strict=True):
        truth = start[named[name]] + 1.1 * velocity[named[name]]
        assert np.linalg.norm(mean[:2] - truth) < 0.15


def test_who_is_not_where_they_should_be_has_gone():
    people = followed([0.0, 0.1], np.zeros((2, 2)))
    for k in range(3):
        assert people.names == ("person 1",)
        people, _ = TRACKER.update(people, 0.2 + 0.1 * k, [], everywhere)
    assert people.names == ()


def test_who_is_hidden_is_remembered_and_fades():
    times = np.arange(10) * 0.1
    people = followed(times, np.outer(times, [1.0, 0.0]))
    before = people.spread[0, 0]
    for k in range(20):
        people, _ = TRACKER.update(people, 1.0 + 0.1 * k, [], nowhere)
    assert people.names == ("person 1",)
    assert people.mean[0, 0] == pytest.approx(2.9, abs=0.2)
    assert people.spread[0, 0] > 10 * before
    for k in range(25):
        people, _ = TRACKER.update(people, 3.0 + 0.1 * k, [], nowhere)
    assert people.names == ()


def test_who_reappears_near_where_they_are_expected_is_the_same():
    times = np.arange(10) * 0.1
    people = followed(times, np.outer(times, [1.0, 0.0]))
    for k in range(10):
        people, _ = TRACKER.update(people, 1.0 + 0.1 * k, [], nowhere)
    people, _ = TRACKER.update(people, 2.0, [Detection(np.array([2.05, 0.1]))], everywhere)
    assert people.names == ("person 1",)


def test_a_dropout_says_nothing_about_anybody():
    people = followed([0.0, 0.1], np.zeros((2, 2)))
    for k in range(5):
        people, _ = TRACKER.update(people, 0.2 + 0.1 * k, None, everywhere)
    assert people.names == ("person 1",)
    assert people.missed.tolist() == [0]


def test_a_detection_that_jumps_is_refused_once_and_believed_when_it_stays():
    times = np.arange(5) * 0.1
    people = followed(times, np.zeros((5, 2)), "anna")
    far = Detection(np.array([4.0, 0.0]), "anna")
    people, notes = TRACKER.update(people, 0.5, [far], everywhere)
    assert notes == ("anna jumped by 4.0 m",)
    np.testing.assert_allclose(people.mean[0, :2], 0.0, atol=1e-9)
    for k in range(2):
        people, _ = TRACKER.update(people, 0.6 + 0.1 * k, [far], everywhere)
    assert people.names == ("anna",)
    np.testing.assert_allclose(people.mean[0, :2], [4.0, 0.0])


@pytest.mark.parametrize("turned", [False, True])
def test_several_by_one_name_are_all_people(turned):
    """Whose detector gives a class for an identity, in any order, sees everybody none the less."""
    places = {
        0.0: ([6.0, 3.0], [4.0, 0.0], [4.0, -3.0]),
        0.1: ([6.0, 3.05], [4.0, 0.05], [4.0, -2.95]),
    }
    people = People(time=0.0)
    for time, where in places.items():
        order = where[::-1] if turned and time > 0 else where
        seen = [Detection(np.array(place), "person") for place in order]
        people, notes = TRACKER.update(people, time, seen, everywhere)
        assert notes == ()
        assert len(people.names) == 3
    found = people.mean[:, :2]
    for place in places[0.1]:
        assert np.linalg.norm(found - place, axis=1).min() < 0.05


def test_one_identity_twice_is_one_person():
    people = followed([0.0, 0.1], np.zeros((2, 2)), "anna")
    twice = [Detection(np.zeros(2), "anna"), Detection(np.array([0.1, 0.0]), "anna")]
    people, notes = TRACKER.update(people, 0.2, twice, everywhere)
    assert people.names == ("anna",)
    assert notes == ("anna was detected twice",)
