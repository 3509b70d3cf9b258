"""The ROS stack is a special case of the density: the same samples, the same choice.

`fgplan.peers.dwa.choose` scores and compares roll-outs as dwa_local_planner does;
`fgplan.peers.special_case` maximises ψ·p over them, with K = 1, ψ = exp(−cost) and p uniform over
the dynamic window.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fgplan import OccupancyGrid
from fgplan.peers.costmap import Costmap, Inflation, shortest_path
from fgplan.peers.dwa import Scene, Weights, Window, choose
from fgplan.peers.special_case import UniformWindow, infer, potentials

SCENES = 1000
WINDOW = Window(min_speed=-0.2)
POTENTIALS = ("path", "goal", "path of the nose", "goal of the nose", "occupancy")


def scene(seed: int) -> tuple[Scene, UniformWindow, Any]:
    """Random blocks, people, robot and plan; samples on a lattice or drawn at random."""
    rng = np.random.default_rng(seed)
    occupied = np.zeros((50, 60), dtype=bool)
    for _ in range(int(rng.integers(0, 5))):
        row, col = rng.integers(0, 45), rng.integers(0, 55)
        occupied[row : row + rng.integers(2, 9), col : col + rng.integers(2, 9)] = True
    grid = OccupancyGrid.from_array(occupied, 0.1, (-1.0, -2.5, 0.0))
    people = rng.uniform([-1, -2.5], [5, 2.5], (int(rng.integers(0, 4)), 2))
    costmap = Costmap.build(grid, Inflation(0.25), people)
    pose = np.array([*rng.uniform([0, -1.5], [2.5, 1.5]), rng.uniform(-np.pi, np.pi)])
    path = shortest_path(Costmap.build(grid, Inflation(0.25)), pose[:2], rng.uniform(-2, 4.5, 2))
    if path is None:  # no way through the blocks: a straight line stands in
        path = np.linspace(pose[:2], [4.5, 0.0], 60)
    weights = Weights(*rng.uniform(1, 40, 2), occ_scale=rng.uniform(0.01, 0.1))
    built = Scene.build(costmap, path, weights)
    assert built is not None
    velocity = rng.uniform([-0.2, -1.5], [1.0, 1.5])
    drawn, lattice = WINDOW.sample(velocity, 60, rng), WINDOW.lattice(velocity, 5, 12)
    commands = lattice if seed % 2 else drawn
    return built, UniformWindow(WINDOW, velocity), WINDOW.roll_out(pose, commands)


def agree(seed: int, leave_out: int | None = None) -> tuple[bool, bool]:
    """Whether both choose the same trajectory, and whether there was anything to choose."""
    built, prior, samples = scene(seed)
    psi = [p for i, p in enumerate(potentials(built)) if i != leave_out]
    choice, inferred = choose(built, samples), infer(prior, psi, samples)
    if choice.index is None or inferred is None:
        return choice.index is None and inferred is None, False
    return np.array_equal(inferred.best, samples[choice.index]), True


def test_the_special_case_chooses_as_the_dynamic_window_does() -> None:
    results = [agree(seed) for seed in range(SCENES)]
    assert sum(same for same, _ in results) == SCENES
    # Scenes in which everything is rejected say little; most must offer a choice.
    assert sum(choice for _, choice in results) > 0.6 * SCENES


@pytest.mark.parametrize("term", range(5), ids=POTENTIALS)
def test_without_one_cost_the_choices_differ(term: int) -> None:
    """None of the five costs is idle: the identity above is not one of two constants."""
    results = [agree(seed, leave_out=term) for seed in range(100)]
    assert sum(not same for same, _ in results) > 5


def test_with_another_prior_the_choices_differ() -> None:
    """p matters: with one that is not uniform, here a preference for slow commands, the argmax of
    ψ·p is no longer the dynamic window's."""

    class Slow(UniformWindow):
        def log_density(self, trajectories: Any) -> Any:
            return super().log_density(trajectories) - 20 * np.abs(trajectories[:, -1, 3])

    different = 0
    for seed in range(60):
        built, prior, samples = scene(seed)
        choice = choose(built, samples)
        inferred = infer(Slow(prior.window, prior.velocity), potentials(built), samples)
        if choice.index is not None and inferred is not None:
            different += not np.array_equal(inferred.best, samples[choice.index])
    assert different > 10


def test_a_command_outside_the_window_has_no_density() -> None:
    built, prior, samples = scene(1)
    assert np.all(prior.log_density(samples) == 0)
    faster = samples.copy()
    faster[..., 3] += 1.0
    assert np.all(prior.log_density(faster) == -np.inf)
    assert infer(prior, potentials(built), faster) is None
