"""Tactical data as factors: derivatives, and cases where the error is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from factors.arrival import Arrival
from factors.flat import velocity_of_positions
from factors.formation import formation
from factors.gp_prior import GPPrior
from factors.keep_in import KeepIn
from factors.keep_out import KeepOut
from factors.passing_side import PassingSide
from factors.shape import Shape
from factors.speed_zone import SpeedZone
from factors.stay_behind import StayBehind
from tests.factor_testing import check_derivatives, differences

SQUARE = Shape(np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]]))
ROUNDED = Shape(SQUARE.vertices, 0.3)
DISC = Shape(np.array([[1.0, 0.5]]), 0.8)
CAPSULE = Shape(np.array([[0.0, 0.0], [2.0, 1.0]]), 0.4)
L_SHAPE = Shape(np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3.0]]))
SHAPES = [SQUARE, ROUNDED, DISC, CAPSULE, L_SHAPE]

NEAR = np.array([2.3, 1.4, 0.7, 0.4])
"""Outside of the square, nearest to a corner."""
LATER = np.array([2.6, 1.5, 0.8, 0.2])
INSIDE = np.array([0.6, 0.2, -0.5, 0.8])
BESIDE = np.array([-0.25, 0.4, 0.6, 0.1])
"""Outside, nearest to an edge."""


# The shape


@pytest.mark.parametrize("shape", SHAPES)
@given(x=st.floats(-2, 5), y=st.floats(-2, 5))
def test_distance_is_that_to_the_nearest_of_many_points(shape, x, y):
    """Brute force: points on the outline, 1 mm apart; inside by the winding of the outline."""
    p = np.array([x, y])
    a = shape.vertices
    ends = np.roll(a, -1, axis=0)
    s = np.linspace(0, 1, 4001)[:, None]
    outline = np.vstack([u + s * (v - u) for u, v in zip(a, ends, strict=True)])
    nearest = np.linalg.norm(outline - p, axis=1).min()
    angles = np.unwrap(np.arctan2(*(outline - p).T[::-1]))
    inside = len(a) > 2 and abs(angles[-1] - angles[0]) > np.pi
    distance = shape.distance(p) + shape.radius
    if nearest <= 1e-3:  # points 1 mm apart cannot tell on which side of the outline this is
        assert abs(distance) == pytest.approx(nearest, abs=1e-3)
    else:
        assert distance == pytest.approx(-nearest if inside else nearest, abs=1e-3)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("state", [NEAR, INSIDE, BESIDE])
def test_gradient_and_hessian_of_the_distance(shape, state):
    p = state[:2]
    _, gradient, hessian = shape.expand(p)
    np.testing.assert_allclose(gradient, differences(shape.distance, p), atol=1e-6)
    slopes = differences(lambda q: shape.expand(q)[1], p)
    np.testing.assert_allclose(hessian, slopes, atol=1e-5)


@pytest.mark.parametrize(
    ("vertices", "radius", "says"),
    [
        (np.zeros((0, 2)), 1.0, "shape"),
        (np.zeros((2, 3)), 1.0, "shape"),
        (np.full((3, 2), np.nan), 1.0, "finite"),
        (np.zeros((1, 2)), -1.0, "not negative"),
    ],
)
def test_a_shape_that_is_none_is_refused(vertices, radius, says):
    with pytest.raises(ValueError, match=says):
        Shape(vertices, radius)


# Derivatives of every factor


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("state", [NEAR, INSIDE, BESIDE])
@pytest.mark.parametrize("factor", [KeepOut, KeepIn])
def test_regions_derivatives(factor, shape, state):
    check_derivatives(factor(shape, margin=0.7, sigma=0.3, weight=0.5), state)


@pytest.mark.parametrize("shape", SHAPES)
def test_speed_zone_derivatives(shape):
    for state in (NEAR, INSIDE, BESIDE):
        check_derivatives(SpeedZone(shape, limit=0.2, blend=0.4, sigma=0.3, weight=0.5), state)


@pytest.mark.parametrize("shape", SHAPES)
def test_arrival_derivatives(shape):
    check_derivatives(Arrival(shape, 0.4, 0.3, sigma=0.3), NEAR, LATER)


@pytest.mark.parametrize("side", ["left", "right"])
def test_passing_side_derivatives(side):
    one = PassingSide(np.array([2.0, 1.0]), np.array([2.0, 1.0]), side, 1.5, 0.8, 0.3, 0.5)
    check_derivatives(one, NEAR)
    steps = np.array([[2.0, 1.0], [2.2, 1.1], [2.4, 1.0]])
    moving = PassingSide(steps, np.array([1.0, 0.2]), side, 1.5, 0.8)
    check_derivatives(moving, np.stack([NEAR, NEAR + 0.1, NEAR - 0.2]))


def test_stay_behind_derivatives():
    check_derivatives(StayBehind(np.array([2.0, 1.0]), np.array([1.0, 0.5]), 0.5), NEAR)
    steps = np.array([[2.0, 1.0], [2.2, 1.1]])
    check_derivatives(StayBehind(steps, steps, 1.0), np.stack([NEAR, NEAR + 0.1]))
    turning = StayBehind(np.array([2.0, 1.0]), steps, 1.0)  # somebody who stands and turns
    check_derivatives(turning, np.stack([NEAR, NEAR + 0.1]))
    assert turning.at(1).person.shape == turning.at(1).direction.shape == (2,)


def test_formation_and_flat_derivatives():
    leader = np.array([[2.0, 1.0], [2.5, 1.2]])
    following = formation(leader, np.array([[1.0, 0.0], [1.0, 0.5]]), [-1.0, 0.5], 0.3, 0.5)
    check_derivatives(following, np.stack([NEAR, INSIDE]))
    for last in (False, True):
        check_derivatives(velocity_of_positions(0.4, np.eye(2), last), NEAR, INSIDE)


# Physical cases


def test_who_is_far_from_a_region_is_not_kept_out_of_it():
    assert KeepOut(SQUARE, 0.3).energy(np.array([5.0, 5.0, 0, 0])) == 0


def test_keeping_out_costs_by_the_depth():
    """0.2 m too near with σ = 0.1 m: two standard deviations."""
    assert KeepOut(SQUARE, 0.3, 0.1).energy(np.array([1.0, -0.1, 0, 0])) == pytest.approx(2.0)


def test_keeping_in_costs_by_the_distance():
    assert KeepIn(SQUARE, 0.0, 0.1).energy(np.array([1.0, -0.2, 0, 0])) == pytest.approx(2.0)
    assert KeepIn(SQUARE, 0.0, 0.1).energy(np.array([1.0, 0.4, 0, 0])) == 0


def test_an_arrival_is_where_the_prior_interpolates():
    prior, x, y = GPPrior(0.4, np.eye(2)), NEAR, LATER
    Lambda, Psi = prior.interpolate(0.15)
    there = KeepIn(DISC, sigma=0.2).energy(Lambda @ x + Psi @ y)
    assert Arrival(DISC, 0.4, 0.15, sigma=0.2).energy(x, y) == pytest.approx(there, rel=1e-12)


def test_arriving_on_a_step_is_being_in_at_that_step():
    on_time = Arrival(SQUARE, 0.4, 0.4, sigma=0.2).energy(INSIDE, NEAR)
    assert on_time == pytest.approx(KeepIn(SQUARE, sigma=0.2).energy(NEAR), rel=1e-9)


def test_a_zone_counts_inside_only():
    zone = SpeedZone(SQUARE, 0.3, blend=0.05, sigma=0.1)
    fast = np.array([1.0, 0.5, 0.5, 0.0])
    assert zone.energy(fast) == pytest.approx(2.0, rel=1e-3)
    assert zone.energy(np.array([1.0, 3.5, 0.5, 0.0])) < 1e-9
    assert zone.energy(fast * [1, 1, 0.5, 0]) == 0


def test_a_side_counts_abeam_and_on_the_wrong_hand():
    side = PassingSide(np.zeros(2), np.array([1.0, 0.0]), "left", gap=0.5, length=0.5, sigma=0.1)
    at = lambda x, y: side.energy(np.array([x, y, 1.0, 0.0]))  # noqa: E731
    assert at(0, 0.6) == 0
    assert at(0, 0.3) == pytest.approx(2.0)
    assert at(0, -0.5) > at(0, 0)
    assert at(5, -0.5) < 1e-9


def test_the_sides_mirror_each_other():
    direction = np.array([1.0, 0.0])
    left, right = (PassingSide(np.zeros(2), direction, side) for side in ("left", "right"))
    x = np.array([0.3, 0.2, 1.0, 0.0])
    assert left.energy(x) == pytest.approx(right.energy(x * [1, -1, 1, -1]))


def test_behind_somebody_is_free_and_ahead_is_not():
    behind = StayBehind(np.array([3.0, 0.0]), np.array([2.0, 0.0]), gap=1.0, sigma=0.5)
    assert behind.energy(np.array([1.9, 4.0, 0, 0])) == 0
    assert behind.energy(np.array([3.0, 0.0, 0, 0])) == pytest.approx(2.0)


def test_a_formation_turns_with_its_leader():
    """Behind and to the left of a leader who walks north is to the south and west."""
    at = formation(np.array([[1.0, 1.0]]), np.array([[0.0, 2.0]]), np.array([-1.0, 0.5]), 0.1)
    assert at.at(0).energy(np.array([0.5, 0.0, 9.0, 9.0])) == pytest.approx(0.0, abs=1e-20)


def test_a_flat_trajectory_integrates_out():
    """Velocities given positions have one log determinant, whatever the positions: the information
    left of the positions, by the Schur complement, is 0."""
    dt, T = 0.5, 4
    H = np.zeros((4 * T, 4 * T))
    for k in range(T - 1):
        part = velocity_of_positions(dt, 0.7 * np.eye(2))
        J = np.hstack(part.A)
        H[4 * k : 4 * k + 8, 4 * k : 4 * k + 8] += J.T @ J
    J = np.hstack(velocity_of_positions(dt, 0.7 * np.eye(2), last=True).A)
    H[-8:, -8:] += J.T @ J
    p = [4 * k + i for k in range(T) for i in (0, 1)]
    v = [4 * k + i for k in range(T) for i in (2, 3)]
    left = H[np.ix_(p, p)] - H[np.ix_(p, v)] @ np.linalg.solve(H[np.ix_(v, v)], H[np.ix_(v, p)])
    np.testing.assert_allclose(left, 0, atol=1e-10)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: KeepOut(SQUARE, sigma=0.0), "sigma"),
        (lambda: KeepIn(SQUARE, weight=-1.0), "weight"),
        (lambda: Arrival(SQUARE, 0.4, 0.5), "tau"),
        (lambda: Arrival(SQUARE, 0.0, 0.0), "dt"),
        (lambda: SpeedZone(SQUARE, -1.0), "limit"),
        (lambda: SpeedZone(SQUARE, 1.0, blend=0.0), "blend"),
        (lambda: PassingSide(np.zeros(2), np.ones(2), "up"), "side"),
        (lambda: PassingSide(np.zeros(2), np.zeros(2), "left"), "direction"),
        (lambda: PassingSide(np.zeros(2), np.ones(2), "left", length=0.0), "length"),
        (lambda: StayBehind(np.zeros(2), np.zeros(2)), "direction"),
        (lambda: formation(np.zeros((1, 2)), np.zeros((1, 2)), np.zeros(2), 0.1), "direction"),
        (lambda: formation(np.zeros((1, 2)), np.ones((1, 2)), np.zeros(2), 0.0), "sigma"),
        (lambda: velocity_of_positions(0.0, np.eye(2)), "dt"),
        (lambda: velocity_of_positions(0.1, -np.eye(2)), "Qc"),
    ],
)
def test_what_makes_no_sense_is_refused(make, says):
    with pytest.raises(ValueError, match=says):
        make()
