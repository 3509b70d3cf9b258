"""Routes: clear, distinct, shortest first; against Dijkstra, geometry and winding angles."""

from __future__ import annotations

import heapq
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt, label
from scipy.spatial import cKDTree

from fgplan.errors import NoRoute
from fgplan.occupancy import OccupancyGrid
from fgplan.roadmap import Roadmap, roadmap, square_distance
from fgplan.routes import GOAL_TOLERANCE, find_routes, shortest_path

RADIUS = 0.25


# Maps


def random_map(seed: int, obstacles: int, size: int = 400) -> OccupancyGrid:
    """Boxes and discs in a walled square, cells of 0.05 m."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:size, :size]
    occupied = np.zeros((size, size), dtype=bool)
    occupied[[0, -1]] = occupied[:, [0, -1]] = True
    for _ in range(obstacles):
        centre, half = rng.uniform(20, size - 20, 2), rng.uniform(4, 24, 2)
        if rng.random() < 0.5:
            occupied |= (np.abs(y - centre[0]) < half[0]) & (np.abs(x - centre[1]) < half[1])
        else:
            occupied |= (y - centre[0]) ** 2 + (x - centre[1]) ** 2 < half[0] ** 2
    return OccupancyGrid.from_array(occupied, 0.05)


def random_ends(grid: OccupancyGrid, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Two places far apart, with room for the robot."""
    rng = np.random.default_rng(seed)
    side = grid.bounds[2]
    while True:
        a, b = rng.uniform(0, side, (2, 2))
        if np.linalg.norm(a - b) > 0.5 * side and np.all(grid.clearance([a, b], RADIUS) > 0.03):
            return a, b


def room(*boxes: tuple[float, float, float, float], size=(10.0, 6.0), resolution=0.05):
    """A walled room with boxes (x_min, y_min, x_max, y_max)."""
    e = 1e-6  # a box that ends on a cell's edge does not touch the next cell
    inset = [
        [(a + e, b + e), (c - e, b + e), (c - e, d - e), (a + e, d - e)] for a, b, c, d in boxes
    ]
    return OccupancyGrid.from_polygons(inset, (0, 0, *size), resolution, border=True)


# Oracles


def dense(path: np.ndarray, spacing: float) -> np.ndarray:
    pieces = [
        a + np.linspace(0, 1, int(np.linalg.norm(b - a) / spacing) + 2)[:, None] * (b - a)
        for a, b in pairwise(path)
    ]
    return np.vstack(pieces)


def gap(grid: OccupancyGrid, points: np.ndarray) -> np.ndarray:
    """Distance of points to the nearest of the obstacle squares near them, grid without yaw."""
    centres = grid.cell_to_world(np.argwhere(grid.occupied))
    _, near = cKDTree(centres).query(points, k=min(9, len(centres)))
    apart = np.abs(points[:, None] - centres[near.reshape(len(points), -1)])
    return np.linalg.norm(np.maximum(apart - grid.resolution / 2, 0), axis=-1).min(axis=1)


def pieces_where_the_robot_does_not_fit(grid: OccupancyGrid) -> np.ndarray:
    """One obstacle cell centre of each connected piece of {clearance < radius}."""
    # Of half-cell nodes, every point of a square nearest to a cell centre is one: exact.
    nodes = np.zeros(2 * np.array(grid.occupied.shape) + 1, dtype=bool)
    for i, j in np.ndindex(3, 3):
        nodes[i : i + nodes.shape[0] - 2 : 2, j : j + nodes.shape[1] - 2 : 2] |= grid.occupied
    tight = distance_transform_edt(~nodes)[1::2, 1::2] * grid.resolution / 2 < RADIUS
    labels, count = label(tight, np.ones((3, 3)))
    inner = [
        np.argwhere((labels == number) & grid.occupied)
        for number in range(1, count + 1)
        if number != labels[0, 0]
    ]
    return grid.cell_to_world([cells[0] for cells in inner if len(cells)])


