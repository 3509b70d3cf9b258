"""How long does a plan take, by the number of levels?

The scene is the same for all: a fork with two plans, three people, one map. Levels are smooth and
random, each a variable of four numbers a step; a chain puts them one below the other, a tree under
one another in pairs. Sizes take turns, so that other work of the machine slows all of them alike;
times are CPU times.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from time import process_time
from typing import Any

import numpy as np

from fgplan import Density, GivenPlan, Level, OccupancyGrid, Robot, Scenario, Track, plan
from fgplan.mission.automaton import compile_formula
from fgplan.mission.parser import parse

Row = dict[str, Any]
Bar = Callable[[Iterable[int]], Iterable[int]]

SIZES = (1, 2, 3, 4, 5, 6, 8, 10)
SHAPES = ("chain", "tree")
EVENTUALITIES = 7


def stack(size: int, shape: str) -> tuple[Level, ...]:
    """A stack of so many levels, all of them variables."""
    levels = [Level("level 0", sigma=0.4, h=0.5)]
    for i in range(1, size):
        above = i - 1 if shape == "chain" else (i - 1) // 2
        levels.append(Level(f"level {i}", np.inf, h=0.3, Qc=0.5, follows=f"level {above}"))
    return tuple(levels)


def scene(levels: Sequence[Level]) -> Scenario:
    """The fork."""
    block = [(3.4, -0.6), (4.6, -0.6), (4.6, 0.6), (3.4, 0.6)]
    grid = OccupancyGrid.from_polygons([block], (-1, -4, 10, 4), 0.1)
    times = np.array([-0.8, -0.4, 0.0])
    seen = [((6.0, 1.2), (-0.8, 0.0)), ((5.5, -1.4), (-0.6, 0.1)), ((8.0, 2.0), (-0.7, -0.3))]
    tracks = tuple(
        Track(f"p{i}", times, np.array(at) + times[:, None] * np.array(v))
        for i, (at, v) in enumerate(seen)
    )
    ways = [
        GivenPlan(name, np.array([[0.0, 0.0], [2.5, side], [5.5, side], [8.0, 0.0]]))
        for name, side in (("left", 1.4), ("right", -1.4))
    ]
    robot = Robot(np.zeros(2), np.array([0.8, 0.0]))
    return Scenario(
        robot, grid=grid, tracks=tracks, plans=tuple(ways), count=0, levels=levels,
        density=replace(Density(), horizon=4.8),
    )  # fmt: skip


def measure(repeats: int, shape: str, bar: Bar = iter) -> list[Row]:
    """One row a size: median CPU time of a plan, and of one Newton iteration of a start."""
    scenes = [scene(stack(size, shape)) for size in SIZES]
    for one in scenes:
        plan(one)  # the first one imports and caches
    times: list[list[float]] = [[] for _ in SIZES]
    iterations = [0 for _ in SIZES]
    for _ in bar(range(repeats)):
        for i, one in enumerate(scenes):
            began = process_time()
            mixture = plan(one)
            times[i].append(process_time() - began)
            iterations[i] = sum(c.iterations for c in mixture.components)
    return [
        {
            "shape": shape,
            "levels": size,
            "plan_ms": 1e3 * float(np.median(took)),
            "iterations": count,
            "iteration_ms": 1e3 * float(np.median(took)) / max(count, 1),
        }
        for size, took, count in zip(SIZES, times, iterations, strict=True)
    ]


def growth(rows: Sequence[Row], name: str = "plan_ms") -> Row:
    """A line through times by the number of levels, and the exponent of a power of the numbers of
    trajectories (levels and robot) instead: 1 is linear."""
    x = np.array([row["levels"] for row in rows], dtype=float)
    y = np.array([row[name] for row in rows])
    slope, start = np.polyfit(x, y, 1)
    off = y - (start + slope * x)
    return {
        "shape": rows[0]["shape"],
        "slope_ms": float(slope),
        "start_ms": float(start),
        "r2": 1 - float(off @ off) / float(np.sum((y - y.mean()) ** 2)),
        "exponent": float(np.polyfit(np.log(x + 1), np.log(y), 1)[0]),
    }


def compiled(repeats: int) -> Row:
    """CPU time to read a mission of seven eventualities and build its whole automaton; nothing of
    it is known before."""
    from fgplan.mission import progression

    text = " & ".join(f"F place_{i}" for i in range(EVENTUALITIES))
    took = []
    for _ in range(repeats):
        for cached in (progression._progress, progression._step, progression.atoms):
            cached.cache_clear()
        began = process_time()
        automaton = compile_formula(parse(text), text)
        took.append(process_time() - began)
    return {
        "eventualities": EVENTUALITIES,
        "states": len(automaton.states),
        "compile_ms": 1e3 * float(np.median(took)),
    }
