"""Beliefs from tracks against dense Gaussian process regression, and the field of view."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgplan.crowd import Belief, believe, heading, seen, visible
from fgplan.occupancy import OccupancyGrid
from fgplan.scenario import FieldOfView, Robot, Scenario, Track

QC, SIGMA, SPEED = 0.029, 0.043, 1.5


def process(dt: float, Qc: float = QC) -> tuple[np.ndarray, np.ndarray]:
    """Phi and Q of one axis over dt."""
    return (
        np.array([[1.0, dt], [0.0, 1.0]]),
        Qc * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]),
    )


def dense(track: Track, ahead: np.ndarray, now: float) -> tuple[np.ndarray, np.ndarray]:
    """Oracle: all states of one person at once, as one least-squares problem solved by QR.

    One unknown (p, v) per distinct time stamp; rows are the prior of the first velocity, the
    motion between time stamps and the measurements, each whitened. Returns the mean (S, 4) and
    covariance (S, 4, 4) at now + ahead.
    """
    stamps = np.unique(np.concatenate([track.times, now + ahead]))
    columns = 2 * len(stamps)
    rows, sides = [np.eye(1, columns, 1) / SPEED], [np.zeros((1, 2))]
    for k, dt in enumerate(np.diff(stamps)):
        Phi, Q = process(dt)
        block = np.zeros((2, columns))
        block[:, 2 * k : 2 * k + 4] = np.linalg.solve(
            np.linalg.cholesky(Q), np.hstack([-Phi, np.eye(2)])
        )
        rows.append(block)
        sides.append(np.zeros((2, 2)))
    for t, position in zip(track.times, track.positions, strict=True):
        rows.append(np.eye(1, columns, 2 * int(np.searchsorted(stamps, t))) / SIGMA)
        sides.append(position[None] / SIGMA)
    orthogonal, R = np.linalg.qr(np.vstack(rows))
    root = np.linalg.inv(R)
    state, covariance = root @ orthogonal.T @ np.vstack(sides), root @ root.T
    mean, full = np.zeros((len(ahead), 4)), np.zeros((len(ahead), 4, 4))
    for s, t in enumerate(now + ahead):
        k = 2 * int(np.searchsorted(stamps, t))
        mean[s] = state[k : k + 2].ravel()
        full[s] = np.kron(covariance[k : k + 2, k : k + 2], np.eye(2))
    return mean, full


def walk(rng: np.random.Generator, size: int, now: float, identity: str = "p") -> Track:
    """A track with irregular sampling that ends at or before `now`."""
    gaps = np.cumsum(rng.uniform(0.05, 1.5, size))
    times = now - rng.choice([0.0, 0.3]) - (gaps - gaps[0])[::-1]
    positions = rng.normal(0, 3, 2) + np.outer(times, rng.normal(0, 1, 2))
    return Track(identity, times, positions + rng.normal(0, 0.05, (size, 2)))


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), size=st.integers(1, 12))
def test_belief_equals_dense_gaussian_process_regression(seed: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    track = walk(rng, size, now=2.0)
    belief = believe([track], 2.0, QC, SIGMA, SPEED)
    ahead = np.array([0.0, 0.4, 1.0, 4.8])
    mean, covariance = dense(track, ahead, 2.0)
    means, covariances = belief.predict(ahead)
    np.testing.assert_allclose(means[:, 0], mean, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(covariances[:, 0], covariance, rtol=1e-10, atol=1e-10)


def test_tracks_of_all_lengths_together_equal_each_alone_to_the_bit() -> None:
    rng = np.random.default_rng(3)
    tracks = [walk(rng, size, 5.0, f"p{size}") for size in (1, 7, 2, 20, 3)]
    together = believe(tracks, 5.0, QC, SIGMA, SPEED)
    assert together.names == ("p1", "p7", "p2", "p20", "p3")
    for i, track in enumerate(tracks):
        alone = believe([track], 5.0, QC, SIGMA, SPEED)
        assert np.array_equal(together.mean[i], alone.mean[0])
        assert np.array_equal(together.covariance[i], alone.covariance[0])


def test_one_position_leaves_the_velocity_at_its_prior() -> None:
    track = Track("p", np.array([1.0]), np.array([[2.0, -1.0]]), radius=0.4)
    belief = believe([track], 1.0, QC, SIGMA, SPEED)
    np.testing.assert_array_equal(belief.mean, [[2.0, -1.0, 0.0, 0.0]])
    np.testing.assert_allclose(
        belief.covariance[0], np.diag([SIGMA**2, SIGMA**2, SPEED**2, SPEED**2]), rtol=1e-15
    )
    assert belief.radii.tolist() == [0.4]


def test_exact_straight_walk_is_believed_straight() -> None:
    times = np.arange(-3.2, 0.01, 0.4)
    track = Track("p", times, np.outer(times, [1.2, -0.5]))
    belief = believe([track], 0.0, QC, SIGMA, SPEED)
    # The zero-mean velocity prior holds back a little: sigma_v² / (sigma_v² + var) of the speed.
    np.testing.assert_allclose(belief.mean[0], [0, 0, 1.2, -0.5], atol=0.01)


def test_uncertainty_grows_when_the_last_position_is_old() -> None:
    track = walk(np.random.default_rng(0), 8, now=0.0)
    variances = [
        believe([track], now, QC, SIGMA, SPEED).covariance[0, 0, 0] for now in (0.0, 1.0, 10.0)
    ]
    assert variances[0] < variances[1] < variances[2]


def test_no_people_is_an_empty_belief() -> None:
    belief = believe([], 0.0, QC, SIGMA, SPEED)
    means, covariances = belief.predict(np.array([0.0, 0.4]))
    assert belief.count == 0
    assert means.shape == (2, 0, 4)
    assert covariances.shape == (2, 0, 4, 4)


def test_prediction_now_is_the_belief_itself() -> None:
    belief = believe([walk(np.random.default_rng(1), 5, 0.0)], 0.0, QC, SIGMA, SPEED)
    means, covariances = belief.predict(np.array([0.0]))
    assert np.array_equal(means[0], belief.mean)
    assert np.array_equal(covariances[0], belief.covariance)


def test_prediction_composes_over_time() -> None:
    belief = believe([walk(np.random.default_rng(2), 5, 0.0)], 0.0, QC, SIGMA, SPEED)
    means, covariances = belief.predict(np.array([1.0, 2.5]))
    halfway = Belief(belief.names, means[0], covariances[0], belief.radii, belief.Qc)
    means_again, covariances_again = halfway.predict(np.array([1.5]))
    np.testing.assert_allclose(means_again[0], means[1], rtol=1e-13)
    np.testing.assert_allclose(covariances_again[0], covariances[1], rtol=1e-12, atol=1e-14)


def test_past_cannot_be_predicted() -> None:
    belief = believe([], 0.0, QC, SIGMA, SPEED)
    with pytest.raises(ValueError, match="not be negative"):
        belief.predict(np.array([0.0, -0.1]))


def test_empty_track_is_refused() -> None:
    with pytest.raises(ValueError, match="'p' is empty"):
        believe([Track("p", np.zeros(0), np.zeros((0, 2)))], 0.0, QC, SIGMA, SPEED)


def test_track_from_the_future_is_refused() -> None:
    track = Track("p", np.array([0.0, 0.5]), np.zeros((2, 2)))
    with pytest.raises(ValueError, match="after now"):
        believe([track], 0.4, QC, SIGMA, SPEED)


WALL = OccupancyGrid.from_polygons(
    [[(1.0, -3.0), (1.2, -3.0), (1.2, 0.0), (1.0, 0.0)]], (-3.0, -3.0, 3.0, 3.0), 0.1
)


def at_angle(*angles: float, distance: float = 2.0) -> np.ndarray:
    return distance * np.column_stack([np.cos(angles), np.sin(angles)])


def test_range_is_inclusive_and_sharp() -> None:
    view = FieldOfView(range=5.0)
    points = np.array([[3.0, 4.0], [3.0, np.nextafter(4.0, 5.0)], [0.0, 0.0]])
    assert visible(view, np.zeros(2), 0.0, points, None).tolist() == [True, False, True]


@pytest.mark.parametrize("look", [0.0, 3.0, -3.1, 7.0])
def test_angle_is_the_full_opening_around_the_heading(look: float) -> None:
    view = FieldOfView(angle=1.0)
    points = at_angle(look, look + 0.5, look - 0.5, look + 0.501, look - 0.501, look + np.pi)
    expected = [True, True, True, False, False, False]
    assert visible(view, np.zeros(2), look, points, None).tolist() == expected


def test_person_on_the_robot_is_seen_whatever_the_heading() -> None:
    view = FieldOfView(range=1.0, angle=0.1)
    assert visible(view, np.ones(2), 2.0, np.ones((1, 2)), None).tolist() == [True]


def test_map_hides_people_only_with_occlusion() -> None:
    points = np.array([[2.0, -1.0], [2.0, 1.0]])
    hidden = visible(FieldOfView(), np.zeros(2), 0.0, points, WALL)
    assert hidden.tolist() == [False, True]
    clear = FieldOfView(occlusion=False)
    assert visible(clear, np.zeros(2), 0.0, points, WALL).all()


def test_person_far_beyond_the_map_is_hidden_by_its_walls_all_the_same() -> None:
    points = np.array([[1e6, -5e5], [1e6, 5e5]])
    assert visible(FieldOfView(), np.zeros(2), 0.0, points, WALL).tolist() == [False, True]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_who_is_seen_does_not_depend_on_who_else_is_there(seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-2.9, 2.9, (20, 2))
    together = visible(FieldOfView(range=3.5), np.zeros(2), 0.0, points, WALL)
    alone = [visible(FieldOfView(range=3.5), np.zeros(2), 0.0, p[None], WALL)[0] for p in points]
    assert together.tolist() == alone


def test_heading_is_stated_then_motion_then_goal_then_zero() -> None:
    robot = Robot(np.array([1.0, 1.0]), velocity=np.array([0.0, 1.0]), heading=0.3)
    scenario = Scenario(robot, goal=np.array([0.0, 1.0]))
    assert heading(scenario) == 0.3
    moving = scenario.replace(robot=Robot(robot.position, velocity=robot.velocity))
    assert heading(moving) == pytest.approx(np.pi / 2)
    standing = scenario.replace(robot=Robot(robot.position, velocity=np.array([0.0, 0.05])))
    assert heading(standing) == pytest.approx(np.pi)
    assert heading(standing.replace(goal=None)) == 0.0
    assert heading(standing.replace(goal=robot.position)) == 0.0


def person(identity: str, *positions: tuple[float, float]) -> Track:
    return Track(identity, np.arange(len(positions)) - len(positions) + 1.0, np.array(positions))


def test_latest_position_decides_who_is_seen() -> None:
    scenario = Scenario(
        Robot(np.zeros(2)),
        tracks=(person("left", (1, 0), (9, 0)), person("came", (9, 0), (1, 0))),
        field_of_view=FieldOfView(range=5.0),
    )
    assert [track.identity for track in seen(scenario)] == ["came"]
    everybody = scenario.replace(field_of_view=None)
    assert [track.identity for track in seen(everybody)] == ["left", "came"]


@pytest.mark.parametrize("outside", [(5.0 + 1e-9, 0.0), (0.0, -3.0), (-1.0, 0.0)])
def test_person_outside_leaves_the_belief_bit_identical(outside: tuple[float, float]) -> None:
    """Statement 16. Without the filter of `seen` the names differ and this fails."""
    inside = [person("a", (2.0, 0.1), (2.0, 0.2)), person("b", (3.0, 0.0))]
    stranger = person("c", (4.0, 0.0), (4.5, 0.0), outside)
    view = FieldOfView(range=5.0, angle=np.pi / 2)
    scenario = Scenario(Robot(np.zeros(2)), tracks=tuple(inside), field_of_view=view)
    crowded = scenario.replace(tracks=(inside[0], stranger, inside[1]))
    beliefs = [believe(seen(s), 0.0, QC, SIGMA, SPEED) for s in (scenario, crowded)]
    assert beliefs[0].names == beliefs[1].names
    assert beliefs[0].mean.tobytes() == beliefs[1].mean.tobytes()
    assert beliefs[0].covariance.tobytes() == beliefs[1].covariance.tobytes()


@pytest.mark.parametrize("inside", [(5.0, 0.0), (2.0, -1.999), (2.0, 2.0)])
def test_person_just_inside_is_believed(inside: tuple[float, float]) -> None:
    view = FieldOfView(range=5.0, angle=np.pi / 2)
    scenario = Scenario(Robot(np.zeros(2)), tracks=(person("c", inside),), field_of_view=view)
    assert len(seen(scenario)) == 1
