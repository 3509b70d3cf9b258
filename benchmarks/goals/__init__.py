"""How soon it is known where an operator is going, and whether the probabilities are true.

An operator drives by hand from the middle of a room with random blocks to one of several
candidates, drawn at random. They hold the stick towards their own shortest way, at their own speed;
the hand is noisy, and the noise lasts for a moment. The robot does as it is told (and slides along
walls). `fgplan.driving.GoalInference` is told of each message of the stick and of nothing else.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgplan import OccupancyGrid, Robot, Scenario
from fgplan.driving import GoalInference, Observation
from fgplan.errors import NoRoute
from fgplan.inference import Progress
from fgplan.routes import find_routes
from fgplan.shared_control import Candidate, JoySample, Stick
from fgplan.timing import arc_length, path_length

Array = NDArray[np.float64]

PERIOD = 0.2
"""Between two messages of the stick [s]."""
NOISE = 0.4
"""Standard deviation of the hand [m/s]."""
MEMORY = 0.5
"""Correlation time of its noise [s]; its independent time is twice that."""
BOX = (-7.0, -6.0, 7.0, 6.0)
RADIUS = 0.25
NEAR = 0.4
"""A candidate is reached from here [m]."""
CERTAIN = 0.9
CHECKPOINTS = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4)
"""Shares of the path at which probabilities are asked for."""
BINS = 10
TOP = 2.0
"""Of the stick and the robot [m/s]: a wish at walking pace is far from the end of the stick."""
STICK = Stick(deadman=None, speed=TOP, frame="map", sigma=NOISE, persistence=2 * MEMORY)


@dataclass(frozen=True)
class Hand:
    """How an operator differs from one who is merely noisy.

    Args:
        name: For tables.
        delay: The stick shows where the operator wanted to go so long ago [s].
        dropped: Share of messages that are lost.
    """

    name: str
    delay: float = 0.0
    dropped: float = 0.0


HANDS = (Hand("noisy"), Hand("delayed 0.3 s", delay=0.3), Hand("20 % dropped", dropped=0.2))


@dataclass(frozen=True, eq=False)
class Run:
    """One drive.

    Args:
        shares: Of the path driven, at each step, shape (S,).
        probability: Of each candidate, shape (S, n).
        goal: The true one.
    """

    shares: Array
    probability: Array
    goal: int

    @property
    def known_after(self) -> float:
        """Share of the path after which the true goal has at least the probability `CERTAIN` and
        keeps it; 1 where it never does."""
        doubtful = np.flatnonzero(self.probability[:, self.goal] < CERTAIN)
        first = doubtful[-1] + 1 if len(doubtful) else 0
        return float(self.shares[first]) if first < len(self.shares) else 1.0

    def at(self, share: float) -> Array:
        """Probabilities when that share of the path is driven, shape (n,)."""
        k = min(int(np.searchsorted(self.shares, share)), len(self.shares) - 1)
        return np.asarray(self.probability[k])


@dataclass(frozen=True)
class Row:
    """What runs with one number of candidates come to.

    Args:
        candidates: How many, or "all" for all of these runs together.
        hand: Of the operator.
        runs: How many.
        known_after_p50, known_after_p90: Share of the path after which the true goal is known.
        never: Share of runs in which it never is.
        error: Expected calibration error of the most probable candidate.
        reliability: For each bin of its probability: mean probability, share of runs in which it
            is the true one, how many.
    """

    candidates: str
    hand: str
    runs: int
    known_after_p50: float
    known_after_p90: float
    never: float
    error: float
    reliability: tuple[tuple[float, float, int], ...]


def drives(
    count: int, runs: int, hand: Hand = HANDS[0], seed: int = 0, progress: Progress | None = None
) -> list[Run]:
    """Drive so many times with so many candidates."""
    found = []
    for number in range(runs):
        found.append(drive(count, hand, seed + number))
        if progress is not None:
            progress(f"{count} candidates, {hand.name}", number + 1, runs)
    return found


def measure(runs: Sequence[Run], candidates: str, hand: str) -> Row:
    """What runs come to."""
    known = np.array([run.known_after for run in runs])
    asked = [(run.at(share), run.goal) for run in runs for share in CHECKPOINTS]
    error, bins = calibration(asked)
    return Row(
        candidates,
        hand,
        len(runs),
        float(np.median(known)),
        float(np.quantile(known, 0.9)),
        float(np.mean(known >= 1)),
        error,
        bins,
    )


def calibration(
    asked: Sequence[tuple[Array, int]],
) -> tuple[float, tuple[tuple[float, float, int], ...]]:
    """Expected calibration error of the most probable candidate, and its reliability by bin."""
    top = np.array([p.max() for p, _ in asked])
    right = np.array([int(np.argmax(p)) == goal for p, goal in asked], dtype=float)
    which = np.minimum((top * BINS).astype(int), BINS - 1)
    bins, error = [], 0.0
    for b in range(BINS):
        mine = which == b
        if mine.any():
            mean, share = float(top[mine].mean()), float(right[mine].mean())
            bins.append((mean, share, int(mine.sum())))
            error += abs(mean - share) * mine.mean()
    return float(error), tuple(bins)


def drive(count: int, hand: Hand = HANDS[0], seed: int = 0) -> Run:
    """One drive to a random one of the candidates."""
    rng = np.random.default_rng([seed, count])
    grid, candidates = room(rng, count)
    goal = int(rng.integers(count))
    scenario = Scenario(Robot(np.zeros(2), radius=RADIUS, max_speed=TOP), grid=grid)
    inference = GoalInference(scenario, candidates)
    speed = float(rng.uniform(0.7, 1.0))
    position, velocity, noise = np.zeros(2), np.zeros(2), rng.normal(0, NOISE, 2)
    wishes: list[Array] = []
    shares, probability = [], []
    way = find_routes(grid, position, candidates[goal].position, RADIUS, 1)[0].path
    length = path_length(way)
    for step in range(round(3 * length / PERIOD)):
        time = step * PERIOD
        if step % 5 == 0:
            way = find_routes(grid, position, candidates[goal].position, RADIUS, 1)[0].path
        wishes.append(speed * towards(way, position))
        wish = wishes[max(0, step - round(hand.delay / PERIOD))]
        keep = np.exp(-PERIOD / MEMORY)
        noise = keep * noise + np.sqrt(1 - keep**2) * rng.normal(0, NOISE, 2)
        axes = np.clip((wish + noise) / TOP, -1, 1)
        sample = JoySample(time, (float(axes[1]), float(axes[0])), ())
        said = () if rng.random() < hand.dropped else STICK.wish(sample, 0.0, PERIOD)
        intent = inference.step(Observation(time, position, velocity, operator=said))
        shares.append(1 - path_length(find_rest(way, position)) / length)
        probability.append([intent.probability[c.label] for c in candidates])
        velocity = TOP * axes
        ahead = position + PERIOD * velocity
        if grid.clearance(ahead[None], RADIUS)[0] < 0:  # along the wall, or not at all
            options = [position + PERIOD * velocity * keep_axis for keep_axis in np.eye(2)]
            gaps = grid.clearance(np.array(options), RADIUS)
            ahead = options[int(np.argmax(gaps))] if gaps.max() >= 0 else position
        position = ahead
        if np.hypot(*(position - candidates[goal].position)) < NEAR:
            break
    return Run(np.maximum.accumulate(np.array(shares)), np.array(probability), goal)


def find_rest(way: Array, position: Array) -> Array:
    """What is left of a way from the vertex after the nearest point of it."""
    middle = 0.5 * (way[1:] + way[:-1])
    k = int(np.argmin(np.linalg.norm(np.vstack([way[:1], middle]) - position, axis=1)))
    return np.vstack([position, way[max(k, 1) :]])


def towards(way: Array, position: Array, ahead: float = 0.8) -> Array:
    """Unit vector to the point of a way that is so far ahead [m]."""
    s = arc_length(way)
    at = np.linspace(0, s[-1], 2 + int(s[-1] / 0.05))
    points = np.column_stack([np.interp(at, s, way[:, i]) for i in (0, 1)])
    nearest = int(np.argmin(np.linalg.norm(points - position, axis=1)))
    target = points[min(nearest + round(ahead / 0.05), len(points) - 1)]
    step = target - position
    return np.asarray(step / max(float(np.hypot(*step)), 1e-9))


def room(rng: np.random.Generator, count: int) -> tuple[OccupancyGrid, tuple[Candidate, ...]]:
    """Random blocks, and candidates all around, each of which can be reached."""
    for _ in range(100):
        blocks = []
        for _ in range(int(rng.integers(2, 6))):
            centre = rng.uniform([-5, -4.5], [5, 4.5])
            if np.hypot(*centre) > 1.8:
                half = rng.uniform(0.3, 0.9, 2)
                blocks.append(centre + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))
        grid = OccupancyGrid.from_polygons(blocks, BOX, 0.1, border=True)
        turn = rng.uniform(0, 2 * np.pi)
        angles = turn + 2 * np.pi * (np.arange(count) + rng.uniform(-0.25, 0.25, count)) / count
        far = rng.uniform(0.75, 0.95, count)
        edge = 1 / np.maximum(np.abs(np.cos(angles)) / 6.5, np.abs(np.sin(angles)) / 5.5)
        places = (far * edge)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        try:
            for place in places:
                find_routes(grid, np.zeros(2), place, RADIUS, 1)
        except NoRoute:
            continue
        return grid, tuple(Candidate(f"{i}", place) for i, place in enumerate(places))
    raise RuntimeError("no room was found in which all candidates can be reached")


def run(short: bool = False, progress: Progress | None = None) -> Iterator[Row]:
    """Yields a row for each number of candidates and one for all, 500 runs; then hands that are
    not only noisy."""
    every: list[Run] = []
    for count, runs in ((3, 167), (5, 167), (9, 166)):
        found = drives(count, 10 if short else runs, progress=progress)
        every += found
        yield measure(found, str(count), HANDS[0].name)
    yield measure(every, "all", HANDS[0].name)
    if not short:
        for hand in HANDS[1:]:
            yield measure(drives(5, 100, hand, progress=progress), "5", hand.name)


def as_dict(row: Row) -> dict[str, Any]:
    """For JSON."""
    return asdict(row)
