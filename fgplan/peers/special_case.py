r"""The dynamic window as a special case of the density: K = 1, ψ = exp(−cost), argmax of ψ·p.

p(f^R | z^R) is uniform over the window of admissible commands u = (v, ω), each driven as long as
the roll-out lasts, and 0 for every other trajectory. Up to a constant its log is then 0 on all
samples, and

    argmax_i ψ(x_i) p(x_i) = argmax_i exp(−cost(x_i)) = argmin_i cost(x_i),

which is what the dynamic window computes; a rejected trajectory has ψ = 0. `docs/robots.md` says
the same as a theorem. Here the density is evaluated and maximised by fgplan's own means: five
potentials on trajectories and `Inferred.best`, nothing of `fgplan.peers.dwa.choose`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fgplan.inference.base import Diagnostics, Inferred
from fgplan.inference.diagnostics import kish
from fgplan.occupancy import OccupancyGrid
from fgplan.peers.costmap import INSCRIBED, UNKNOWN, look_up
from fgplan.peers.dwa import Scene, Window

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CellPotential:
    """ψ(x) = exp(−weight·c), c a value of the cells that a trajectory visits.

    Args:
        grid: Where the cells are.
        values: Shape (rows, cols); inf where ψ is 0.
        weight: [nats] per unit of the values.
        over: The cell of the "last" state, or the "largest" value of all states.
        nose: How far ahead of the state the cell is looked up [m].
        outside: The value outside the grid.
    """

    grid: OccupancyGrid
    values: Array
    weight: float
    over: Literal["last", "largest"]
    nose: float = 0.0
    outside: float = np.inf

    def energy(self, trajectories: Array) -> Array:
        """−log ψ of trajectories (N, S, ≥ 3), shape (N,) [nats]."""
        states = trajectories[:, -1:] if self.over == "last" else trajectories
        theta = states[..., 2]
        points = states[..., :2] + self.nose * np.stack([np.cos(theta), np.sin(theta)], axis=-1)
        value = look_up(self.grid, self.values, points, self.outside).max(axis=1)
        # A weight of 0 makes the potential flat, but what is impossible stays so.
        return np.where(
            np.isfinite(value), self.weight * np.where(np.isfinite(value), value, 0), np.inf
        )


@dataclass(frozen=True, eq=False)
class UniformWindow:
    """p(f^R | z^R): a command drawn evenly from the window, and driven.

    Args:
        window: Limits of the robot.
        velocity: (v, ω) now.
    """

    window: Window
    velocity: Any

    def log_density(self, trajectories: Array) -> Array:
        """Up to the constant −log of the window's area: 0 for states (N, S, 5) whose command is
        admissible, else −∞."""
        low, high = self.window.bounds(self.velocity)
        command = trajectories[:, -1, 3:]
        slack = 1e-9
        admissible = np.all((command >= low - slack) & (command <= high + slack), axis=1)
        return np.where(admissible, 0.0, -np.inf)


def potentials(scene: Scene) -> tuple[CellPotential, ...]:
    """The costs of the dynamic window as factors of ψ(η_0, f^R): the path is η_0."""
    grid, weights = scene.costmap.grid, scene.weights
    cells = scene.costmap.values.astype(float)
    cells[(cells >= INSCRIBED) | (cells == UNKNOWN)] = np.inf
    to_path, to_goal = (0.5 * grid.resolution * b for b in (weights.path_bias, weights.goal_bias))
    nose, far = weights.nose, float(scene.path.size)
    return (
        CellPotential(grid, scene.path, to_path, "last"),
        CellPotential(grid, scene.goal, to_goal, "last"),
        CellPotential(grid, scene.path_anywhere, to_path, "last", nose, far),
        CellPotential(grid, scene.goal_anywhere, to_goal, "last", nose, far),
        CellPotential(grid, cells, weights.occ_scale, "largest"),
    )


def infer(prior: UniformWindow, psi: Sequence[CellPotential], samples: Array) -> Inferred | None:
    """Importance sampling of the density ψ·p, K = 1, with samples (N, S, 5) from p.

    `best` is the sample with the largest ψ·p; expectations use the weights ψ alone.

    Returns:
        None when ψ·p is 0 on all samples.
    """
    log_psi = np.zeros(len(samples))
    for potential in psi:
        log_psi -= potential.energy(samples)
    energies = -(log_psi + prior.log_density(samples))
    if not np.isfinite(energies).any():
        return None
    log_z = float(np.logaddexp.reduce(log_psi) - np.log(len(samples)))
    ess = kish(log_psi)
    return Inferred(
        method="importance",
        states=samples,
        weights=np.exp(log_psi - np.logaddexp.reduce(log_psi)),
        energies=energies,
        log_evidence=log_z,
        log_evidence_error=None,
        diagnostics=Diagnostics(draws=len(samples), ess=ess, energies=len(samples)),
    )
