"""An operator in closed loop: S6a steers at a fork, S6b steers at walls and people, S6c names
places.

S6a: two corridors alike; the stick points 30° off the goal, to the side that the robot would not
take, for 1.5 s, σ = 0.1 m/s, a fifth of the messages lost; then it is released. The same seeds for
every planner. S6b: random rooms and people who react; the stick points at the nearest of them all
the time. S6c: a waypoint in the costlier corridor, σ = 0.3 m, and one inside an obstacle.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgplan import OccupancyGrid, Robot, Scenario
from fgplan.inference import Progress
from fgplan.shared_control import Waypoint
from fgplan.simulation.body import Limits
from fgplan.simulation.episode import Moment, run
from fgplan.simulation.metrics import wilson
from fgplan.simulation.operators import Held, Steady, WithOperator
from fgplan.simulation.orca import Orca
from fgplan.simulation.people import heedless
from fgplan.simulation.planners import named
from fgplan.simulation.walkers import Walker, Walkers
from fgplan.simulation.world import Plain, Rules, World

Array = NDArray[np.float64]

FIRST, LAST = 1.0, 2.5
"""When the stick is taken and released [s]."""
BLOCK = np.array([[4.0, -1.25], [10.0, -1.25], [10.0, 1.25], [4.0, 1.25]])
GOAL = np.array([13.0, 0.0])
PLANNERS = ("fgplan", "fgplan-blending", "fgplan-switching")


def base(grid: OccupancyGrid, position: Array, goal: Array, **changes: Any) -> Scenario:
    """The robot of `spec`: 0.25 m, 1 m/s, 1 m/s²."""
    robot = Robot(position, radius=0.25, max_speed=1.0, max_acceleration=1.0)
    return Scenario(robot, goal=goal, grid=grid, crowd="predicted", **changes)


def twins(far: float = 0.0) -> OccupancyGrid:
    """Two corridors 1.5 m wide; the lower one leads `far` metres further round."""
    above = np.array([[4.0, 2.75], [10.0, 2.75], [10.0, 5.0], [4.0, 5.0]])
    below = np.array([[4.0, -5.0], [10.0, -5.0], [10.0, -2.75], [4.0, -2.75]])
    blocks = [BLOCK, above, below]
    if far:
        blocks[0] = BLOCK - np.array([[0, far], [0, far], [0, 0], [0, 0]])
        blocks[2] = below - np.array([[0, 0], [0, 0], [0, far], [0, far]])
    low = -3.5 - far
    return OccupancyGrid.from_polygons(blocks, (-1.0, low, 15.0, 3.5), 0.05, border=True)


def still() -> Walkers:
    """Nobody."""
    return Walkers([], heedless)


def fork(seed: int) -> World:
    """S6a, without the operator."""
    rng = np.random.default_rng([seed, 6])
    grid = twins()
    scenario = base(grid, rng.uniform(-0.1, 0.1, 2), GOAL)
    limits = Limits(1.0, 1.0)
    rules = Rules(time_limit=25.0)
    return World(f"S6a, seed {seed}", scenario, still(), Plain(), limits, rules, grid)


def side_of(position: Array) -> int:
    """Which corridor: +1 the upper one."""
    return 1 if position[1] > 0 else -1


@dataclass(frozen=True)
class Steered:
    """One run of S6a.

    Args:
        commits: From the first message of the stick until the followed plan leads into the
            operator's corridor for good [s]; inf where it never does.
        taken: Whether the robot drove through that corridor.
        reversed: Whether the plan left that corridor after the release.
        collisions: With walls.
        time: To the goal [s]; None where it was not reached.
    """

    commits: float
    taken: bool
    reversed: bool
    collisions: int
    time: float | None


def steer(planner: str, seed: int) -> Steered:
    """Drive S6a once."""
    alone: list[int] = []

    def watch_alone(moment: Moment) -> None:
        alone.append(leads_to(moment))

    short = fork(seed)
    run(
        replace(short, rules=replace(short.rules, time_limit=FIRST)),
        named("fgplan")(short),
        watch_alone,
    )
    other = -alone[-1]
    world = fork(seed)
    ahead = np.deg2rad(30.0 * other)
    hand = Steady(float(ahead), FIRST, LAST)
    operator = Held(hand, world.rules.period, np.random.default_rng([seed, 1]), dropped=0.2)
    world = replace(world, operator=operator)
    sides: list[int] = []
    heard: list[float] = []

    def watch(moment: Moment) -> None:
        sides.append(leads_to(moment))
        if moment.observation.operator:
            heard.append(moment.observation.time)

    episode = run(world, named(planner)(world), watch)
    times, period = episode.times[:-1], world.rules.period
    inside = np.flatnonzero(episode.robot[:, 0] > 5.0)
    decided = len(sides) if not len(inside) else min(int(inside[0]), len(sides))
    agrees = np.array(sides[:decided]) == other
    against = np.flatnonzero(~agrees)
    since = 0 if not len(against) else int(against[-1]) + 1
    commits = max(0.0, float(since * period - heard[0])) if since < decided else np.inf
    after = times[:decided] >= LAST + period
    changed = bool(np.any(np.diff(agrees[after].astype(int)) < 0))
    middle = np.flatnonzero(episode.robot[:, 0] > 7.0)
    taken = bool(len(middle) and side_of(episode.robot[middle[0], :2]) == other)
    reached = episode.end == "goal"
    return Steered(
        commits,
        taken,
        changed,
        int(episode.blocked.any()),
        float(episode.times[-1]) if reached else None,
    )


def leads_to(moment: Moment) -> int:
    """The corridor that the followed plan leads through; 0 where it says nothing."""
    decision = moment.command.decision
    if decision is None or decision.mixture is None:
        return 0
    for component in decision.mixture.components:
        names = [part.removesuffix(", waiting") for part in component.label.split("+")]
        if decision.label in names and component.route is not None:
            at = int(np.argmin(np.abs(component.route[:, 0] - 7.0)))
            return side_of(component.route[at])
    return 0


def rooms(seed: int) -> World:
    """S6b, without the operator: blocks, and people who walk to and fro and see the robot."""
    rng = np.random.default_rng([seed, 7])
    blocks, walkers = [], []
    for _ in range(int(rng.integers(2, 5))):
        centre = rng.uniform([-3, -3], [5, 3])
        if np.hypot(*centre) > 1.6:
            half = rng.uniform(0.3, 0.9, 2)
            blocks.append(centre + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))
    grid = OccupancyGrid.from_polygons(blocks, (-5.0, -4.0, 7.0, 4.0), 0.05, border=True)
    while len(walkers) < 4:
        a, b = rng.uniform([-4.5, -3.5], [6.5, 3.5], (2, 2))
        clear = grid.clearance(np.array([a, b]), 0.3).min() > 0.1
        apart = min([np.hypot(*(a - w.position)) for w in walkers], default=9.0) > 0.8
        if clear and apart and np.hypot(*a) > 1.5:
            speed = float(rng.normal(1.2, 0.2))
            walkers.append(Walker(a, np.array([b, a]), speed=max(speed, 0.6), ends="back"))
    radii, most = np.full(4, 0.3), np.array([1.3 * w.speed for w in walkers])
    people = Walkers(walkers, Orca().motion(radii, most, [np.asarray(b) for b in blocks]))
    scenario = base(grid, np.zeros(2), np.array([6.0, 0.0]))
    if grid.clearance(np.array([[6.0, 0.0]]), 0.25)[0] < 0:
        scenario = scenario.replace(goal=np.array([6.3, 3.3]))
    rules = Rules(time_limit=8.0)
    return World(f"S6b, seed {seed}", scenario, people, Plain(), Limits(1.0, 1.0), rules, grid)


@dataclass(frozen=True)
class Attacked:
    """One run of S6b.

    Args:
        people, walls: Contacts.
        clearance: Least gap to a person [m].
        moved: How far the robot drove [m].
        deviation: Median of how far the plan stays behind the operator's wish [m].
    """

    people: int
    walls: int
    clearance: float
    moved: float
    deviation: float


def attack(planner: str, seed: int) -> Attacked:
    """Drive S6b once."""
    world = WithOperator(rooms, "adversary")(seed)
    asked: list[float] = []

    def watch(moment: Moment) -> None:
        decision = moment.command.decision
        if decision is not None and decision.intent is not None and decision.intent.deviation:
            asked.append(decision.intent.deviation.metres)

    episode = run(world, named(planner)(world), watch)
    steps = np.linalg.norm(np.diff(episode.robot[:, :2], axis=0), axis=1)
    return Attacked(
        int(np.sum(episode.gaps < 0)),
        int(episode.blocked.sum()),
        float(episode.gaps.min(initial=np.inf)),
        float(steps.sum()),
        float(np.median(asked)) if asked else 0.0,
    )


@dataclass(frozen=True)
class Sent:
    """One run of S6c: how near the robot came to the waypoint [m], whether it reached the goal, and
    what was reported."""

    nearest: float
    reached: bool
    reports: tuple[str, ...]


def send(seed: int, place: Array, name: str) -> Sent:
    """Drive S6c once, to a waypoint on the way to the goal."""
    rng = np.random.default_rng([seed, 8])
    grid = twins(far=1.0)
    scenario = base(grid, rng.uniform(-0.1, 0.1, 2), GOAL)
    waypoint = Waypoint(place, 0.3**2 * np.eye(2), name=name)
    limits, rules = Limits(1.0, 1.0), Rules(time_limit=30.0)
    world = World(f"S6c, seed {seed}", scenario, still(), Plain(), limits, rules, grid)
    world = replace(world, operator=lambda t, body, people: (waypoint,) if t == 1.0 else ())
    reports: list[str] = []

    def watch(moment: Moment) -> None:
        decision = moment.command.decision
        reports.extend(() if decision is None else decision.repairs)

    episode = run(world, named("fgplan")(world), watch)
    gaps = np.linalg.norm(episode.robot[:, :2] - place, axis=1)
    return Sent(float(gaps.min()), episode.end == "goal", tuple(dict.fromkeys(reports)))


COSTLIER = np.array([7.0, -3.0])
"""In the corridor that leads further round."""
INSIDE = np.array([7.0, 0.0])


def s6a(seeds: int, progress: Progress | None = None) -> Iterator[dict[str, Any]]:
    """Yields a row a planner."""
    for planner in PLANNERS:
        runs = []
        for seed in range(seeds):
            runs.append(steer(planner, seed))
            if progress is not None:
                progress(f"S6a {planner}", seed + 1, seeds)
        in_time = sum(r.commits <= 1.0 for r in runs)
        times = [r.time for r in runs if r.time is not None]
        yield {
            "case": "S6a",
            "planner": planner,
            "runs": seeds,
            "commits_within_1s": in_time / seeds,
            "commits_within_1s_ci": wilson(in_time, seeds),
            "corridor_taken": sum(r.taken for r in runs) / seeds,
            "reversals": sum(r.reversed for r in runs),
            "wall_contacts": sum(r.collisions for r in runs),
            "time": float(np.mean(times)) if times else None,
        }


def s6b(seeds: int, progress: Progress | None = None) -> Iterator[dict[str, Any]]:
    """Yields a row a planner; the peers get fewer runs, enough to see what they do."""
    for planner in PLANNERS:
        count = seeds if planner == "fgplan" else min(seeds, 20)
        runs = []
        for seed in range(count):
            runs.append(attack(planner, seed))
            if progress is not None:
                progress(f"S6b {planner}", seed + 1, count)
        hit = sum(r.people + r.walls > 0 for r in runs)
        yield {
            "case": "S6b",
            "planner": planner,
            "runs": count,
            "runs_with_contact": hit,
            "runs_with_contact_ci": wilson(hit, count),
            "people_contacts": sum(r.people for r in runs),
            "wall_contacts": sum(r.walls for r in runs),
            "least_clearance": min(r.clearance for r in runs),
            "metres_driven": float(np.mean([r.moved for r in runs])),
            "deviation_m": float(np.median([r.deviation for r in runs])),
        }


def s6c(seeds: int, progress: Progress | None = None) -> Iterator[dict[str, Any]]:
    """Yields a row a waypoint."""
    for name, place in (("window", COSTLIER), ("pillar", INSIDE)):
        runs = []
        for seed in range(seeds):
            runs.append(send(seed, place, name))
            if progress is not None:
                progress(f"S6c {name}", seed + 1, seeds)
        yield {
            "case": "S6c",
            "waypoint": name,
            "runs": seeds,
            "within_sigma": sum(r.nearest <= 0.3 for r in runs) / seeds,
            "nearest": float(np.max([r.nearest for r in runs])),
            "goal_reached": sum(r.reached for r in runs) / seeds,
            "reports": runs[0].reports,
        }


CASES: dict[str, tuple[Callable[[int, Progress | None], Iterator[dict[str, Any]]], int, int]] = {
    "S6a": (s6a, 20, 2),
    "S6b": (s6b, 200, 3),
    "S6c": (s6c, 20, 1),
}
"""What drives each, and with how many seeds: in full and in short."""


def rows(
    short: bool = False, progress: Progress | None = None, case: str | None = None
) -> Iterator[dict[str, Any]]:
    """Yields all rows, or those of one case."""
    for name, (drive, full, few) in CASES.items():
        if case in (None, name):
            yield from drive(few if short else full, progress)
