"""Motion of a robot that cannot slide sideways: against physics, quadrature and GTSAM."""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from factors.distance_field import SignedDistanceField
from factors.gp_prior import GPPrior
from factors.kinematics import (
    CurvatureLimit,
    LinearLimit,
    RestBetweenDirections,
    SpeedLimit,
)
from factors.obstacle import InterpolatedObstacle
from factors.residual import Linear, Residual
from factors.unicycle import InPlane, UnicycleMotion, advance, planar, slip, unicycle_prior
from tests.factor_testing import check_derivatives

DT = 0.4
speeds, turns, angles = st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(-7, 7)
RNG = np.random.default_rng(0)
STATE = np.array([0.3, -0.2, 0.7, 0.8, -0.5])
NEXT = np.array([0.6, -0.1, 0.9, 1.1, 0.4])
BACK = np.array([0.6, -0.1, 0.9, -0.7, 0.4])


def twisted(theta: float, v: float, omega: float) -> tuple[Any, Any]:
    """Two states on the exponential map of a constant twist."""
    start = gtsam.Pose2(1.0, -2.0, theta)
    end = start.compose(gtsam.Pose2.Expmap(np.array([v, 0.0, omega]) * DT))
    return (
        np.array([start.x(), start.y(), theta, v, omega]),
        np.array([end.x(), end.y(), theta + omega * DT, v, omega]),
    )


def gtsam_error(before: Any, after: Any) -> Any:
    """GTSAM's WNOA factor on SE(2), with the body velocity (v, 0, ω), unwhitened."""
    data = [gtsam.StateData(10 * i, 10 * i + 1, DT * i) for i in range(2)]
    factor = gtsam.WnoaMotionFactorPose2(*data, np.ones(3))
    values = gtsam.Values()
    for i, x in enumerate((before, after)):
        values.insert(10 * i, gtsam.Pose2(x[0], x[1], x[2]))
        values.insert(10 * i + 1, np.array([x[3], 0.0, x[4]]))
    return factor.unwhitenedError(values)


@given(angles, speeds, turns)
def test_constant_twist_has_zero_error_here_and_in_gtsam(th: float, v: float, w: float) -> None:
    before, after = twisted(th, v, w)
    # Next to a straight line (below 1e-5 rad) GTSAM leaves v·φ/2 out of the change of velocity.
    straight = abs(v * w) if abs(w * DT) < 2e-5 else 0.0
    assert_allclose(gtsam_error(before, after), 0.0, atol=1e-11 + straight)
    assert_allclose(UnicycleMotion(DT, 1.0).error(before, after), 0.0, atol=1e-7)
    assert_allclose(unicycle_prior(DT, 1.0, 1.0, 1.0).error(before, after), 0.0, atol=1e-12)


@given(angles, speeds, turns, st.floats(-0.01, 0.01), st.floats(-0.01, 0.01))
def test_sideways_motion_is_an_error_here_and_in_gtsam(
    th: float, v: float, w: float, along: float, across: float
) -> None:
    """Both measure a displaced end alike, to first order, up to a turn of the frame."""
    before, after = twisted(th, v, w)
    after[:2] += along, across
    ours = np.linalg.norm(UnicycleMotion(DT, 1.0).error(before, after))
    assert ours == pytest.approx(np.hypot(along, across), abs=1e-7)
    theirs = np.linalg.norm(gtsam_error(before, after)[:2])
    assert theirs == pytest.approx(ours, rel=0.05, abs=1e-6)  # (φ/2)/tan(φ/2) at 0.6 rad


def missed(v: float, w: float, dv: float, dw: float) -> float:
    """What three Gauss–Legendre nodes can miss of ∫ v exp(iθ) dt over a step [m]: DT⁷/2016000 times
    the largest sixth derivative, where v is linear and θ quadratic in time."""
    speed, turn = max(abs(v), abs(v + dv)), max(abs(w), abs(w + dw))
    a, b = abs(dw) / DT, abs(dv) / DT
    fifth = turn**5 + 10 * turn**3 * a + 15 * turn * a**2
    sixth = turn**6 + 15 * turn**4 * a + 45 * turn**2 * a**2 + 15 * a**3
    return DT**7 / 2016000 * (speed * sixth + 6 * b * fifth)


