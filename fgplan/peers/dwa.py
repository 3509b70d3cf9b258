"""The dynamic window approach, as ROS runs it: sample (v, ω), roll out, score, take the best."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from factors.unicycle import advance
from fgplan.peers.costmap import INSCRIBED, UNKNOWN, Costmap, look_up

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Window:
    """The dynamic window: what (v, ω) the robot can have after one period of the controller.

    Args:
        max_speed: [m/s].
        min_speed: [m/s]; negative allows to reverse.
        max_yaw_rate: [rad/s].
        max_acceleration: [m/s²].
        max_yaw_acceleration: [rad/s²].
        period: Of the controller [s].
        sim_time: How far ahead a command is rolled out [s].
        step: Time between two poses of a roll-out [s].

    Reference:
        Fox, Burgard, Thrun, IEEE Robotics & Automation Magazine 4(1), 1997.
    """

    max_speed: float = 1.0
    min_speed: float = 0.0
    max_yaw_rate: float = 1.5
    max_acceleration: float = 1.0
    max_yaw_acceleration: float = 3.0
    period: float = 0.1
    sim_time: float = 1.7
    step: float = 0.1

    def bounds(self, velocity: Any) -> tuple[Array, Array]:
        """Least and largest (v, ω), shape (2,) each, from the velocity (v, ω) now.

        Who is faster than allowed brakes as hard as possible.
        """
        now = np.asarray(velocity, dtype=float)
        change = self.period * np.array([self.max_acceleration, self.max_yaw_acceleration])
        least = np.array([self.min_speed, -self.max_yaw_rate])
        most = np.array([self.max_speed, self.max_yaw_rate])
        low, high = np.maximum(now - change, least), np.minimum(now + change, most)
        return np.minimum(low, now + change), np.maximum(high, now - change)

    def lattice(self, velocity: Any, speeds: int, turns: int) -> Array:
        """An even grid of commands over the window, shape (speeds·turns, 2)."""
        low, high = self.bounds(velocity)
        v, w = np.linspace(low[0], high[0], speeds), np.linspace(low[1], high[1], turns)
        return np.stack(np.meshgrid(v, w, indexing="ij"), axis=-1).reshape(-1, 2)

    def sample(self, velocity: Any, count: int, rng: np.random.Generator) -> Array:
        """Commands drawn evenly from the window, shape (count, 2)."""
        low, high = self.bounds(velocity)
        return np.asarray(low + (high - low) * rng.random((count, 2)))

    def roll_out(self, pose: Any, commands: Array) -> Array:
        """Poses of constant commands (N, 2) from (x, y, θ): states (N, S, 5)."""
        steps = max(1, round(self.sim_time / self.step))
        states = np.empty((len(commands), steps + 1, 5))
        states[:, 0, :3] = np.asarray(pose, dtype=float)
        states[:, 0, 3:] = commands
        still = np.zeros_like(commands)
        for k in range(steps):
            states[:, k + 1] = advance(states[:, k], still, self.step)
        return states


@dataclass(frozen=True)
class Weights:
    """dwa_local_planner's: ½·path_bias·(path + path_nose) + ½·goal_bias·(goal + goal_nose) +
    occ_scale·cell.

    Args:
        path_bias: Of the distance from the path, of the last pose and of its nose [1/m].
        goal_bias: Of the distance from the local goal, the same [1/m].
        occ_scale: Of the largest value of a cell on the way.
        nose: Of the point ahead of the last pose that is scored too [m]: without it a robot
            that stands does not see which way to turn.
    """

    path_bias: float = 32.0
    goal_bias: float = 24.0
    occ_scale: float = 0.01
    nose: float = 0.325


@dataclass(frozen=True, eq=False)
class Scene:
    """What commands are scored against.

    Args:
        costmap: The local costmap.
        path: Cells from each cell to the path, shape (rows, cols); inf where none leads there.
        goal: Cells from each cell to the local goal, the same.
        weights: Of the three costs.
    """

    costmap: Costmap
    path: Array
    goal: Array
    weights: Weights

    @cached_property
    def path_anywhere(self) -> Array:
        """`path`, with as many steps as there are cells where none leads there."""
        return np.where(np.isfinite(self.path), self.path, self.path.size)

    @cached_property
    def goal_anywhere(self) -> Array:
        """The same of `goal`."""
        return np.where(np.isfinite(self.goal), self.goal, self.goal.size)

    @classmethod
    def build(cls, costmap: Costmap, plan: Array, weights: Weights) -> Scene | None:
        """From a global plan, vertices (N, 2) [m] no further apart than a cell's diagonal.

        The local plan is the first stretch of it inside the costmap; its end is the local goal.
        None when no vertex lies inside.
        """
        within = costmap.grid.contains(plan)
        if not within.any():
            return None
        first = int(np.argmax(within))
        gone = np.flatnonzero(~within[first:])
        local = plan[first : first + int(gone[0])] if len(gone) else plan[first:]
        cells = costmap.grid.world_to_cell(local)
        free = cells[~costmap.blocked[cells[:, 0], cells[:, 1]]]
        # Somebody may stand on the end of the local plan: the last free vertex is the goal then.
        return cls(costmap, costmap.steps_to(cells), costmap.steps_to(free[-1:]), weights)


@dataclass(frozen=True, eq=False)
class Choice:
    """What the dynamic window came to.

    Args:
        index: Of the chosen trajectory; None when all are rejected.
        cost: Its cost; inf when there is none.
        rejected: How many trajectories were rejected.
    """

    index: int | None
    cost: float
    rejected: int


def choose(scene: Scene, trajectories: Array) -> Choice:
    """The cheapest trajectory, compared one after the other as ROS does; the first of equals.

    Args:
        scene: What they are scored against.
        trajectories: States (N, S, ≥ 3), position and heading first.
    """
    best, index, rejected = np.inf, None, 0
    for i, cost in enumerate(scores(scene, trajectories).tolist()):
        if cost < 0:
            rejected += 1
        elif cost < best:
            best, index = cost, i
    return Choice(index, best, rejected)


def scores(scene: Scene, trajectories: Array) -> Array:
    """Costs of trajectories (N, S, ≥ 3), shape (N,); negative where one is rejected: −1 for
    contact or what is not known, −2 where its end is cut off from path or goal."""
    grid, weights = scene.costmap.grid, scene.weights
    on_the_way = scene.costmap.at(trajectories[..., :2])
    hit = np.any((on_the_way >= INSCRIBED) | (on_the_way == UNKNOWN), axis=1)
    end, theta = trajectories[:, -1, :2], trajectories[:, -1, 2]
    nose = end + weights.nose * np.column_stack([np.cos(theta), np.sin(theta)])
    path = look_up(grid, scene.path, end, np.inf)
    goal = look_up(grid, scene.goal, end, np.inf)
    cut_off = ~(np.isfinite(path) & np.isfinite(goal))
    metre = 0.5 * grid.resolution
    cost = metre * weights.path_bias * path
    cost = cost + metre * weights.goal_bias * goal
    # The nose may be where the robot may not: that is dear and not forbidden.
    far = scene.path.size
    cost = cost + metre * weights.path_bias * look_up(grid, scene.path_anywhere, nose, far)
    cost = cost + metre * weights.goal_bias * look_up(grid, scene.goal_anywhere, nose, far)
    cost = cost + weights.occ_scale * on_the_way.max(axis=1)
    return np.where(hit, -1.0, np.where(cut_off, -2.0, cost))
