"""Random and recorded scenes, each with what follows one step later, for warm starts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.scenes import World
from fgplan.recordings import Recording, load_cases
from fgplan.scenario import Density, Robot, Scenario

Array = NDArray[np.float64]

PEOPLE = (1, 12)
"""Fewest and most people of a random scene."""
PLANS = 3
"""Given plans of a random scene."""
CLEAR = ("core", "solo")
"""Strata of the recorded cases in which no wall is where the person went."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Something to plan twice, one step apart.

    Args:
        name: Of the scene.
        before: What is known at first.
        then: State of the robot one step later, (x, y, vx, vy) → what is known then.
    """

    name: str
    before: Scenario
    then: Callable[[Array], Scenario]


def random_scene(seed: int) -> Scene:
    """Walkers cross the robot's way."""
    n = int(np.random.default_rng(seed).integers(PEOPLE[0], PEOPLE[1] + 1))
    world, d = World.random(seed, n), Density()

    def scenario(world: World) -> Scenario:
        return world.scenario(d.steps, PLANS, density=d)

    return Scene(
        f"random {seed}", scenario(world), lambda robot: scenario(world.moved(robot, d.dt))
    )


def recorded_scenes(folder: Path, count: int) -> list[Scene]:
    """Moments of recorded cases whose way no wall blocks; the robot follows its own plan in
    between."""
    dt = Density().dt
    cases = [c for c in load_cases(folder) if c.tier in CLEAR and c.duration > 2 * dt]
    # More scenes hold all that fewer do: what is known of those is still of use.
    chosen = np.random.default_rng(0).permutation(len(cases))[:count].tolist()
    recordings = {
        name: Recording.load(folder, name) for name in {cases[i].recording for i in chosen}
    }
    scenes = []
    for i in chosen:
        case, recording = cases[i], recordings[cases[i].recording]
        at = dt * int(np.random.default_rng([0, i]).integers(1, int(case.duration / dt)))
        before = recording.scenario(case, at - dt)
        then = partial(_moved, before.robot, recording.scenario(case, at))
        scenes.append(Scene(f"{case.identity} at {at:.1f} s", before, then))
    return scenes


def _moved(robot: Robot, now: Scenario, state: Array) -> Scenario:
    return now.replace(robot=replace(robot, position=state[:2], velocity=state[2:]))