@given(angles, speeds, turns, st.floats(-0.6, 0.6), st.floats(-1.2, 1.2))
def test_advance_solves_the_differential_equation(
    th: float, v: float, w: float, dv: float, dw: float
) -> None:
    x = np.array([0.5, 0.5, th, v, w])

    def rate(_: float, s: Any) -> list[float]:
        return [s[3] * np.cos(s[2]), s[3] * np.sin(s[2]), s[4], dv / DT, dw / DT]

    exact = solve_ivp(rate, (0, DT), x, rtol=1e-10, atol=1e-12).y[:, -1]
    moved = advance(x, np.array([dv, dw]), DT)
    assert_allclose(moved, exact, atol=1e-9 + missed(v, w, dv, dw))
    assert_allclose(UnicycleMotion(DT, 1.0).error(x, moved), 0.0, atol=1e-12)


def test_error_does_not_depend_on_where_and_which_way() -> None:
    turn, shift = 2.1, np.array([3.0, -4.0])
    c, s = np.cos(turn), np.sin(turn)

    def moved(x: Any) -> Any:
        return np.concatenate([np.array([[c, -s], [s, c]]) @ x[:2] + shift, [x[2] + turn], x[3:]])

    motion = UnicycleMotion(DT, 0.01)
    assert motion.energy(moved(STATE), moved(NEXT)) == pytest.approx(motion.energy(STATE, NEXT))


def test_a_turn_all_the_way_round_changes_no_motion() -> None:
    further = np.array([0, 0, 2 * np.pi, 0, 0])
    motion = UnicycleMotion(DT, 0.01)
    assert_allclose(motion.error(STATE + further, NEXT), motion.error(STATE, NEXT), atol=1e-9)


def test_prior_and_motion_are_a_density_of_the_next_state() -> None:
    """Its integral over the next state is 1: by importance sampling from a wider Gaussian."""
    prior, motion = unicycle_prior(DT, 0.8, 0.5, 0.2), UnicycleMotion(DT, 0.3)
    mean = advance(STATE, np.zeros(2), DT)
    scale = np.array([1.2, 1.2, 0.6, 1.1, 0.9])
    z = RNG.standard_normal((400_000, 5))
    samples = mean + scale * z
    now = np.broadcast_to(STATE, samples.shape)
    log_p = -prior.energy(now, samples) - motion.energy(now, samples)
    log_p += prior.log_normalizer + motion.log_normalizer
    log_q = -0.5 * (z**2).sum(-1) - np.log(scale).sum() - 2.5 * np.log(2 * np.pi)
    weights = np.exp(log_p - log_q)
    error = weights.std() / np.sqrt(len(weights))
    assert error < 0.01
    assert weights.mean() == pytest.approx(1.0, abs=4 * error)


def test_slip_is_the_defect_in_metres() -> None:
    x = np.array([0.0, 0.0, 0.3, 0.5, 0.2])
    path = np.stack([x, advance(x, np.array([0.1, 0.2]), DT)])
    assert_allclose(slip(path, DT), 0.0, atol=1e-15)
    path[1, :2] += 0.003, 0.004
    assert_allclose(slip(path, DT), 0.005)


def field() -> SignedDistanceField:
    rows, cols = np.mgrid[0:30, 0:30]
    return SignedDistanceField(np.hypot(rows - 20, cols - 17) * 0.1 - 0.4, np.zeros(2) - 1, 0.1)


