"""Random and recorded scenes, each with the one before it, for warm starts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.scenes import World
from fgplan.recordings import Recording, load_cases
from fgplan.scenario import Density, Scenario

PEOPLE = (1, 12)
"""Fewest and most people of a random scene."""
PLANS = 3
"""Given plans of a random scene."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Something to plan, and what had been planned one step before."""

    name: str
    before: Scenario
    now: Scenario


def random_scene(seed: int) -> Scene:
    """Walkers cross the robot's way; between the two moments the robot goes straight on."""
    n = int(np.random.default_rng(seed).integers(PEOPLE[0], PEOPLE[1] + 1))
    world, d = World.random(seed, n), Density()
    ahead = world.robot + np.append(d.dt * world.robot[2:], [0.0, 0.0])
    before, now = (w.scenario(d.steps, PLANS, density=d) for w in (world, world.moved(ahead, d.dt)))
    return Scene(f"random {seed}", before, now)


def recorded_scenes(folder: Path, count: int) -> list[Scene]:
    """Moments of recorded cases, spread over the cases; the robot is where the person was."""
    cases = [case for case in load_cases(folder) if case.duration > 2 * Density().dt]
    # More scenes hold all that fewer do: what is known of those is still of use.
    chosen = np.random.default_rng(0).permutation(len(cases))[:count].tolist()
    recordings = {name: Recording.load(folder, name) for name in {c.recording for c in cases}}
    dt, scenes = Density().dt, []
    for i in chosen:
        case, recording = cases[i], recordings[cases[i].recording]
        at = dt * int(np.random.default_rng([0, i]).integers(1, int(case.duration / dt)))
        before, now = recording.scenario(case, at - dt), recording.scenario(case, at)
        scenes.append(Scene(f"{case.identity} at {at:.1f} s", before, now))
    return scenes
