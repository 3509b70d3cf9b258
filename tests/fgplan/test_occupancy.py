"""Occupancy grids: ROS's rules for map files, conservative polygons, distances to cell edges."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from fgplan.errors import MapError
from fgplan.occupancy import NO_OBSTACLE, OccupancyGrid

FIELDS = {
    "image": "map.pgm",
    "resolution": 0.05,
    "origin": [-1.0, 2.0, 0.0],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}


def write_map(folder: Path, pixels, name="map.pgm", **changes) -> Path:
    """A map file with these pixels (top row first); a field changed to None is left out."""
    Image.fromarray(np.asarray(pixels, dtype=np.uint8)).save(folder / name)
    fields = {k: v for k, v in (FIELDS | {"image": name} | changes).items() if v is not None}
    path = folder / "map.yaml"
    path.write_text(yaml.safe_dump(fields))
    return path


# Map files


def test_trinary_map_and_the_top_row_is_the_highest_y(tmp_path):
    grid = OccupancyGrid.load(write_map(tmp_path, [[0, 254, 205], [254, 254, 254]]))
    assert grid.data.tolist() == [[0, 0, 0], [100, 0, -1]]
    assert grid.data.dtype == np.int8
    assert grid.resolution == 0.05
    np.testing.assert_array_equal(grid.origin, [-1.0, 2.0, 0.0])
    np.testing.assert_allclose(grid.cell_to_world([1, 0]), [-0.975, 2.075])


def test_205_is_unknown_with_ros_threshold_and_free_with_a_careless_one(tmp_path):
    assert OccupancyGrid.load(write_map(tmp_path, [[205]])).data.tolist() == [[-1]]
    careless = write_map(tmp_path, [[205]], free_thresh=0.25)
    assert OccupancyGrid.load(careless).data.tolist() == [[0]]


@pytest.mark.parametrize("negate", [1, True])
def test_negate_turns_light_into_obstacles(tmp_path, negate):
    grid = OccupancyGrid.load(write_map(tmp_path, [[0, 255]], negate=negate))
    assert grid.data.tolist() == [[0, 100]]
    plain = OccupancyGrid.load(write_map(tmp_path, [[0, 255]], negate=False))
    assert plain.data.tolist() == [[100, 0]]


def test_scale_map_is_linear_between_the_thresholds(tmp_path):
    shades = np.arange(256)
    path = write_map(tmp_path, [shades], mode="scale", occupied_thresh=0.8, free_thresh=0.2)
    p = (255 - shades) / 255
    between = [round(100 * (q - 0.2) / 0.6) for q in p]
    expected = [100 if q >= 0.8 else 0 if q <= 0.2 else b for q, b in zip(p, between, strict=True)]
    grid = OccupancyGrid.load(path)
    assert grid.data[0].tolist() == expected
    np.testing.assert_array_equal(grid.occupied[0], np.array(expected) >= 65)


def test_raw_map_is_the_pixels_and_more_than_100_is_unknown(tmp_path):
    grid = OccupancyGrid.load(write_map(tmp_path, [[0, 64, 65, 100, 101, 255]], mode="raw"))
    assert grid.data.tolist() == [[0, 64, 65, 100, -1, -1]]
    assert grid.occupied.tolist() == [[False, False, True, True, False, False]]


@pytest.mark.parametrize(("mode", "expected"), [("trinary", -1), ("scale", -1), ("raw", 0)])
def test_transparent_pixels_are_unknown_except_in_raw_mode(tmp_path, mode, expected):
    pixels = np.array([[[0, 0, 0, 254], [0, 0, 0, 255]]])
    grid = OccupancyGrid.load(write_map(tmp_path, pixels, name="map.png", mode=mode))
    assert grid.data.tolist() == [[expected, 0 if mode == "raw" else 100]]


def test_colours_are_averaged(tmp_path):
    pixels = np.array([[[0, 0, 255], [255, 255, 252]]])  # p = 2/3 and 0.004
    assert OccupancyGrid.load(write_map(tmp_path, pixels, name="m.png")).data.tolist() == [[100, 0]]


def test_unknown_is_free_unless_asked(tmp_path):
    path = write_map(tmp_path, [[205, 254]])
    assert OccupancyGrid.load(path).occupied.tolist() == [[False, False]]
    assert OccupancyGrid.load(path, unknown_is_free=False).occupied.tolist() == [[True, False]]


@pytest.mark.parametrize("values", [(-1, 0, 100), tuple(range(-1, 101))])
def test_saved_map_comes_back_the_same(tmp_path, values):
    data = np.random.default_rng(0).choice(values, (17, 23)).astype(np.int8)
    grid = OccupancyGrid(data, 0.07, np.array([-3.2, 1.1, 0.4]))
    grid.save(tmp_path / "copy.yaml")
    copy = OccupancyGrid.load(tmp_path / "copy.yaml")
    np.testing.assert_array_equal(copy.data, data)
    assert copy.resolution == 0.07
    np.testing.assert_array_equal(copy.origin, grid.origin)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"image": "nowhere.pgm"}, "image"),
        ({"image": 3}, "image"),
        ({"image": None}, "image"),
        ({"resolution": None}, "resolution"),
        ({"origin": None, "negate": None}, "origin, negate"),
        ({"resolution": 0.0}, "resolution"),
        ({"resolution": -0.1}, "resolution"),
        ({"resolution": "fine"}, "resolution"),
        ({"resolution": float("inf")}, "resolution"),
        ({"origin": [0.0, float("nan"), 0.0]}, "origin"),
        ({"origin": [0.0, 0.0]}, "origin"),
        ({"origin": "here"}, "origin"),
        ({"negate": 2}, "negate"),
        ({"negate": "no"}, "negate"),
        ({"mode": "binary"}, "mode"),
        ({"occupied_thresh": 0.1}, "occupied_thresh"),
        ({"occupied_thresh": 0.196}, "occupied_thresh"),
        ({"occupied_thresh": 65}, "occupied_thresh"),
        ({"occupied_thresh": True}, "occupied_thresh"),
        ({"free_thresh": -0.1}, "free_thresh"),
        ({"free_thresh": float("nan")}, "free_thresh"),
    ],
)
def test_wrong_field_is_named_with_the_file(tmp_path, changes, field):
    path = write_map(tmp_path, [[0, 254]])
    path.write_text(yaml.safe_dump({k: v for k, v in (FIELDS | changes).items() if v is not None}))
    with pytest.raises(MapError, match=rf"map\.yaml: (got no )?{field}"):
        OccupancyGrid.load(path)


@pytest.mark.parametrize("text", ["", "- 1\n- 2\n", "image: [", "image: \x00"])
def test_file_that_is_no_map_raises(tmp_path, text):
    (tmp_path / "map.yaml").write_text(text)
    with pytest.raises(MapError, match=r"map\.yaml"):
        OccupancyGrid.load(tmp_path / "map.yaml")


def test_missing_file_raises(tmp_path):
    with pytest.raises(MapError, match=r"none\.yaml.*No such file"):
        OccupancyGrid.load(tmp_path / "none.yaml")


@pytest.mark.parametrize("content", [b"", b"not an image", b"P5\n4 4\n255\n\x00"])
def test_unreadable_image_raises(tmp_path, content):
    path = write_map(tmp_path, [[0]])
    (tmp_path / "map.pgm").write_bytes(content)
    with pytest.raises(MapError, match=r"image: got 'map\.pgm'"):
        OccupancyGrid.load(path)


# Arrays and polygons


@pytest.mark.parametrize(
    ("data", "resolution", "origin", "field"),
    [
        (np.zeros((0, 4), np.int8), 0.1, (0, 0, 0), "data"),
        (np.zeros(4, np.int8), 0.1, (0, 0, 0), "data"),
        (np.zeros((2, 2)), 0.1, (0, 0, 0), "data"),
        (np.full((2, 2), 101), 0.1, (0, 0, 0), "data"),
        (np.full((2, 2), -2), 0.1, (0, 0, 0), "data"),
        (np.zeros((2, 2), np.int8), 0.0, (0, 0, 0), "resolution"),
        (np.zeros((2, 2), np.int8), np.nan, (0, 0, 0), "resolution"),
        (np.zeros((2, 2), np.int8), 0.1, (0, 0, np.inf), "origin"),
        (np.zeros((2, 2), np.int8), 0.1, (0, 0), "origin"),
    ],
)
def test_grid_that_makes_no_sense_raises(data, resolution, origin, field):
    with pytest.raises(MapError, match=f"^{field}: got"):
        OccupancyGrid(data, resolution, np.array(origin, dtype=float))


def test_array_of_numbers_is_not_taken_for_booleans():
    with pytest.raises(MapError, match="give booleans"):
        OccupancyGrid.from_array(np.zeros((2, 2)), 0.1)


@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_polygon_marks_every_cell_that_it_touches_and_no_other(seed):
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 8)))
    reach = rng.uniform(0.2, 1.2, len(angles))[:, None]
    vertices = rng.uniform(0.5, 1.5, 2) + reach * np.stack([np.cos(angles), np.sin(angles)], -1)
    grid = OccupancyGrid.from_polygons([vertices], (0.0, 0.0, 2.0, 2.0), 0.1)
    # Oracle: even-odd rule at many points of the map.
    points = rng.uniform(0, 2, (4000, 2))
    inside = _even_odd(points, vertices)
    assert np.all(grid.is_occupied(points[inside]))
    # A marked cell is touched: its centre is inside, or within half a diagonal of an edge.
    centres = grid.cell_to_world(np.argwhere(grid.occupied))
    near = _distance_to_edges(centres, vertices) <= 0.1 * np.sqrt(0.5) + 1e-9
    assert np.all(near | _even_odd(centres, vertices))


def test_an_outline_that_winds_around_twice_has_no_hole():
    """A pentagram's middle, and a square that is outlined twice."""
    angle = 2 * np.pi * np.array([0, 2, 4, 1, 3]) / 5
    star = 1.0 + 0.9 * np.column_stack([np.cos(angle), np.sin(angle)])
    square = np.array([[0.5, 0.5], [1.5, 0.5], [1.5, 1.5], [0.5, 1.5]])
    for outline in (star, star[::-1], np.vstack([square, square])):
        grid = OccupancyGrid.from_polygons([outline], (0.0, 0.0, 2.0, 2.0), 0.05)
        assert grid.is_occupied(np.array([1.0, 1.0]))
        assert not grid.is_occupied(np.array([0.1, 0.1]))


