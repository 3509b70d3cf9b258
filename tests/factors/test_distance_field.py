"""The signed distance field against linear functions, central differences and its own bound."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.distance_field import FAR, Outside, SignedDistanceField

YAWS = (0.0, 0.7, -2.3)


def field(seed: int = 0, yaw: float = 0.4, outside: Outside = Outside.LOWER_BOUND):
    values = np.random.default_rng(seed).normal(size=(7, 9))
    return SignedDistanceField(values, np.array([-1.0, 2.0]), 0.25, yaw, outside)


def to_map(f: SignedDistanceField, nodes: np.ndarray) -> np.ndarray:
    """Points (..., 2) given in (column, row) units, in the map frame."""
    c, s = np.cos(f.yaw), np.sin(f.yaw)
    return f.origin + f.resolution * nodes @ np.array([[c, s], [-s, c]])


def nodes_inside(seed: int, count: int = 40) -> np.ndarray:
    """Places inside cells, away from the edges where the gradient jumps."""
    rng = np.random.default_rng(seed)
    return rng.integers([0, 0], [8, 6], (count, 2)) + rng.uniform(0.05, 0.95, (count, 2))


def test_nodes_are_reproduced():
    f = field()
    j, i = np.meshgrid(np.arange(9), np.arange(7))
    points = to_map(f, np.stack([j, i], axis=-1).astype(float))
    np.testing.assert_allclose(f.distance(points), f.values, atol=1e-12)


@pytest.mark.parametrize("yaw", YAWS)
def test_linear_function_is_reproduced_exactly(yaw):
    c, s = np.cos(yaw), np.sin(yaw)
    slope, offset = np.array([0.3, -1.2]), 0.7
    origin, resolution = np.array([2.0, -3.0]), 0.1
    j, i = np.meshgrid(np.arange(12), np.arange(10))
    nodes = origin + resolution * np.stack([c * j - s * i, s * j + c * i], axis=-1)
    f = SignedDistanceField(nodes @ slope + offset, origin, resolution, yaw)
    points = to_map(f, np.random.default_rng(1).uniform([0, 0], [11, 9], (5, 20, 2)))
    d, gradient, hessian = f.expand(points)
    assert d.shape == (5, 20)
    np.testing.assert_allclose(d, points @ slope + offset, atol=1e-12)
    np.testing.assert_allclose(gradient, np.broadcast_to(slope, (5, 20, 2)), atol=1e-10)
    np.testing.assert_allclose(hessian, np.zeros((5, 20, 2, 2)), atol=1e-9)


@pytest.mark.parametrize("outside", list(Outside))
@pytest.mark.parametrize("yaw", YAWS)
def test_derivatives_match_central_differences(yaw, outside):
    f = field(yaw=yaw, outside=outside)
    around = np.array(
        [[-3.3, 2.4], [12.2, 3.6], [4.5, -2.0], [3.3, 9.0], [-2.0, -1.5], [10.1, 8.2]]
    )
    points = to_map(f, np.vstack([nodes_inside(2), around]))
    d, gradient, hessian = f.expand(points)
    np.testing.assert_allclose(d, f.distance(points), atol=1e-14)
    step = 1e-5
    for axis in range(2):
        e = step * np.eye(2)[axis]
        difference = (f.distance(points + e) - f.distance(points - e)) / (2 * step)
        np.testing.assert_allclose(gradient[:, axis], difference, atol=1e-6)
        difference = (f.linearize(points + e)[1] - f.linearize(points - e)[1]) / (2 * step)
        np.testing.assert_allclose(hessian[:, axis], difference, atol=1e-5)


@pytest.mark.parametrize("yaw", YAWS)
def test_continuous_across_the_border(yaw):
    f = field(yaw=yaw)
    t = np.linspace(0, 1, 30)[:, None]
    ring = np.vstack([a + t * (b - a) for a, b in zip(*_corners(), strict=True)])
    outward = ring - np.array([4.0, 3.0])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    inner, outer = to_map(f, ring - 1e-9 * outward), to_map(f, ring + 1e-9 * outward)
    np.testing.assert_allclose(f.distance(inner), f.distance(outer), atol=1e-7)


def _corners() -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([[0.0, 0], [8, 0], [8, 6], [0, 6]])
    return corners, np.roll(corners, -1, axis=0)


@given(st.integers(0, 10_000), st.floats(-30, 30), st.floats(-30, 30))
@settings(max_examples=50, deadline=None)
def test_outside_is_the_border_minus_the_way_to_it(seed, u, v):
    f = field(seed)
    point, border = (to_map(f, np.array(q)) for q in ([u, v], [np.clip(u, 0, 8), np.clip(v, 0, 6)]))
    expected = f.distance(border) - np.linalg.norm(point - border)
    np.testing.assert_allclose(f.distance(point), expected, atol=1e-9)


def test_gradient_outside_leads_back_in():
    f = field()
    nodes = np.array(
        [[-4.0, 3.0], [12.0, 3.0], [4.0, -5.0], [4.0, 11.0], [-3.0, -3.0], [12.0, 9.0]]
    )
    points = to_map(f, nodes)
    inwards = to_map(f, np.clip(nodes, 0, [8, 6])) - points
    assert np.all(np.einsum("ij,ij->i", f.linearize(points)[1], inwards) > 0)


def test_free_outside_is_far_and_flat_and_the_border_itself_is_inside():
    f = field(yaw=0.0, outside=Outside.FREE)
    d, gradient, hessian = f.expand(to_map(f, np.array([[-0.01, 3.0], [8.01, 3.0], [9.0, 7.0]])))
    assert np.all(d == FAR)
    assert not np.any(gradient)
    assert not np.any(hessian)
    assert f.distance(to_map(f, np.array([8.0, 6.0]))) == pytest.approx(f.values[-1, -1])


def test_hessian_has_only_the_mixed_term_in_the_grid_frame():
    f = field(yaw=0.0)
    hessian = f.expand(to_map(f, nodes_inside(3)))[2]
    assert not np.any(hessian[:, 0, 0])
    assert not np.any(hessian[:, 1, 1])
    np.testing.assert_array_equal(hessian[:, 0, 1], hessian[:, 1, 0])


def test_nan_gives_nan_and_leaves_other_points_alone():
    f = field()
    d, gradient, hessian = f.expand(np.array([[np.nan, 0.0], [0.0, np.nan], [0.0, 2.5]]))
    assert np.isnan(d).tolist() == [True, True, False]
    assert np.all(np.isfinite(gradient[2]))
    assert np.all(np.isfinite(hessian[2]))


@pytest.mark.parametrize(
    ("values", "origin", "resolution", "message"),
    [
        (np.zeros((1, 5)), (0, 0), 0.1, "2 columns, got shape"),
        (np.zeros(5), (0, 0), 0.1, "2 columns, got shape"),
        (np.zeros((3, 3)), (0, 0, 0), 0.1, "origin has shape"),
        (np.zeros((3, 3)), (0, 0), 0.0, "resolution must be positive"),
        (np.zeros((3, 3)), (0, 0), np.nan, "resolution must be positive"),
        (np.full((3, 3), np.nan), (0, 0), 0.1, "must be finite"),
        (np.zeros((3, 3)), (0, np.inf), 0.1, "must be finite"),
    ],
)
def test_bad_input_raises(values, origin, resolution, message):
    with pytest.raises(ValueError, match=message):
        SignedDistanceField(values, np.array(origin, dtype=float), resolution)
