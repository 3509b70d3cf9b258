"""The obstacle hinge at states and between them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from factors.distance_field import Outside, SignedDistanceField
from factors.gp_prior import GPPrior
from factors.obstacle import InterpolatedObstacle, Obstacle
from factors.residual import Array
from tests.factor_testing import check_derivatives

RADIUS, MARGIN, SIGMA = 0.3, 0.2, 0.1
coordinate = st.floats(-6, 14).map(lambda c: round(c, 6))


def disc(x: float = 4.0, y: float = 3.0, radius: float = 1.0) -> SignedDistanceField:
    """A disc on a map of 8 m × 6 m with nodes every 0.1 m."""
    rows, cols = np.mgrid[0:61, 0:81] * 0.1
    return SignedDistanceField(np.hypot(cols - x, rows - y) - radius, np.zeros(2), 0.1)


def wall(outside: Outside = Outside.LOWER_BOUND) -> SignedDistanceField:
    """Free space of 2 m × 2 m whose right border is a wall: d = 2 − x, exactly."""
    values = np.tile(2.0 - np.linspace(0, 2, 5), (5, 1))
    return SignedDistanceField(values, np.zeros(2), 0.5, outside=outside)


def obstacle(field: SignedDistanceField, **changes: Any) -> Obstacle:
    return replace(Obstacle(field, RADIUS, MARGIN, SIGMA), **changes)


def between(field: SignedDistanceField, checks: Any = 3, **changes: Any) -> InterpolatedObstacle:
    return replace(InterpolatedObstacle(field, RADIUS, MARGIN, SIGMA, 0.5, checks), **changes)


def still(x: float, y: float) -> Array:
    return np.array([x, y, 0.0, 0.0])


@given(x=st.floats(0, 2), weight=st.floats(0, 4))
def test_energy_is_the_squared_shortfall_of_clearance(x: float, weight: float) -> None:
    shortfall = max(0.0, MARGIN + RADIUS - (2 - x))
    expected = 0.5 * weight * (shortfall / SIGMA) ** 2
    energy = obstacle(wall(), weight=weight).energy(still(x, 1.0))
    assert energy == pytest.approx(expected, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_derivatives_at_a_state(seed: int, yaw: float) -> None:
    angle, rng = 1.0 + seed, np.random.default_rng(seed)
    field = replace(disc(), yaw=yaw)
    near = 4 + 3j + rng.uniform(0.3, 1.7) * np.exp(1j * angle)
    near *= np.exp(1j * yaw)
    x = np.array([near.real, near.imag, *rng.normal(size=2)])
    check_derivatives(obstacle(field, weight=0.6), x)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("checks", [1, 3, (0.4,), (0.1, 0.2, 0.85)])
def test_derivatives_between_states(seed: int, checks: Any) -> None:
    rng = np.random.default_rng(seed)
    x0, x1 = np.array([3.3, 2.8, 1.0, 0.2]), np.array([4.4, 3.9, 0.7, -0.3])
    x0, x1 = x0 + 0.2 * rng.normal(size=4), x1 + 0.2 * rng.normal(size=4)
    check_derivatives(between(disc(), checks), x0, x1)


@pytest.mark.parametrize("where", [(-1.0, 3.03), (9.0, -2.0), (4.02, 7.0)])
def test_derivatives_outside_the_map(where: tuple[float, float]) -> None:
    field = disc(x=0.5, y=0.5, radius=4.0)
    check_derivatives(obstacle(field), still(*where))
    check_derivatives(between(field), still(*where), still(*where) + 0.1)


@given(coordinate, coordinate, st.integers(1, 5))
def test_far_from_obstacles_nothing_is_felt(x: float, y: float, checks: int) -> None:
    place, field = still(x, y), disc()
    if field.distance(place[:2]) < RADIUS + MARGIN:
        return
    for part in (*obstacle(field).expand(place), *between(field, checks).expand(place, place)):
        assert not part.any()


@given(x=st.floats(-50, 50), y=st.floats(-50, 50))
def test_outside_the_map_is_never_free_by_accident(x: float, y: float) -> None:
    """Beyond the wall the cost only grows; behind the open side it is what an unknown obstacle
    there could cost, never less than at the border."""
    place = still(x, y)
    border = still(np.clip(x, 0, 2), np.clip(y, 0, 2))
    assert obstacle(wall()).energy(place) >= obstacle(wall()).energy(border) - 1e-12
    checked = between(wall())
    assert checked.energy(place, place) >= checked.energy(border, border) - 1e-12


def test_outside_is_free_only_where_the_field_says_so() -> None:
    beyond = still(2.5, 1.0)
    assert obstacle(wall()).energy(beyond) == pytest.approx(50.0)
    assert obstacle(wall(Outside.FREE)).energy(beyond) == 0.0


@given(st.floats(0, 2 * np.pi), st.floats(0.4, 1.45))
def test_descent_leads_away_from_the_obstacle(angle: float, distance: float) -> None:
    outward = np.array([np.cos(angle), np.sin(angle)])
    x, y = np.array([4.0, 3.0]) + distance * outward
    slope = obstacle(disc()).expand(still(x, y)).gradient @ outward
    force = (MARGIN + RADIUS + 1.0 - distance) / SIGMA**2
    assert slope == pytest.approx(-force, rel=0.1)


@given(st.integers(0, 10**6), st.integers(1, 6))
def test_checked_points_are_the_interpolated_process(seed: int, checks: int) -> None:
    """One by one through GPPrior.interpolate, with any Qc."""
    x0, x1 = np.random.default_rng(seed).normal(size=(2, 4))
    prior = GPPrior(0.5, np.array([[2.0, 0.3], [0.3, 0.5]]))
    residual = between(disc(), checks)
    for fraction, point in zip(residual.fractions, residual.points(x0, x1), strict=True):
        Lambda, Psi = prior.interpolate(0.5 * fraction)
        assert_allclose(point, (Lambda @ x0 + Psi @ x1)[:2], atol=1e-9)


def test_constant_velocity_is_checked_evenly_along_the_line() -> None:
    velocity = np.array([1.0, -0.4])
    x0 = np.concatenate([[1.0, 2.0], velocity])
    x1 = np.concatenate([[1.0, 2.0] + 0.5 * velocity, velocity])
    expected = [[1.0, 2.0] + 0.5 * f * velocity for f in (0.25, 0.5, 0.75)]
    assert_allclose(between(disc(), 3).points(x0, x1), expected, atol=1e-12)


@pytest.mark.parametrize("checks", [1, 2, 7])
def test_more_checks_do_not_weigh_more(checks: int) -> None:
    place = still(4.0, 3.0)
    one = obstacle(disc(), weight=0.5).energy(place)
    assert between(disc(), checks, weight=0.5).energy(place, place) == pytest.approx(one)


def test_a_thin_wall_between_two_states_is_felt() -> None:
    values = np.abs(np.linspace(0, 4, 41) - 2.0) - 0.1
    field = SignedDistanceField(np.tile(values, (41, 1)), np.zeros(2), 0.1)
    before, after = np.array([1.0, 2.0, 4.0, 0.0]), np.array([3.0, 2.0, 4.0, 0.0])
    assert obstacle(field).energy(before) == 0.0
    assert obstacle(field).energy(after) == 0.0
    assert between(field, 1).energy(before, after) > 10


def test_not_a_number_is_not_hidden() -> None:
    assert np.isnan(obstacle(disc()).energy(still(np.nan, 0.0)))


ERRORS: list[tuple[Any, str]] = [
    (lambda: obstacle(wall(), radius=-0.1), "radius and margin"),
    (lambda: obstacle(wall(), margin=np.nan), "radius and margin"),
    (lambda: obstacle(wall(), sigma=0.0), "sigma must be positive"),
    (lambda: obstacle(wall(), weight=-1.0), "weight"),
    (lambda: obstacle(wall(), dim=1), "dim = 1"),
    (lambda: between(wall(), 0), "checks must lie between"),
    (lambda: between(wall(), (0.5, 1.0)), "checks must lie between"),
    (lambda: between(wall(), (np.nan,)), "checks must lie between"),
    (lambda: between(wall(), dt=0.0), "dt must be positive"),
    (lambda: between(wall(), sigma=-1.0), "sigma must be positive"),
]


@pytest.mark.parametrize(("build", "message"), ERRORS)
def test_documented_errors(build: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build()
