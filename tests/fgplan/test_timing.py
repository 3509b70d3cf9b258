"""The accelerate-cruise-brake law: closed forms, bounds, and trajectories along paths."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgplan.timing import (
    SpeedLaw,
    along,
    path_length,
    speed_along,
    speed_law,
    timed,
    waiting_law,
)

lengths = st.floats(0.0, 50.0)
speeds = st.floats(0.1, 3.0)
accelerations = st.floats(0.2, 4.0)
starts = st.floats(0.0, 3.0)


# Closed forms


def test_trapezoid():
    law = speed_law(10.0, 1.0, 2.0)
    assert law.duration == pytest.approx(10.0 / 1.0 + 1.0 / 2.0)  # L/v + v/a
    s, v = law.at([0.0, 0.5, 5.0, 10.0, 10.5, 99.0])
    np.testing.assert_allclose(s, [0.0, 0.25, 4.75, 9.75, 10.0, 10.0], atol=1e-12)
    np.testing.assert_allclose(v, [0.0, 1.0, 1.0, 1.0, 0.0, 0.0], atol=1e-12)


def test_triangle_where_the_path_is_too_short_to_reach_the_speed():
    law = speed_law(0.5, 2.0, 2.0)
    assert law.duration == pytest.approx(2 * np.sqrt(0.5 / 2.0))  # 2 √(L/a)
    assert law.at(law.duration / 2)[1] == pytest.approx(np.sqrt(2.0 * 0.5))  # √(a L)


def test_start_at_the_preferred_speed_saves_half_a_ramp():
    assert speed_law(10.0, 1.0, 2.0, 1.0).duration == pytest.approx(10.0 + 0.25)


def test_start_above_the_preferred_speed_brakes_to_it_first():
    s, v = speed_law(10.0, 1.0, 1.0, 2.0).at([0.0, 1.0, 2.0])
    np.testing.assert_allclose(v, [2.0, 1.0, 1.0])
    np.testing.assert_allclose(s, [0.0, 1.5, 2.5])


def test_too_short_to_brake_brakes_as_hard_as_it_must():
    law = speed_law(0.5, 1.0, 1.0, 2.0)  # v²/(2 L) = 4 m/s²
    assert law.phases == ((0.5, -4.0),)
    assert law.length == pytest.approx(0.5)


def test_too_short_to_reach_the_end_speed_ends_slower():
    law = speed_law(0.5, 2.0, 1.0, 0.0, 2.0)
    assert law.final_speed == pytest.approx(1.0)  # √(2 a L)
    assert law.length == pytest.approx(0.5)


def test_path_of_no_length_takes_no_time():
    assert speed_law(0.0, 1.0, 1.0, 1.0).duration == 0.0
    assert speed_law(0.0, 1.0, 1.0, 1.0).at(3.0) == (0.0, 0.0)


def test_waiting_brakes_stands_and_starts_at_the_delay():
    law = waiting_law(10.0, 1.0, 1.0, 1.0, 4.0)
    s, v = law.at([0.0, 1.0, 3.9, 5.0, 99.0])
    np.testing.assert_allclose(s, [0.0, 0.5, 0.5, 1.0, 10.0], atol=1e-12)
    np.testing.assert_allclose(v, [1.0, 0.0, 0.0, 1.0, 0.0], atol=1e-12)
    assert law.duration == pytest.approx(4.0 + speed_law(9.5, 1.0, 1.0).duration)


def test_waiting_at_rest_is_the_same_law_later():
    law, plain = waiting_law(7.0, 1.0, 1.5, 0.0, 3.0), speed_law(7.0, 1.0, 1.5)
    t = np.linspace(0, 12, 50)
    np.testing.assert_allclose(law.at(t + 3.0), plain.at(t), atol=1e-12)


# Properties


@given(lengths, speeds, accelerations, starts, st.floats(0, 1))
@settings(max_examples=200, deadline=None)
def test_law_is_monotone_bounded_and_ends_at_the_end(L, v, a, v0, end):
    law = speed_law(L, v, a, v0, end * v)
    t = np.linspace(0, law.duration, 400)
    s, rate = law.at(t)
    assert np.all(np.diff(s) >= -1e-9)
    assert rate.max() <= max(v, v0) + 1e-9
    assert rate.min() >= -1e-9
    assert law.length == pytest.approx(L, abs=1e-7)
    must = max(0.0, v0**2 - (end * v) ** 2) / (2 * L) if L else 0.0
    assert all(abs(rate) <= max(a, must) * (1 + 1e-9) for _, rate in law.phases)


@given(lengths, speeds, accelerations, starts)
@settings(max_examples=100, deadline=None)
def test_speed_is_the_rate_of_arc_length(L, v, a, v0):
    law = speed_law(L, v, a, v0)
    changes = np.cumsum([0.0, *(duration for duration, _ in law.phases)])
    t = np.union1d(np.linspace(0, law.duration + 1, 100), changes)
    s, v = law.at(t)
    # Between changes of the acceleration speed is linear, so the trapezoid rule is exact.
    np.testing.assert_allclose(np.diff(s), np.diff(t) * 0.5 * (v[1:] + v[:-1]), atol=1e-7)


def test_waiting_at_a_place_comes_to_it_first():
    law = waiting_law(10.0, 1.0, 1.0, 1.0, 9.0, place=6.0)
    s, v = law.at([5.0, 6.5, 9.0, 99.0])
    np.testing.assert_allclose(s, [5.0, 6.0, 6.0, 10.0], atol=1e-12)
    np.testing.assert_allclose(v, [1.0, 0.0, 0.0, 0.0], atol=1e-12)
    beyond = waiting_law(2.0, 1.0, 1.0, 1.0, 9.0, place=6.0)
    np.testing.assert_allclose(beyond.at(8.0)[0], 2.0)


@given(lengths, speeds, accelerations, st.floats(0, 1), st.floats(0.0, 10.0), st.floats(0.0, 30.0))
@settings(max_examples=100, deadline=None)
def test_waiting_never_arrives_earlier(L, v, a, v0, delay, place):
    law = waiting_law(L, v, a, v0 * v, delay, place=place)
    assert law.duration >= speed_law(L, v, a, v0 * v).duration - 1e-9
    assert law.duration >= delay - 1e-9
    assert law.length == pytest.approx(L, abs=1e-7)
    assert law.final_speed == pytest.approx(0.0, abs=1e-7)


@given(st.integers(0, 10_000), speeds, accelerations)
@settings(max_examples=50, deadline=None)
def test_trajectory_stays_on_the_path_and_rests_at_its_end(seed, v, a):
    path = np.cumsum(np.random.default_rng(seed).normal(size=(6, 2)), axis=0)
    T = speed_law(path_length(path), v, a).duration
    trajectory = timed(path, np.linspace(0, T + 1, 200), v, a)
    np.testing.assert_allclose(trajectory.positions[0], path[0], atol=1e-12)
    np.testing.assert_allclose(trajectory.positions[-1], path[-1], atol=1e-9)
    np.testing.assert_allclose(trajectory.velocities[-1], 0.0, atol=1e-9)
    assert np.linalg.norm(trajectory.velocities, axis=1).max() <= v + 1e-9
    a0, b0 = path[:-1], path[1:]
    q = trajectory.positions[:, None]
    share = np.clip(np.sum((q - a0) * (b0 - a0), -1) / np.sum((b0 - a0) ** 2, -1), 0, 1)
    away = np.linalg.norm(q - a0 - share[..., None] * (b0 - a0), axis=-1).min(axis=1)
    assert away.max() < 1e-9


# Along a path


def test_acceleration_is_bounded_along_a_straight_path():
    times = np.linspace(0, 8, 801)
    velocities = timed([[0, 0], [2, 1], [4, 2]], times, 1.0, 0.8).velocities
    assert np.linalg.norm(np.diff(velocities, axis=0), axis=1).max() / 0.01 <= 0.8 + 1e-9


def test_velocity_is_tangent_and_only_its_part_along_the_path_counts():
    path = [[0.0, 0.0], [5.0, 0.0], [5.0, 5.0]]
    assert speed_along(path, [0.6, -2.0]) == pytest.approx(0.6)
    assert speed_along(path, [-0.6, 0.0]) == 0.0
    trajectory = timed(path, [0.0, 1.0, 8.0], 1.0, 10.0, velocity=[0.6, -2.0])
    np.testing.assert_allclose(trajectory.velocities, [[0.6, 0], [1, 0], [0, 1]], atol=1e-12)


def test_end_speed_runs_straight_on_beyond_the_path():
    trajectory = timed([[0.0, 0.0], [2.0, 0.0]], [0.0, 2.0, 3.0], 1.0, 1.0, [1.0, 0.0], 1.0)
    np.testing.assert_allclose(trajectory.positions[:, 0], [0.0, 2.0, 3.0])
    np.testing.assert_allclose(trajectory.velocities, [[1, 0], [1, 0], [1, 0]])


@pytest.mark.parametrize("path", [[[1.0, 2.0]], [[1.0, 2.0]] * 3])
def test_path_without_length_stays_where_it_is(path):
    trajectory = timed(path, [0.0, 1.0], 1.0, 1.0, velocity=[1.0, 0.0])
    np.testing.assert_array_equal(trajectory.positions, [[1.0, 2.0]] * 2)
    assert not trajectory.velocities.any()


def test_repeated_vertices_change_nothing():
    times = np.linspace(0, 5, 20)
    once = timed([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]], times, 1.0, 1.0)
    twice = timed([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [1.0, 2.0]], times, 1.0, 1.0)
    np.testing.assert_array_equal(once.states, twice.states)


def test_waiting_along_a_path():
    path = np.array([[0.0, 0.0], [3.0, 0.0]])
    law = waiting_law(path_length(path), 1.0, 1.0, 0.0, 2.0)
    trajectory = along(path, [0.0, 2.0, 3.0, 9.0], law)
    np.testing.assert_allclose(trajectory.positions[:, 0], [0.0, 0.0, 0.5, 3.0], atol=1e-12)


# Bad input


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ((-1.0, 1.0, 1.0), "length"),
        ((np.inf, 1.0, 1.0), "length"),
        ((1.0, 0.0, 1.0), "speed"),
        ((1.0, np.nan, 1.0), "speed"),
        ((1.0, 1.0, 0.0), "acceleration"),
        ((1.0, 1.0, 1.0, -0.1), "initial_speed"),
        ((1.0, 1.0, 1.0, 0.0, 1.1), "end_speed"),
    ],
)
def test_number_out_of_range_is_named(arguments, name):
    with pytest.raises(ValueError, match=f"^{name} is out of range"):
        speed_law(*arguments)


@pytest.mark.parametrize("delay", [-1.0, np.nan, np.inf])
def test_impossible_delay_raises(delay):
    with pytest.raises(ValueError, match="delay"):
        waiting_law(1.0, 1.0, 1.0, 0.0, delay)


@pytest.mark.parametrize("path", [np.zeros((0, 2)), np.zeros(2), np.zeros((3, 3)), [[0, np.nan]]])
def test_path_that_is_no_polyline_raises(path):
    with pytest.raises(ValueError, match="path"):
        along(path, [0.0], SpeedLaw(0.0))
