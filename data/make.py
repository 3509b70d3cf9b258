"""Make the maps and the people of `data/`: run `python data/make.py` from the repository's root.

Maps are drawn from polygons. The people of a scenario file are everything below its line
`PEOPLE`; each is a walk of white noise on acceleration that ends in a chosen position and
velocity, seen every 0.4 s with noise, as a tracker would report it. Everything is seeded, so that
a second run changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgplan.occupancy import OccupancyGrid
from fgplan.shared_control import JoySample, write_joy

HERE = Path(__file__).parent
PEOPLE = "# --- people: written by data/make.py, do not edit below ---"

DT = 0.4
"""Between two detections [s]."""
DETECTIONS = 9
"""Of each person; the last one is now, the first 3.2 s ago."""
QC = 0.002
"""Power spectral density of a walker's acceleration [m²/s³]: people who walk steadily."""
SIGMA = 0.02
"""Standard deviation of a detection [m]."""

STICK_PERIOD, STICK_SIGMA, STICK_LOST = 0.05, 0.1, 0.2
"""Of a stick: between two messages [s], of its axes, share of messages that is lost."""

Vertices = list[tuple[float, float]]
Person = tuple[float, float, float, float]
"""(x, y, vx, vy) at time 0 [m, m/s]."""

CORRIDOR_PEOPLE: list[Person] = [
    # Five people come out of the middle corridor towards the robot, three abreast and two behind:
    # they fill its mouth when the robot would enter it.
    (5.3, 0.60, -0.90, 0.00),
    (5.6, 0.00, -0.90, 0.00),
    (5.3, -0.60, -0.90, 0.00),
    (6.7, 0.35, -0.90, 0.00),
    (6.7, -0.40, -0.90, 0.00),
]

HALL_PEOPLE: list[Person] = [
    (3.8, 0.2, 0.00, 0.00),
    (-4.5, 1.2, 1.10, -0.30),
    (-3.0, -1.8, 0.30, 1.00),
    (-1.5, 2.2, 0.10, -1.20),
    (-0.5, 0.4, -1.20, 0.05),
    (0.6, -0.7, -1.10, 0.10),
    (2.0, 2.6, -0.80, -0.80),
    (2.5, -2.6, -0.50, 1.10),
    (5.0, -2.0, -1.20, 0.40),
    (5.0, 3.8, -1.00, -0.70),
    (5.2, 1.1, -1.20, -0.10),
    (-5.5, 4.2, 1.10, -0.60),
]

DELIVERY_PEOPLE: list[Person] = [
    (5.2, 2.0, -0.90, 0.10),
    (8.5, 6.2, -0.20, -0.90),
    (14.2, 5.0, 0.00, 0.90),
    (4.0, 7.0, 0.70, -0.20),
    (12.0, 2.2, -0.90, 0.00),
]

HOSPITAL_PEOPLE: list[Person] = [
    (6.5, 7.4, 1.00, 0.00),
    (12.0, 6.8, -1.00, 0.00),
    (20.0, 7.0, -0.90, 0.05),
    (9.0, 13.2, 0.90, 0.00),
    (24.0, 13.4, -1.00, 0.00),
    (15.2, 10.2, 0.00, 0.80),
]

DELIVERY: list[Vertices] = [
    [(3.01, 3.51), (6.49, 3.51), (6.49, 4.49), (3.01, 4.49)],
    [(9.51, 3.51), (12.99, 3.51), (12.99, 4.49), (9.51, 4.49)],
    [(6.01, 6.51), (6.99, 6.51), (6.99, 8.99), (6.01, 8.99)],
]
"""Two counters and a shelf."""

CROWDS = {
    "three_corridors_crowd": (CORRIDOR_PEOPLE, "three_corridors", 1),
    "hall": (HALL_PEOPLE, "hall", 2),
    "delivery": (DELIVERY_PEOPLE, "delivery", 3),
    "hospital": (HOSPITAL_PEOPLE, "hospital", 4),
}
"""People, map and seed of each scenario file that has any."""

RADIUS = 0.3
"""Of a person [m]."""


def maps() -> dict[str, OccupancyGrid]:
    """The maps by name."""
    octagon = [
        (5.0 + 1.0 * float(np.cos(angle)), 0.3 + 1.0 * float(np.sin(angle)))
        for angle in np.pi / 8 + np.pi / 4 * np.arange(8)
    ]
    blocks = [_box(4, 1, 11, 2), _box(4, -2, 11, -1)]
    return {
        "one_obstacle": OccupancyGrid.from_polygons([octagon], (0, -4, 10, 4), 0.05, border=True),
        "three_corridors": OccupancyGrid.from_polygons(blocks, (0, -4, 14, 4), 0.1, border=True),
        "hall": OccupancyGrid.from_polygons([], (-10, -7, 10, 7), 0.1, border=True),
        "delivery": OccupancyGrid.from_polygons(DELIVERY, (0, 0, 16, 10), 0.1, border=True),
        "hospital": OccupancyGrid.from_polygons(_hospital(), (0, 0, 30, 20), 0.1, border=True),
    }