def _even_odd(points, vertices):
    inside = np.zeros(len(points), dtype=bool)
    for (ax, ay), (bx, by) in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
        if ay != by:
            crosses = (ay > points[:, 1]) != (by > points[:, 1])
            inside ^= crosses & (points[:, 0] < ax + (points[:, 1] - ay) * (bx - ax) / (by - ay))
    return inside


def _distance_to_edges(points, vertices):
    best = np.full(len(points), np.inf)
    for a, b in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
        t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)[:, None]
        best = np.minimum(best, np.linalg.norm(points - a - t * (b - a), axis=1))
    return best


def test_square_on_cell_edges_also_marks_the_cells_it_touches():
    grid = OccupancyGrid.from_polygons(
        [[(0.2, 0.2), (0.4, 0.2), (0.4, 0.4), (0.2, 0.4)]], (0, 0, 1, 1), 0.1
    )
    expected = np.zeros((10, 10), dtype=bool)
    expected[1:5, 1:5] = True
    np.testing.assert_array_equal(grid.occupied, expected)


def test_border_closes_the_map_and_bounds_are_kept():
    grid = OccupancyGrid.from_polygons([], (-1, -2, 3, 4), 0.1, border=True)
    assert grid.data.shape == (60, 40)
    np.testing.assert_allclose(grid.bounds, (-1, -2, 3, 4))
    assert grid.occupied.sum() == 2 * 60 + 2 * 40 - 4
    assert not grid.occupied[1:-1, 1:-1].any()


