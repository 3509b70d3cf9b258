"""Random and hand-made scenes for tests of the whole chain."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from fgplan import Density, GivenPlan, Level, OccupancyGrid, Robot, Scenario, Track
from fgplan.assembly import Assembly
from fgplan.crowd import Belief, believe, seen
from fgplan.hypotheses import hypothesise
from fgplan.hypothesis import Hypothesis
from fgplan.inference.modes import modes
from fgplan.inference.posterior import Posterior
from fgplan.model import build
from fgplan.solver import Solution

Array = NDArray[np.float64]

ONE = np.zeros(1, dtype=np.intp)
"""The first hypothesis, as an index of a batch of one."""


def track(
    name: str, x: float, y: float, vx: float = 0.0, vy: float = 0.0, radius: float = 0.3
) -> Track:
    """Somebody who is now at (x, y) and has walked with (vx, vy) for two seconds."""
    t = np.linspace(-2.0, 0.0, 6)
    return Track(name, t, np.column_stack([x + vx * t, y + vy * t]), radius)


def fork(left: float | None = 1.0, right: float | None = 1.0) -> tuple[GivenPlan, GivenPlan]:
    """Two mirrored ways round (4, 0) to (8, 0), with their weights."""
    return (
        GivenPlan("left", np.array([[0.0, 0.0], [2.0, 1.5], [6.0, 1.5], [8.0, 0.0]]), left),
        GivenPlan("right", np.array([[0.0, 0.0], [2.0, -1.5], [6.0, -1.5], [8.0, 0.0]]), right),
    )


def forked(*people: Track, **changes: Any) -> Scenario:
    """A robot before the fork, at 0.8 m/s, in open space."""
    robot = Robot(np.zeros(2), np.array([0.8, 0.0]))
    return Scenario(robot, tracks=people, **{"plans": fork(), "count": 0, **changes})


def random_scene(seed: int, people: int, grid: bool = False, **changes: Any) -> Scenario:
    """The fork with people who walk about on and beside it, and with two blocks in the way."""
    rng = np.random.default_rng(seed)
    tracks = tuple(
        track(f"p{i}", *rng.uniform([1.5, -2.0], [6.0, 2.0]), *rng.normal(0, 0.5, 2))
        for i in range(people)
    )
    return forked(*tracks, **{"grid": blocks() if grid else None, **changes})


def blocks() -> OccupancyGrid:
    """A block at (4, 0) and a wall along y = 2.6."""
    square = np.array([[3.4, -0.6], [4.6, -0.6], [4.6, 0.6], [3.4, 0.6]])
    wall = np.array([[0.0, 2.6], [9.0, 2.6], [9.0, 2.9], [0.0, 2.9]])
    return OccupancyGrid.from_polygons([square, wall], (-2, -4, 10, 4), 0.1)


def short(**changes: Any) -> Density:
    """Five steps, for tests that take differences."""
    return Density(**{"horizon": 2.0, **changes})


CORRIDOR = Level("corridor", sigma=0.5, h=0.3)
STACK = (Level("mission", sigma=0.4, h=0.5), Level("local", sigma=np.inf, h=0.2))


def believed(scenario: Scenario) -> Belief:
    d = scenario.density
    return believe(seen(scenario), scenario.now, d.Qc_people, d.sigma_track, d.sigma_speed)


def assembled(
    scenario: Scenario, factors: Iterable[gtsam.NonlinearFactor] = ()
) -> tuple[Assembly, tuple[Hypothesis, ...]]:
    """The density of a scenario's hypotheses, as `plan` makes it."""
    belief = believed(scenario)
    hypotheses = hypothesise(scenario, belief)
    return Assembly(build(scenario, belief, hypotheses, factors)), hypotheses


def initial(assembly: Assembly, hypotheses: tuple[Hypothesis, ...]) -> tuple[Array, Any]:
    """The states of all starts (B, S, D), and the hypothesis of each (B,)."""
    pairs = [(i, start) for i, h in enumerate(hypotheses) for start in h.starts]
    states = [assembly.models[i].initial(start) for i, start in pairs]
    return np.stack(states), np.array([i for i, _ in pairs])


def jittered(assembly: Assembly, seed: int, scale: float = 0.3) -> Array:
    """A random state near the reference of the first hypothesis, (S, D)."""
    rng = np.random.default_rng(seed)
    reference = assembly.models[0].reference
    state = reference + scale * rng.standard_normal(reference.shape)
    for (name, k), value in assembly.models[0].fixed.items():
        state[k, assembly.models[0].columns[name]] = value
    return state


def dense(diagonal: Array, upper: Array) -> Array:
    """A block-tridiagonal matrix from its blocks, (S·D, S·D)."""
    S, D, _ = diagonal.shape
    H = np.zeros((S, D, S, D))
    for k in range(S):
        H[k, :, k] = diagonal[k]
        if k + 1 < S:
            H[k, :, k + 1] = upper[k]
            H[k + 1, :, k] = upper[k].T
    return H.reshape(S * D, S * D)


def mode_evidence(assembly: Assembly, solution: Solution, which: int) -> float | None:
    """log Z of one local optimum by Laplace's method; None where it is no minimum."""
    found = modes(Posterior(assembly, which, [solution]), "curvature")
    return found[0].log_mass if found else None