def _hospital() -> list[Vertices]:
    """Two corridors, three ways between them, and six rooms with a door each."""
    blocks = [_box(3, 8.5, 14, 12), _box(16.5, 8.5, 27, 12)]
    walls = [_box(x, 0, x + 0.4, 5.8) for x in (7.3, 14.8, 22.3)]
    walls += [_box(x, 14.7, x + 0.4, 20) for x in (9.8, 19.8)]
    for low, doors in ((5.4, (4.0, 11.0, 18.5, 26.0)), (14.7, (5.0, 15.0, 25.0))):
        edges = [0.0, *(x for door in doors for x in (door - 0.75, door + 0.75)), 30.0]
        walls += [_box(a, low, b, low + 0.4) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [*blocks, *walls]


def people(name: str) -> str:
    """The people of a scenario file, as TOML."""
    crowd, place, seed = CROWDS[name]
    rng, grid = np.random.default_rng(seed), maps()[place]
    walks: list[NDArray[np.float64]] = []
    for person in crowd:
        attempts = (_walk(person, rng) for _ in range(5000))
        walks.append(next(walk for walk in attempts if _is_free(walk, walks, grid)))
    entries = [_person(f"p{i}", walk) for i, walk in enumerate(walks, start=1)]
    return f"{PEOPLE}\n\n" + "\n".join(entries)


def sticks() -> dict[str, tuple[JoySample, ...]]:
    """Logs of Joy messages by name: a gamepad as teleop_twist_joy reads it, 20 Hz, in two bursts
    with nothing between; a fifth of the messages is lost, and on release comes one of zeros."""
    rng = np.random.default_rng(6)
    bursts = {
        "left_then_ahead": [(1.0, 1.5, 30.0), (6.0, 1.0, 0.0)],
        "right_then_left": [(1.0, 1.2, -30.0), (4.0, 2.0, 35.0)],
    }
    return {name: tuple(_messages(parts, rng)) for name, parts in bursts.items()}


def _messages(
    bursts: list[tuple[float, float, float]], rng: np.random.Generator
) -> Iterator[JoySample]:
    """Of bursts: from when [s], for how long [s], how far to the left of straight ahead [deg]."""
    held, let_go = (0, 0, 0, 0, 1, 0), (0, 0, 0, 0, 0, 0)
    yield JoySample(0.0, (0.0,) * 4, let_go)
    for first, duration, degrees in bursts:
        wish = 0.9 * np.array([np.sin(np.deg2rad(degrees)), np.cos(np.deg2rad(degrees))])
        for k in range(round(duration / STICK_PERIOD)):
            axes = np.round(np.clip(wish + rng.normal(0, STICK_SIGMA, 2), -1, 1), 3)
            if rng.random() >= STICK_LOST:
                stamp = round(first + k * STICK_PERIOD, 6)
                yield JoySample(stamp, (float(axes[0]), float(axes[1]), 0.0, 0.0), held)
        yield JoySample(round(first + duration, 6), (0.0,) * 4, let_go)


def main() -> None:
    """Write every map, every stick, and the people into the scenario files that have any."""
    for name, samples in sticks().items():
        write_joy(HERE / "operators" / f"{name}.jsonl", samples)
    for name, grid in maps().items():
        grid.save(HERE / "maps" / f"{name}.yaml")
    for name in CROWDS:
        path = HERE / "scenarios" / f"{name}.toml"
        stated = path.read_text(encoding="utf-8").partition(PEOPLE)[0]
        path.write_text(stated + people(name), encoding="utf-8")


def _box(xmin: float, ymin: float, xmax: float, ymax: float) -> Vertices:
    """A rectangle a centimetre smaller on each side: a polygon fills every cell that it touches."""
    inset = 0.01
    xmin, ymin, xmax, ymax = xmin + inset, ymin + inset, xmax - inset, ymax - inset
    return [(xmin, ymin), (xmax, ymin), (xmax, ymax), (xmin, ymax)]


def _walk(person: Person, rng: np.random.Generator) -> NDArray[np.float64]:
    """Detections (t, x, y) of a walk that ends in `person`: the process run backwards in time.

    Who stands at the end stood all the while.
    """
    state = np.array(person, dtype=float).reshape(2, 2)
    Q = QC * np.array([[DT**3 / 3, -(DT**2) / 2], [-(DT**2) / 2, DT]])
    root = np.linalg.cholesky(Q) if np.any(state[1]) else np.zeros((2, 2))
    positions = [state[0]]
    for _ in range(DETECTIONS - 1):
        backwards = np.array([[1.0, -DT], [0.0, 1.0]])
        state = backwards @ state + root @ rng.standard_normal((2, 2))
        positions.append(state[0])
    seen = np.array(positions[::-1]) + SIGMA * rng.standard_normal((DETECTIONS, 2))
    return np.column_stack([DT * np.arange(1 - DETECTIONS, 1), seen])


def _is_free(
    walk: NDArray[np.float64], others: list[NDArray[np.float64]], grid: OccupancyGrid
) -> bool:
    """Whether a walk went through no wall and through nobody."""
    apart = [np.linalg.norm(walk[:, 1:] - other[:, 1:], axis=1).min() for other in others]
    clear = bool(grid.contains(walk[:, 1:]).all() and grid.clearance(walk[:, 1:], RADIUS).min() > 0)
    return clear and min(apart, default=np.inf) > 2 * RADIUS


def _person(identity: str, rows: NDArray[np.float64]) -> str:
    track = "\n".join(f"    [{t:.1f}, {x:.2f}, {y:.2f}]," for t, x, y in np.round(rows, 2) + 0.0)
    return f'[[people]]\nid = "{identity}"\nradius = {RADIUS}\ntrack = [\n{track}\n]\n'


if __name__ == "__main__":
    main()
