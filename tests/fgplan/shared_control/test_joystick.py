"""Sticks: what messages say, what they do not say, and which are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgplan.errors import FgplanError
from fgplan.measuring import Measurement
from fgplan.shared_control import (
    DrawnPath,
    JoySample,
    Joystick,
    Stick,
    Waypoint,
    read_joy,
    write_joy,
)

HELD, RELEASED = (0, 0, 0, 0, 1), (0, 0, 0, 0, 0)


def sample(t, forward=1.0, left=0.0, buttons=HELD):
    return JoySample(t, (left, forward), buttons)


def test_every_kind_of_operator_data_is_a_measurement():
    covariance = 0.1 * np.eye(2)
    for data in (
        Joystick(0.0, np.ones(2), covariance),
        Waypoint(np.ones(2), covariance),
        DrawnPath(np.eye(2), covariance),
    ):
        assert isinstance(data, Measurement)
        assert data.on is None
        assert list(data.pieces(0.0, np.zeros(1))) == []


def test_a_window_weighs_as_much_as_one_reading():
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    stick = Joystick(2.0, np.array([0.5, 0.1]), covariance, window=0.9)
    information = sum(np.linalg.inv(r.covariance) for r in stick.readings)
    np.testing.assert_allclose(information, np.linalg.inv(covariance), atol=1e-12)
    np.testing.assert_allclose([r.time for r in stick.readings], [2.3, 2.6, 2.9])
    assert all(r.quantity == "velocity" for r in stick.readings)


def test_ahead_is_where_the_robot_looks_or_x_of_the_map():
    heading = np.pi / 2
    robot, world = Stick(), Stick(frame="map")
    np.testing.assert_allclose(robot.velocity(sample(0, 0.5, 0.0), heading), [0, 0.5], atol=1e-12)
    np.testing.assert_allclose(robot.velocity(sample(0, 0.0, 0.5), heading), [-0.5, 0], atol=1e-12)
    np.testing.assert_allclose(world.velocity(sample(0, 0.5, 0.2), heading), [0.5, 0.2])
    turning = Stick(left=None, turn=0, yaw_rate=1.0, window=1.0)
    v = turning.velocity(sample(0, 1.0, 1.0), 0.0)
    assert np.arctan2(v[1], v[0]) == pytest.approx(0.5)  # the mean direction of one second


@pytest.mark.parametrize(
    "silent",
    [sample(0.2, buttons=RELEASED), sample(0.2, 0.0, 0.0), sample(0.2, 0.04, -0.03)],
    ids=["dead man's button", "zero Twist on release", "within the dead zone"],
)
def test_a_released_or_centred_stick_says_nothing(silent):
    stick = Stick()
    assert stick.wish(silent, 0.0, 0.1) == ()
    found, refused = stick.measurements([sample(0.0), sample(0.1), silent], until=1.0)
    assert [wish.time for wish in found] == [0.0, 0.1]
    assert refused == ()


def test_a_silent_driver_counts_until_its_timeout():
    stick = Stick(timeout=0.5, persistence=0.5, sigma=0.2)
    (wish,), _ = stick.measurements([sample(0.0)], until=10.0)
    np.testing.assert_allclose(wish.covariance, 0.04 * np.eye(2))
    (short,), _ = stick.measurements([sample(0.0)], until=0.1)
    np.testing.assert_allclose(short.covariance, 5 * 0.04 * np.eye(2))


@pytest.mark.parametrize("rate", [5, 10, 20, 50])
def test_a_faster_driver_does_not_say_more(rate):
    """A stick that is held for two seconds says the same at any rate of its messages."""
    samples = [sample(k / rate) for k in range(2 * rate)]
    found, _ = Stick(persistence=0.5, sigma=0.2).measurements(samples, until=2.0)
    information = sum(1 / wish.covariance[0, 0] for wish in found)
    assert information == pytest.approx(2 / 0.5 / 0.04)


@given(st.permutations(range(8)))
def test_messages_may_arrive_in_any_order(order):
    samples = [sample(0.1 * k, 0.1 * k, 0.3) for k in range(8)]
    expected, _ = Stick().measurements(samples, until=1.0)
    found, _ = Stick().measurements([samples[i] for i in order], until=1.0)
    for a, b in zip(expected, found, strict=True):
        assert a.time == b.time
        np.testing.assert_array_equal(a.velocity, b.velocity)
        np.testing.assert_array_equal(a.covariance, b.covariance)


@pytest.mark.parametrize(
    ("bad", "why"),
    [
        (sample(np.nan), "stamp is nan"),
        (sample(1.5), "0.500 s in the future"),
        (sample(0.0, 1.7), "axis 1 is 1.7"),
        (sample(0.0, np.nan), "axis 1 is nan"),
        (JoySample(0.0, (0.0,), HELD), "1 axes"),
        (JoySample(0.0, (0.0, 1.0), (0, 1)), "2 buttons"),
    ],
)
def test_bad_messages_are_refused_by_name_and_the_others_count(bad, why):
    found, refused = Stick().measurements([sample(0.3), bad], until=1.0)
    assert len(found) == 1
    assert len(refused) == 1
    assert why in refused[0]


def test_a_log_is_read_as_it_was_written(tmp_path: Path):
    samples = tuple(sample(1_700_000_000 + 0.05 * k, 0.1 * k, -0.2) for k in range(5))
    write_joy(tmp_path / "log.jsonl", samples)
    back = read_joy(tmp_path / "log.jsonl")
    np.testing.assert_allclose([s.stamp for s in back], [s.stamp for s in samples], atol=1e-6)
    assert [(s.axes, s.buttons) for s in back] == [(s.axes, s.buttons) for s in samples]


@pytest.mark.parametrize(
    "line",
    [
        "{",
        "[]",
        '{"header": {}}',
        '{"header": {"stamp": {"sec": 1, "nanosec": 0}}}',
        "3",
        '{"header": {"stamp": {"sec": 1, "nanosec": 0}}, "axes": [0.0], "buttons": [Infinity]}',
        '{"header": {"stamp": {"sec": 1%s, "nanosec": 0}}, "axes": [], "buttons": []}'
        % ("0" * 400),
    ],
)
def test_a_broken_log_names_file_and_line(tmp_path: Path, line: str):
    write_joy(tmp_path / "log.jsonl", [sample(0.0)])
    with (tmp_path / "log.jsonl").open("a", encoding="utf-8") as file:
        file.write(line + "\n")
    with pytest.raises(FgplanError, match=r"log\.jsonl, line 2"):
        read_joy(tmp_path / "log.jsonl")
    with pytest.raises(FgplanError, match="cannot be read"):
        read_joy(tmp_path / "nothing.jsonl")


def test_a_drawn_path_is_as_many_places_as_it_is_long():
    path = np.column_stack([np.linspace(0, 3, 100), np.zeros(100)])
    places = DrawnPath(path, 0.1 * np.eye(2)).readings
    np.testing.assert_allclose([p.value for p in places], [[1, 0], [2, 0], [3, 0]], atol=1e-12)
    assert all(p.time is None for p in places)
    timed = DrawnPath(path, 0.1 * np.eye(2), times=np.arange(100.0)).readings
    assert [p.time for p in timed] == list(range(100))
