"""Speed and acceleration limits, and the hinge and norm under them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from factors.hinge import TINY, Hinge, hinge_scale, linearize_norm, norm
from factors.kinematics import AccelerationLimit, SpeedLimit
from factors.radial import components, square
from factors.residual import Residual
from tests.factor_testing import check_derivatives

finite = st.floats(-3, 3)


def state(*velocity: float) -> Any:
    return np.concatenate([np.full(len(velocity), 5.0), velocity])


@given(finite, finite, st.floats(0.05, 2), st.floats(0, 3))
def test_speed_error_is_the_excess(vx: float, vy: float, sigma: float, weight: float) -> None:
    limit = SpeedLimit(1.2, sigma, weight)
    excess = max(0.0, np.hypot(vx, vy) - 1.2)
    expected = 0.5 * weight * (excess / sigma) ** 2
    assert limit.energy(state(vx, vy)) == pytest.approx(expected, rel=1e-6, abs=1e-9)


@given(finite, finite, finite, finite, st.floats(0.1, 1))
def test_acceleration_error_is_the_excess(
    vx: float, vy: float, wx: float, wy: float, dt: float
) -> None:
    limit = AccelerationLimit(1.5, 0.1, dt, weight=0.5)
    excess = max(0.0, np.hypot(wx - vx, wy - vy) / dt - 1.5)
    expected = 0.25 * (excess / 0.1) ** 2
    assert limit.energy(state(vx, vy), state(wx, wy)) == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_position_does_not_matter() -> None:
    x = np.array([1.0, 2.0, 2.0, 1.0])
    moved = x + np.array([10.0, -3.0, 0.0, 0.0])
    assert SpeedLimit(1.0, 0.1).energy(x) == SpeedLimit(1.0, 0.1).energy(moved)


@pytest.mark.parametrize("speed", [0.0, 0.3, 1.1, 1.3, 2.0])
@pytest.mark.parametrize("limit", [SpeedLimit(1.2, 0.3), SpeedLimit(1.2, 0.3, weight=0.25)])
def test_speed_derivatives(limit: Residual, speed: float) -> None:
    check_derivatives(limit, state(0.6 * speed, -0.8 * speed))


def test_speed_derivatives_in_three_dimensions() -> None:
    check_derivatives(SpeedLimit(1.2, 0.3, dim=6), state(1.0, -1.0, 0.5))


@pytest.mark.parametrize("change", [0.0, 0.4, 0.8, 2.0])
def test_acceleration_derivatives(change: float) -> None:
    limit = AccelerationLimit(1.5, 0.3, dt=0.4, weight=0.7)
    check_derivatives(limit, state(0.5, 0.2), state(0.5 + 0.6 * change, 0.2 - 0.8 * change))


@pytest.mark.parametrize("limit", [0.0, 1.0])
def test_standing_still_has_finite_derivatives(limit: float) -> None:
    rest = np.zeros((2, 3, 4))
    for residual, x in (
        (SpeedLimit(limit, 0.1), (rest,)),
        (AccelerationLimit(limit, 0.1, 0.4), (rest, rest)),
    ):
        for part in (*residual.linearize(*x)[1], *residual.expand(*x)):
            assert np.isfinite(part).all()
        assert_allclose(residual.expand(*x).gradient, 0.0, atol=1e-12)


def test_below_the_limit_nothing_is_felt() -> None:
    for part in SpeedLimit(1.2, 0.1).expand(state(0.8, 0.8)):
        assert not part.any()


def test_infinite_sigma_switches_a_limit_off() -> None:
    assert SpeedLimit(1.2, np.inf).energy(state(100.0, 0.0)) == 0.0


def test_not_a_number_is_not_hidden() -> None:
    assert np.isnan(SpeedLimit(1.2, 0.1).energy(state(np.nan, 0.0)))


@given(st.floats(-2, 2), st.floats(0.1, 5))
def test_hinge_sides_mirror_each_other(d: float, scale: float) -> None:
    one = np.array(1.0)
    above = Hinge(0.5, scale, "above").linearize(np.array(d), one[None])
    below = Hinge(-0.5, scale, "below").linearize(np.array(-d), -one[None])
    assert_allclose(above[0], below[0])
    assert_allclose(above[1], below[1])


def test_hinge_threshold_broadcasts() -> None:
    hinge = Hinge(np.array([0.5, 1.5]), 2.0, "below")
    assert_allclose(hinge.error(np.array([[1.0, 1.0], [0.0, 2.0]])), [[0.0, 1.0], [1.0, 0.0]])


def test_norm_and_its_derivatives_at_the_origin() -> None:
    length, gradient = linearize_norm(np.zeros(2))
    assert length == TINY
    assert_allclose(gradient, 0.0)


@pytest.mark.parametrize("side", ["above", "below"])
@pytest.mark.parametrize("v", [np.zeros(2), np.array([0.3, -0.4]), np.array([0.1, 0.5, -1.2])])
def test_hinge_of_a_length_equals_the_chain_rule(v, side) -> None:
    hinge = Hinge(0.4, 3.0, side)
    d, u = linearize_norm(v)
    expected = hinge.expand(d, u, (np.eye(len(v)) - np.outer(u, u)) / d)
    found = hinge.radial(square(components(v))).of(components(v))
    for one, other in zip(found, expected, strict=True):
        assert_allclose(one, other, rtol=1e-10, atol=1e-12)
    assert_allclose(hinge.energy_of(square(components(v))), expected.energy, rtol=1e-12)


@given(st.floats(1e-3, 100), st.floats(0, 2 * np.pi))
def test_norm_is_the_length(length: float, angle: float) -> None:
    v = length * np.array([np.cos(angle), np.sin(angle)])
    assert norm(v) == pytest.approx(length, rel=1e-6)
    assert_allclose(linearize_norm(v)[1], v / length, rtol=1e-6)


ERRORS: list[tuple[Any, str]] = [
    (lambda: SpeedLimit(-1.0, 0.1), "limit must not be negative"),
    (lambda: SpeedLimit(1.0, 0.0), "sigma must be positive"),
    (lambda: SpeedLimit(1.0, np.nan), "sigma must be positive"),
    (lambda: SpeedLimit(1.0, 0.1, weight=-1.0), "weight"),
    (lambda: SpeedLimit(1.0, 0.1, dim=3), "dim = 3"),
    (lambda: AccelerationLimit(np.nan, 0.1, 0.4), "limit must not be negative"),
    (lambda: AccelerationLimit(1.0, 0.1, 0.0), "dt must be positive"),
    (lambda: AccelerationLimit(1.0, -0.1, 0.4), "sigma must be positive"),
    (lambda: AccelerationLimit(1.0, 0.1, 0.4, weight=np.inf), "weight"),
    (lambda: AccelerationLimit(1.0, 0.1, 0.4, dim=0), "dim = 0"),
    (lambda: hinge_scale(1.0, np.nan), "weight"),
]


@pytest.mark.parametrize(("build", "message"), ERRORS)
def test_documented_errors(build: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build()