@pytest.mark.parametrize(
    ("polygons", "bounds", "resolution", "field"),
    [
        ([[(0, 0), (1, 1)]], (0, 0, 1, 1), 0.1, r"polygons\[0\]"),
        ([[(0, 0), (1, 1), (0, np.nan)]], (0, 0, 1, 1), 0.1, r"polygons\[0\]"),
        ([], (0, 0, 0, 1), 0.1, "bounds"),
        ([], (0, 0, np.inf, 1), 0.1, "bounds"),
        ([], (0, 0, 1, 1), -0.1, "resolution"),
    ],
)
def test_polygons_that_make_no_sense_raise(polygons, bounds, resolution, field):
    with pytest.raises(MapError, match=f"^{field}: got"):
        OccupancyGrid.from_polygons(polygons, bounds, resolution)


# Places


@pytest.mark.parametrize("yaw", [0.0, 0.6, -2.0])
def test_cells_and_points_are_inverse(yaw):
    data = np.zeros((6, 9), dtype=np.int8)
    grid = OccupancyGrid(data, 0.2, np.array([3.0, -1.0, yaw]))
    cells = np.argwhere(data == 0)
    np.testing.assert_array_equal(grid.world_to_cell(grid.cell_to_world(cells)), cells)
    assert np.all(grid.contains(grid.cell_to_world(cells)))
    assert not np.any(grid.contains(grid.cell_to_world([[-1, 0], [6, 0], [0, -1], [0, 9]])))
    x0, y0, x1, y1 = grid.bounds
    centres = grid.cell_to_world(cells)
    assert np.all((centres > [x0, y0]) & (centres < [x1, y1]))