RESIDUALS: list[tuple[Residual, int]] = [
    (UnicycleMotion(DT, 0.5), 2),
    (unicycle_prior(DT, 0.8, 0.5, 0.2), 2),
    (InPlane(GPPrior(DT, np.eye(2))), 2),
    (InPlane(InterpolatedObstacle(field(), 0.25, 0.3, 0.2, DT, 2)), 2),
    (InPlane(SpeedLimit(0.5, 0.2)), 1),
    (CurvatureLimit(0.9, 0.2, 0.7), 1),
    (RestBetweenDirections(0.2, 0.7), 2),
    (LinearLimit((RNG.normal(size=(3, 5)), RNG.normal(size=(3, 5))), np.zeros(3), 0.4), 2),
    (LinearLimit((np.eye(5)[3:],), np.array([0.4, 0.1]), 0.4, 0.5), 1),
]


@pytest.mark.parametrize(("residual", "count"), RESIDUALS, ids=lambda r: type(r).__name__)
def test_derivatives(residual: Residual, count: int) -> None:
    check_derivatives(residual, *(STATE, NEXT)[:count])
    check_derivatives(residual, *(STATE, BACK)[:count])
    check_derivatives(residual, *(NEXT, STATE)[:count])


def test_derivatives_of_a_residual_that_differs_by_step() -> None:
    both = np.stack([STATE, NEXT])
    target = GPPrior(DT, np.eye(2))
    moving = Linear(target.A, RNG.normal(size=(2, 4)))
    check_derivatives(InPlane(moving), both, both[::-1] + 0.1)


@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
def test_curvature_error_is_the_excess(v: float, w: float) -> None:
    excess = max(0.0, 0.8 * abs(w) - abs(v))
    x = np.array([0.0, 0.0, 0.0, v, w])
    assert CurvatureLimit(0.8, 1.0).error(x)[0] == pytest.approx(excess, abs=1.1e-3)


def test_standing_car_is_within_its_curvature() -> None:
    assert CurvatureLimit(0.8, 0.01).energy(np.zeros(5)) == 0.0


@given(speeds, speeds)
def test_a_car_rests_between_directions(before: float, after: float) -> None:
    x = np.zeros((2, 5))
    x[:, 3] = before, after
    expected = max(0.0, -before * after) / 0.1
    assert_allclose(RestBetweenDirections(0.1).error(*x), [expected], atol=1e-12)
    x[1, 3] = 0.0
    assert RestBetweenDirections(0.1).energy(*x) == 0.0


def test_linear_limit_is_one_sided() -> None:
    limit = LinearLimit((np.array([[1.0, 0.0], [0.0, -1.0]]),), np.array([1.0, 0.5]), 0.1)
    assert_allclose(limit.error(np.array([1.2, 0.3])), [2.0, 0.0], atol=1e-12)
    assert_allclose(limit.error(np.array([0.9, -0.6])), [0.0, 1.0], atol=1e-12)


def test_planar_velocity_is_along_the_heading() -> None:
    assert_allclose(planar(np.array([1.0, 2.0, np.pi / 2, -0.5, 3.0])), [1, 2, 0, -0.5], atol=1e-15)


ERRORS: list[tuple[Any, str]] = [
    (lambda: UnicycleMotion(0.0, 0.1), "dt must be positive"),
    (lambda: UnicycleMotion(0.4, np.nan), "sigma must be positive"),
    (lambda: unicycle_prior(0.4, 1.0, -1.0, 0.1), "Qc_yaw must be positive"),
    (lambda: InPlane(UnicycleMotion(0.4, 0.1)), "planar state has size 4"),
    (lambda: CurvatureLimit(0.0, 0.1), "radius must be positive"),
    (lambda: CurvatureLimit(1.0, 0.0), "sigma must be positive"),
    (lambda: RestBetweenDirections(-0.1), "sigma must be positive"),
    (lambda: LinearLimit((np.eye(2),), np.zeros(3), 0.1), "does not fit 3 limits"),
    (lambda: LinearLimit((np.eye(2),), np.zeros(2), 0.0), "sigma must be positive"),
]


@pytest.mark.parametrize(("build", "message"), ERRORS)
def test_documented_errors(build: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build()