def turns(loop: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Winding number of a closed polyline about each centre: the angle swept, over 2π."""
    ray = loop[:, None] - centres
    angle = np.arctan2(ray[..., 1], ray[..., 0])
    swept = (np.diff(angle, axis=0) + np.pi) % (2 * np.pi) - np.pi
    return np.rint(swept.sum(axis=0) / (2 * np.pi)).astype(int)


def dijkstra(free: np.ndarray, start: tuple[int, int], goal: tuple[int, int]) -> float:
    """Length of the shortest 8-connected path that cuts no corner [cells], written anew."""
    best = {start: 0.0}
    queue = [(0.0, start)]
    rows, cols = free.shape
    while queue:
        done, (i, j) = heapq.heappop(queue)
        if (i, j) == goal:
            return done
        if done > best[i, j]:
            continue
        for di in (-1, 0, 1):
            for dj in (-1, 0, 1):
                u, v = i + di, j + dj
                if (di, dj) == (0, 0) or not (0 <= u < rows and 0 <= v < cols):
                    continue
                if free[u, v] and free[i, v] and free[u, j]:
                    total = done + np.hypot(di, dj)
                    if total < best.get((u, v), np.inf) - 1e-12:
                        best[u, v] = total
                        heapq.heappush(queue, (total, (u, v)))
    return np.inf


# Many random maps


@pytest.mark.parametrize("seed", range(60))
def test_routes_are_clear_distinct_and_sorted(seed):
    grid = random_map(seed, (4, 12, 30)[seed % 3])
    a, b = random_ends(grid, seed)
    routes = find_routes(grid, a, b, RADIUS, 5)
    assert len(routes) == 5 or (seed % 3 == 0 and len(routes) >= 2)  # 4 obstacles: fewer classes
    for route in routes:
        np.testing.assert_array_equal(route.path[0], a)
        np.testing.assert_allclose(route.path[-1], b, atol=1e-9)
        steps = np.linalg.norm(np.diff(route.path, axis=0), axis=1)
        assert route.length == pytest.approx(steps.sum())
    assert gap(grid, np.vstack([dense(r.path, 0.03) for r in routes])).min() >= RADIUS - 1e-9
    assert [r.length for r in routes] == sorted(r.length for r in routes)
    assert [r.label for r in routes] == list("ABCDE")[: len(routes)]
    # The library's classes are told apart by an independent count of windings, about pieces
    # that are labelled independently.
    centres = pieces_where_the_robot_does_not_fit(grid)
    for one, other in combinations(routes, 2):
        assert np.any(turns(np.vstack([one.path, other.path[::-1]]), centres))
        assert one.signature != other.signature
    # The best one beats the shortest lattice path.
    _, lattice = shortest_path(grid, a, b, RADIUS)
    assert routes[0].length <= lattice + 0.05


@pytest.mark.parametrize("seed", range(60))
def test_routes_are_clear_among_scattered_posts_too(seed):
    """Lanes hardly wider than the robot, where bands alone would come too near (seen: without
    the final check 6 of these maps fail)."""
    rng = np.random.default_rng(seed)
    grid = OccupancyGrid.from_array(rng.random((80, 80)) < 0.013, 0.1)
    free = grid.cell_to_world(np.argwhere(roadmap(grid, RADIUS).free))
    try:
        routes = find_routes(grid, free[0], free[-1], RADIUS, 3)
    except NoRoute:
        return
    assert gap(grid, np.vstack([dense(r.path, 0.01) for r in routes])).min() >= RADIUS - 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_signature_is_the_winding_about_each_obstacle_relative_to_the_best(seed):
    grid = random_map(seed, 12)
    a, b = random_ends(grid, seed)
    routes = find_routes(grid, a, b, RADIUS, 6)
    road = roadmap(grid, RADIUS)
    centres = road.to_map(road.obstacles)
    for route in routes:
        loop = np.vstack([route.path, routes[0].path[::-1]])
        # A ray to the right of an obstacle is crossed upwards by a turn to the left.
        np.testing.assert_array_equal(route.signature, turns(loop, centres))


def test_shortest_path_costs_what_dijkstra_says_on_200_random_maps():
    reached = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        occupied = rng.random((18, 22)) < rng.uniform(0.005, 0.03)
        occupied[:7, :7] = False
        grid = OccupancyGrid.from_array(occupied, 0.1)
        radius = rng.uniform(0.2, 0.3)
        road = Roadmap.build(grid, radius)
        # Ends in the middle of lattice cells, so that no more than the lattice counts.
        cells = np.argwhere(road.free)
        start, goal = cells[rng.integers(len(cells), size=2)]
        ends = road.to_map(np.array([start, goal])[:, ::-1])
        expected = dijkstra(road.free, tuple(start), tuple(goal)) * road.cell
        if np.isinf(expected):
            with pytest.raises(NoRoute, match="NO_VALID_PATH"):
                shortest_path(grid, *ends, radius)
            continue
        path, cost = shortest_path(grid, *ends, radius)
        reached += 1
        assert cost == pytest.approx(expected, rel=1e-12)
        assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() == pytest.approx(cost)
        np.testing.assert_allclose(path[[0, -1]], ends, atol=1e-9)
    assert reached > 150


# The roadmap


@given(st.integers(0, 10_000), st.integers(2, 9))
@settings(max_examples=40, deadline=None)
def test_square_distance_matches_brute_force(seed, reach):
    rng = np.random.default_rng(seed)
    occupied = rng.random(rng.integers(1, 14, 2)) < 0.15
    cells = np.argwhere(np.ones_like(occupied))
    apart = np.abs(cells[:, None] - np.argwhere(occupied)[None])
    exact = np.linalg.norm(np.maximum(apart - 0.5, 0), axis=-1)
    exact = exact.min(axis=1, initial=reach).reshape(occupied.shape)
    np.testing.assert_allclose(square_distance(occupied, reach), exact, atol=1e-12)


@given(st.integers(0, 10_000), st.floats(0.3, 5.0))
@settings(max_examples=40, deadline=None)
def test_steps_between_free_cells_keep_the_radius(seed, radius):
    rng = np.random.default_rng(seed)
    occupied = rng.random((24, 24)) < 0.03
    road = Roadmap(occupied, 1.0, np.zeros(2), np.eye(2), radius)
    grid = OccupancyGrid.from_array(occupied, 1.0, (-0.5, -0.5))
    lattice = road.lattice.tocoo()
    if occupied.any() and lattice.nnz:
        share = np.linspace(0, 1, 9)[:, None, None]
        a, b = road.place(lattice.row), road.place(lattice.col)
        assert gap(grid, (a + share * (b - a)).reshape(-1, 2)).min() >= radius - 1e-9


@given(st.integers(0, 10_000), st.floats(0.4, 12.0))
@settings(max_examples=60, deadline=None)
def test_nearest_free_node_is_the_nearest_that_a_straight_line_reaches(seed, within):
    rng = np.random.default_rng(seed)
    occupied = rng.random((24, 24)) < 0.04
    road = Roadmap(occupied, 1.0, np.zeros(2), np.eye(2), 1.2)
    point = rng.uniform(-0.4, 23.4, 2)  # in a free cell, in the rim of an obstacle, or in one
    nodes = np.flatnonzero(road.free)
    away = np.linalg.norm(road.place(nodes) - point, axis=1)
    reached = (away <= within) & ~road.crosses_obstacle(point, road.place(nodes))
    found = road.nearest_free(point, within)
    if not reached.any():
        assert found is None
    else:
        assert found in nodes[reached]
        np.testing.assert_allclose(away[nodes == found], away[reached].min(), atol=1e-5)


@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_clearance_is_a_lower_bound_along_the_whole_segment(seed):
    rng = np.random.default_rng(seed)
    occupied = rng.random((24, 24)) < 0.03
    occupied[5, 5] = True
    road = Roadmap(occupied, 1.0, np.zeros(2), np.eye(2), 2.0)
    grid = OccupancyGrid.from_array(occupied, 1.0, (-0.5, -0.5))
    path = rng.uniform(0, 23, (6, 2))
    bound = road.clearance([path])[0]
    for segment, least in zip(pairwise(path), bound, strict=True):
        assert gap(grid, dense(np.array(segment), 0.01)).min() >= least - 1e-9


def test_a_block_that_reaches_the_rim_is_no_obstacle_to_wind_around():
    grid = room((4.0, 2.0, 5.0, 3.0), (7.0, 0.0, 8.0, 3.0))
    assert len(roadmap(grid, RADIUS).obstacles) == 1


# Small cases


def test_open_space_is_a_straight_line():
    (route,) = find_routes(None, [0.0, 0.0], [3.0, 4.0], RADIUS, 3)
    assert route.length == 5.0
    assert route.label == "A"
    np.testing.assert_array_equal(route.path, [[0, 0], [3, 4]])


def test_empty_room_has_one_route_and_it_is_straight():
    (route,) = find_routes(room(), [1.0, 1.0], [9.0, 5.0], RADIUS, 3)
    assert route.length == pytest.approx(np.hypot(8, 4), rel=1e-4)
    assert route.signature == ()


def test_map_without_any_obstacle():
    grid = OccupancyGrid.from_array(np.zeros((100, 100), dtype=bool), 0.05)
    (route,) = find_routes(grid, [0.01, 0.01], [4.99, 4.0], RADIUS, 3)
    assert route.length == pytest.approx(np.hypot(4.98, 3.99), rel=1e-3)


def test_one_obstacle_is_passed_on_either_side():
    grid = room((4.0, 2.0, 6.0, 3.6))
    near, far = find_routes(grid, [1.0, 3.0], [9.0, 3.0], RADIUS, 5)
    assert near.path[:, 1].max() > 3.6
    assert far.path[:, 1].min() < 2.0
    assert near.signature == (0,)
    assert far.signature == (1,)


def test_mirrored_map_has_mirrored_sides():
    grid = room((4.0, 2.0, 6.0, 3.6))
    mirrored = OccupancyGrid(grid.data[::-1], grid.resolution, grid.origin)
    near, far = find_routes(mirrored, [1.0, 3.0], [9.0, 3.0], RADIUS, 5)
    assert near.path[:, 1].min() < 2.4
    assert (near.signature, far.signature) == ((0,), (-1,))
    plain = find_routes(grid, [1.0, 3.0], [9.0, 3.0], RADIUS, 5)
    np.testing.assert_allclose([near.length, far.length], [r.length for r in plain], rtol=5e-3)


def test_map_turned_by_its_yaw_has_turned_routes():
    grid = room((4.0, 2.0, 6.0, 3.6))
    yaw, shift = 0.8, np.array([3.0, -1.0])
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, s], [-s, c]])
    turned = OccupancyGrid(grid.data, grid.resolution, np.array([*shift, yaw]))
    ends = np.array([[1.013, 3.008], [9.012, 2.993]])  # nowhere near the middle of two cells
    plain = find_routes(grid, *ends, RADIUS, 2)
    there = find_routes(turned, *(ends @ turn + shift), RADIUS, 2)
    for one, other in zip(plain, there, strict=True):
        np.testing.assert_allclose(other.path, one.path @ turn + shift, atol=1e-6)


def test_corners_are_round():
    grid = room((2.0, 0.0, 8.0, 4.0))
    (route,) = find_routes(grid, [1.0, 1.0], [9.0, 1.0], RADIUS, 1)
    step = np.diff(route.path, axis=0)
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    assert np.degrees(np.abs(np.diff(heading))).max() < 30
    # Round both corners on arcs of no less than the radius: the closed form of the taut string.
    x, y = 1.0, 3.0
    touch = np.sqrt(x**2 + y**2 - RADIUS**2)
    angle = np.pi - (np.pi / 2 - np.arctan2(RADIUS, touch) + np.arctan2(x, y)) - np.pi / 2
    shortest = 2 * touch + 6.0 + 2 * RADIUS * (np.pi / 2 - angle) / 2
    assert shortest * 0.97 < route.length < shortest * 1.05


@pytest.mark.parametrize("width", [0.6, 0.7, 0.9])
def test_doorway_wide_enough_is_found(width):
    grid = room((4.0, 0.0, 4.2, 3.0), (4.0, 3.0 + width, 4.2, 6.0))
    (route,) = find_routes(grid, [1.0, 1.0], [9.0, 5.0], RADIUS, 3)
    assert gap(grid, dense(route.path, 0.01)).min() >= RADIUS - 1e-9


def test_doorway_too_narrow_is_not():
    grid = room((4.0, 0.0, 4.2, 3.0), (4.0, 3.45, 4.2, 6.0))
    with pytest.raises(NoRoute, match=r"radius of 0\.25 m") as caught:
        find_routes(grid, [1.0, 1.0], [9.0, 5.0], RADIUS, 3)
    assert caught.value.code == "NO_VALID_PATH"


@pytest.mark.parametrize("radius", [0.0, 0.1, 0.2])
def test_lane_of_one_coarse_cell_is_found_by_a_small_robot(radius):
    occupied = np.zeros((9, 30), dtype=bool)
    occupied[[0, -1]] = occupied[:, [0, -1]] = True
    occupied[:, 10:20] = True
    occupied[4, 10:20] = False
    grid = OccupancyGrid.from_array(occupied, 0.5)
    (route,) = find_routes(grid, [1.5, 1.5], [13.0, 3.0], radius, 3)
    assert gap(grid, dense(route.path, 0.02)).min() >= radius - 1e-9


def test_who_has_no_time_has_the_shortest_route_with_its_corners():
    """One route in any case, as clear as all, and hardly longer than with time."""
    grid = random_map(3, 30)
    a, b = random_ends(grid, 3)
    with_time = find_routes(grid, a, b, RADIUS, 4)
    (route,) = find_routes(grid, a, b, RADIUS, 4, until=-np.inf)
    assert len(with_time) == 4
    assert gap(grid, dense(route.path, 0.01)).min() >= RADIUS - 1e-9
    assert route.length == pytest.approx(with_time[0].length, rel=0.05)
    np.testing.assert_allclose(route.path[[0, -1]], with_time[0].path[[0, -1]])


def test_no_more_routes_than_asked_for():
    grid = random_map(1, 12)
    a, b = random_ends(grid, 1)
    three = find_routes(grid, a, b, RADIUS, 3)
    assert len(three) == 3
    assert len(find_routes(grid, a, b, RADIUS, 1)) == 1


def test_many_routes_have_letters_after_z():
    grid = random_map(2, 30)
    a, b = random_ends(grid, 2)
    labels = [route.label for route in find_routes(grid, a, b, RADIUS, 28)]
    assert labels[25:] == ["Z", "AA", "AB"][: len(labels) - 25]
    assert len(labels) > 26


def test_start_that_is_the_goal():
    (route,) = find_routes(room(), [3.0, 3.0], [3.0, 3.0], RADIUS, 3)
    assert route.length == 0.0
    assert route.path.shape == (2, 2)


def test_start_and_goal_in_one_cell():
    (route,) = find_routes(room(), [3.02, 3.02], [3.01, 3.03], RADIUS, 3)
    np.testing.assert_allclose(route.path[[0, -1]], [[3.02, 3.02], [3.01, 3.03]], atol=1e-9)
    assert route.length < 0.2


def test_same_question_twice_has_the_same_answer():
    grid = random_map(5, 12)
    a, b = random_ends(grid, 5)
    for one, other in zip(
        find_routes(grid, a, b, RADIUS, 4), find_routes(grid, a, b, RADIUS, 4), strict=True
    ):
        np.testing.assert_array_equal(one.path, other.path)


# Where the robot does not fit


def test_robot_too_near_a_wall_leaves_it():
    grid = room((4.0, 2.0, 6.0, 3.6))
    start = np.array([3.9, 3.0])
    routes = find_routes(grid, start, [9.0, 3.0], RADIUS, 2)
    assert len(routes) == 2
    for route in routes:
        np.testing.assert_array_equal(route.path[0], start)
        clear = gap(grid, dense(route.path, 0.01))
        assert clear.min() >= 0.1 - 1e-9
        away = np.linalg.norm(dense(route.path, 0.01) - start, axis=1)
        assert clear[away > 0.3].min() >= RADIUS - 1e-9


def test_goal_too_near_a_wall_is_approached():
    grid = room((4.0, 2.0, 6.0, 3.6))
    goal = np.array([6.05, 3.0])
    for route in find_routes(grid, [1.0, 3.0], goal, RADIUS, 2):
        assert gap(grid, dense(route.path, 0.01)).min() >= RADIUS - 1e-9
        assert np.linalg.norm(route.path[-1] - goal) <= RADIUS + 0.05


def test_goal_in_a_nook_beyond_the_tolerance_is_not():
    grid = room((4.0, 2.0, 6.0, 2.8), (4.0, 3.2, 6.0, 4.0))
    find_routes(grid, [1.0, 3.0], [4.0 + 0.5 * GOAL_TOLERANCE, 3.0], RADIUS, 1)
    with pytest.raises(NoRoute, match=r"within 0\.5 m of goal \(5, 3\)") as caught:
        find_routes(grid, [1.0, 3.0], [5.0, 3.0], RADIUS, 1)
    assert caught.value.code == "NO_VALID_PATH"


def test_start_without_a_way_out_says_so():
    grid = OccupancyGrid.from_array(np.pad([[False]], 4, constant_values=True), 0.05)
    with pytest.raises(NoRoute, match=r"in sight of start") as caught:
        find_routes(grid, [0.225, 0.225], [0.23, 0.23], RADIUS, 1)
    assert caught.value.code == "NO_VALID_PATH"


def test_robot_does_not_leave_through_a_thin_wall():
    # Left of the wall no place has room; right of it there is, and in reach.
    grid = room((0.4, 0.0, 0.45, 6.0))
    with pytest.raises(NoRoute, match="in sight of start"):
        find_routes(grid, [0.3, 3.0], [9.0, 3.0], RADIUS, 1)


@pytest.mark.parametrize(
    ("start", "goal", "code", "message"),
    [
        ([5.0, 3.0], [9.0, 3.0], "START_OCCUPIED", r"start \(5, 3\) is in an obstacle; move it"),
        ([1.0, 3.0], [5.0, 3.0], "GOAL_OCCUPIED", r"goal \(5, 3\)"),
        ([-1.0, 3.0], [9.0, 3.0], "START_OUTSIDE_MAP", r"start \(-1, 3\).*x 0 to 10 and y 0 to 6"),
        ([1.0, 3.0], [1.0, 6.5], "GOAL_OUTSIDE_MAP", r"goal \(1, 6\.5\)"),
    ],
)
def test_wrong_end_is_named(start, goal, code, message):
    grid = room((4.0, 2.0, 6.0, 3.6))
    for ask in (shortest_path, lambda *ends: find_routes(*ends, 2)):
        with pytest.raises(NoRoute, match=message) as caught:
            ask(grid, start, goal, RADIUS)
        assert caught.value.code == code


def test_separate_rooms_have_no_route():
    with pytest.raises(NoRoute, match="nothing leads from start") as caught:
        find_routes(room((4.0, 0.0, 4.2, 6.0)), [1.0, 1.0], [9.0, 5.0], RADIUS, 3)
    assert caught.value.code == "NO_VALID_PATH"


@pytest.mark.parametrize(
    ("start", "goal", "radius", "count", "name"),
    [
        ([np.nan, 1.0], [2.0, 2.0], 0.25, 1, "start"),
        ([1.0, 1.0], [np.inf, 2.0], 0.25, 1, "goal"),
        ([1.0], [2.0, 2.0], 0.25, 1, "start"),
        ([1.0, 1.0], [2.0, 2.0], -0.1, 1, "radius"),
        ([1.0, 1.0], [2.0, 2.0], np.nan, 1, "radius"),
        ([1.0, 1.0], [2.0, 2.0], 0.25, 0, "count"),
    ],
)
def test_number_that_makes_no_sense_raises(start, goal, radius, count, name):
    for grid in (room(), None):
        with pytest.raises(ValueError, match=f"^{name} must be"):
            find_routes(grid, start, goal, radius, count)