def test_points_must_be_finite():
    grid = OccupancyGrid.from_array(np.zeros((3, 3), dtype=bool), 0.1)
    with pytest.raises(ValueError, match="must be finite"):
        grid.contains([np.nan, 0.0])


# Distances


def test_distance_is_zero_on_the_edge_of_a_wall_with_slope_one_through_it():
    occupied = np.zeros((20, 30), dtype=bool)
    occupied[:, 10:16] = True
    grid = OccupancyGrid.from_array(occupied, 0.1)
    x = np.linspace(0.75, 1.25, 21)
    points = np.stack([x, np.full_like(x, 1.03)], axis=-1)
    np.testing.assert_allclose(grid.distance_field.distance(points), 1.0 - x, atol=1e-12)
    np.testing.assert_allclose(grid.clearance(points, 0.3), 0.7 - x, atol=1e-12)


@given(st.integers(0, 10_000), st.floats(-3, 3))
@settings(max_examples=30, deadline=None)
def test_distance_at_cell_centres_is_right_to_a_fifth_of_a_cell(seed, yaw):
    rng = np.random.default_rng(seed)
    occupied = rng.random((12, 15)) < 0.1
    occupied[rng.integers(12), rng.integers(15)] = True
    grid = OccupancyGrid.from_array(occupied, 0.2, (1.0, 2.0, yaw))
    cells = np.argwhere(~occupied)
    apart = np.abs(cells[:, None] - np.argwhere(occupied)[None])
    exact = 0.2 * np.linalg.norm(np.maximum(apart - 0.5, 0), axis=-1).min(axis=1)
    error = grid.distance_field.distance(grid.cell_to_world(cells)) - exact
    assert error.min() > -1e-9
    assert error.max() < 0.2 * (np.sqrt(2) - 1) / 2 + 1e-9


def test_map_without_obstacles_is_far_from_everything():
    grid = OccupancyGrid.from_array(np.zeros((5, 5), dtype=bool), 0.1)
    assert grid.clearance([0.25, 0.25], 0.2) == pytest.approx(NO_OBSTACLE - 0.2)


def test_map_full_of_obstacles_is_deep_inside():
    grid = OccupancyGrid.from_array(np.ones((5, 5), dtype=bool), 0.1)
    assert grid.distance_field.distance([0.25, 0.25]) == pytest.approx(-NO_OBSTACLE)


@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (6, 1)])
def test_map_of_one_row_or_column_has_distances(shape):
    occupied = np.zeros(shape, dtype=bool)
    occupied[-1, -1] = True
    grid = OccupancyGrid.from_array(occupied, 0.1)
    assert grid.clearance(grid.cell_to_world([0, 0]), 0.0) == pytest.approx(
        0.1 * (max(shape) - 1.5) if max(shape) > 1 else -NO_OBSTACLE
    )


# Sight


def test_wall_hides_what_is_behind_it():
    occupied = np.zeros((20, 20), dtype=bool)
    occupied[5:15, 10] = True
    grid = OccupancyGrid.from_array(occupied, 0.1)
    a = np.array([0.55, 1.0])
    b = np.array([[1.55, 1.0], [0.95, 1.0], [1.25, 1.95], [0.55, 0.05], [0.55, 1.0], [5.0, 1.0]])
    assert grid.line_of_sight(a, b).tolist() == [False, True, True, True, True, False]
    assert grid.line_of_sight(a, b.reshape(2, 3, 2)).shape == (2, 3)
    assert grid.line_of_sight(a, np.zeros((0, 2))).shape == (0,)


def test_cells_of_both_ends_hide_nothing():
    occupied = np.zeros((10, 10), dtype=bool)
    occupied[5, [2, 7]] = True
    grid = OccupancyGrid.from_array(occupied, 0.1)
    assert grid.line_of_sight([0.25, 0.55], [[0.75, 0.55]]).tolist() == [True]
    assert grid.line_of_sight([0.25, 0.55], [[0.95, 0.55]]).tolist() == [False]


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_sight_goes_both_ways(seed):
    rng = np.random.default_rng(seed)
    grid = OccupancyGrid.from_array(rng.random((15, 15)) < 0.2, 0.1)
    a, b = rng.uniform(0, 1.5, (2, 2))
    assert grid.line_of_sight(a, b[None])[0] == grid.line_of_sight(b, a[None])[0]
