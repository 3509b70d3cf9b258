"""The layered ROS stack as it is usually run: a global planner at 1 Hz, the dynamic window at
10–20 Hz, and recovery behaviours when either fails (move_base).

It knows people as obstacles where they are now: in the local costmap, and where asked in the
global one, too. It is a peer to measure against; nothing in fgplan's own planning uses it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fgplan.occupancy import OccupancyGrid
from fgplan.peers.costmap import INSCRIBED, Costmap, Inflation, shortest_path, window
from fgplan.peers.dwa import Scene, Weights, Window, choose
from fgplan.robots import Twist

Array = NDArray[np.float64]

STOP = Twist(0.0, 0.0, 0.0)


class Status(Enum):
    """How a step of the stack ended; the values are Nav2's names where it has one."""

    FOLLOWING = "FOLLOWING"
    REACHED = "REACHED"
    NO_VALID_PATH = "NO_VALID_PATH"
    NO_VALID_CONTROL = "NO_VALID_CONTROL"
    RECOVERING = "RECOVERING"
    FAILED = "FAILED"


@dataclass(frozen=True)
class Command:
    """What to do until the next step.

    Args:
        twist: In the base frame.
        status: How the step ended.
        reason: In words; the recovery behaviour by name.
    """

    twist: Twist
    status: Status
    reason: str = ""


@dataclass(frozen=True)
class Settings:
    """Parameters of the stack, with the names and most of the defaults of move_base.

    Args:
        window: Limits of the robot, and the roll-out.
        inflation: Of both costmaps; its `inscribed` is the robot's radius.
        padding: Added to that radius, as footprint_padding [m]: half the diagonal of a cell of
            0.1 m, or the edge of the robot would touch what cells do not show.
        weights: Of the dynamic window.
        people_in: "local": people are in the local costmap alone; "global": in both.
        person_radius: [m].
        speeds: Samples of v in the window.
        turns: Samples of ω.
        min_speed: A command slower than this [m/s] and `min_turn` is not tried (min_vel_trans):
            a robot whose nose is at a wall would stand for ever.
        min_turn: [rad/s] (min_vel_theta).
        oscillation: Who turned on the spot must not turn back before moving this far [m].
        planner_period: Time between two global plans [s].
        local_side: Of the local costmap's square [m].
        tolerance: xy_goal_tolerance [m].
        patience: How long planner or controller may fail before a recovery begins [s].
        progress_radius: Who moves less than this [m] ...
        progress_time: ... in this time [s] makes no progress, and recovers.
        spin_rate: Of the recovery "spin" [rad/s].
        wait_time: Of the recovery "wait" [s].
        backup_distance: Of the recovery "back up" [m].
        backup_speed: [m/s].
        rounds: How often all recoveries are gone through before the stack gives up.
    """

    window: Window = field(default_factory=Window)
    inflation: Inflation = field(default_factory=lambda: Inflation(0.25))
    padding: float = 0.07
    weights: Weights = field(default_factory=Weights)
    people_in: Literal["local", "global"] = "local"
    person_radius: float = 0.3
    speeds: int = 8
    turns: int = 21
    min_speed: float = 0.1
    min_turn: float = 0.1
    oscillation: float = 0.05
    planner_period: float = 1.0
    local_side: float = 6.0
    tolerance: float = 0.25
    patience: float = 2.0
    progress_radius: float = 0.3
    progress_time: float = 8.0
    spin_rate: float = 0.8
    wait_time: float = 3.0
    backup_distance: float = 0.3
    backup_speed: float = 0.1
    rounds: int = 3


RECOVERIES = ("clear costmaps", "spin", "wait", "back up")
"""In the order in which they are tried."""


@dataclass(eq=False)
class _Memory:
    """What the stack remembers between two steps."""

    goal: Array
    path: Array | None = None
    planned: float = -np.inf
    worked: float = -np.inf
    anchor: Array = field(default_factory=lambda: np.full(2, np.inf))
    moved: float = -np.inf
    tried: int = 0
    recovery: str | None = None
    until: float = -np.inf
    turning: float = 0.0
    turned_at: Array = field(default_factory=lambda: np.full(2, np.inf))


class LayeredStack:
    """The stack; call `step` at the controller's rate.

    Args:
        settings: Its parameters.
    """

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = Settings() if settings is None else settings
        self._memory: _Memory | None = None
        self._static: tuple[OccupancyGrid, Costmap] | None = None
        inflation, padding = self.settings.inflation, self.settings.padding
        self._inflation = replace(inflation, inscribed=inflation.inscribed + padding)

    @property
    def path(self) -> Array | None:
        """The global plan, shape (N, 2) [m]."""
        return None if self._memory is None else self._memory.path

    def step(
        self,
        time: float,
        pose: Any,
        velocity: Any,
        people: Any,
        grid: OccupancyGrid,
        goal: Any,
    ) -> Command:
        """One period of the controller.

        Args:
            time: On any clock that does not run backwards [s].
            pose: (x, y, θ) of the robot.
            velocity: (v, ω) of the robot.
            people: Where people are seen now, shape (n, 2) [m].
            grid: The map.
            goal: Shape (2,) [m]; another goal begins anew.
        """
        pose, goal = np.asarray(pose, dtype=float), np.asarray(goal, dtype=float)
        people = np.asarray(people, dtype=float).reshape(-1, 2)
        if self._memory is None or not np.array_equal(self._memory.goal, goal):
            self._memory = _Memory(goal, worked=time, moved=time)
        memory, settings = self._memory, self.settings
        if np.linalg.norm(pose[:2] - goal) <= settings.tolerance:
            return Command(STOP, Status.REACHED)
        local = self._local(grid, people, pose)
        if memory.recovery is not None:
            if time < memory.until:
                return self._recover(memory, pose, local)
            memory.recovery, memory.planned, memory.worked = None, -np.inf, time
        self._note_progress(memory, time, pose)
        if time >= memory.planned + settings.planner_period or memory.path is None:
            self._plan(memory, time, pose, people, grid)
        command = self._control(memory, pose, velocity, local)
        if command.status is Status.FOLLOWING:
            memory.worked = time
        stuck = time - memory.worked > settings.patience
        if stuck or time - memory.moved > settings.progress_time:
            return self._begin_recovery(memory, time, pose, local)
        return command

    def _local(self, grid: OccupancyGrid, people: Array, pose: Array) -> Costmap:
        settings = self.settings
        part = window(grid, pose[:2], settings.local_side)
        return Costmap.build(part, self._inflation, people, settings.person_radius)

    def _plan(
        self, memory: _Memory, time: float, pose: Array, people: Array, grid: OccupancyGrid
    ) -> None:
        """A global plan; where there is none the last one is kept."""
        settings = self.settings
        if settings.people_in == "global":
            whole = Costmap.build(grid, self._inflation, people, settings.person_radius)
        else:
            if self._static is None or self._static[0] is not grid:
                self._static = (grid, Costmap.build(grid, self._inflation))
            whole = self._static[1]
        path = shortest_path(whole, pose[:2], memory.goal)
        memory.planned = time
        if path is not None:
            memory.path = path

    def _control(self, memory: _Memory, pose: Array, velocity: Any, local: Costmap) -> Command:
        settings = self.settings
        if memory.path is None:
            return Command(STOP, Status.NO_VALID_PATH, "the goal cannot be reached")
        weights = settings.weights
        if np.linalg.norm(pose[:2] - memory.goal) < 2 * weights.nose:
            # Else the robot would stop where its nose is at the goal (dwa_local_planner's "cheat").
            weights = replace(weights, nose=0.0)
        scene = Scene.build(local, _ahead(memory.path, pose), weights)
        if scene is None:
            return Command(STOP, Status.NO_VALID_PATH, "the plan has left the local costmap")
        commands = self._commands(memory, pose, velocity)
        choice = choose(scene, settings.window.roll_out(pose, commands))
        if choice.index is None:
            return Command(
                _brake(settings.window, velocity), Status.NO_VALID_CONTROL, "all rejected"
            )
        v, w = commands[choice.index].tolist()
        if abs(v) < settings.min_speed and memory.turning == 0.0:
            memory.turning, memory.turned_at = float(np.sign(w)), pose[:2].copy()
        return Command(Twist(v, 0.0, w), Status.FOLLOWING)

    def _commands(self, memory: _Memory, pose: Array, velocity: Any) -> Array:
        """The lattice of the dynamic window, without what hardly moves, and without turning back
        on the spot (dwa_local_planner's OscillationCostFunction)."""
        settings = self.settings
        if np.linalg.norm(pose[:2] - memory.turned_at) > settings.oscillation:
            memory.turning = 0.0
        commands = settings.window.lattice(velocity, settings.speeds, settings.turns)
        slow = np.abs(commands[:, 0]) < settings.min_speed - 1e-9
        idle = slow & (np.abs(commands[:, 1]) < settings.min_turn - 1e-9)
        back = slow & (commands[:, 1] * memory.turning < 0)
        return np.asarray(commands[~(idle | back)])

    def _note_progress(self, memory: _Memory, time: float, pose: Array) -> None:
        if np.linalg.norm(pose[:2] - memory.anchor) > self.settings.progress_radius:
            if np.isfinite(memory.anchor).all():
                memory.tried = 0  # it moves again: recoveries start from the first
            memory.anchor, memory.moved = pose[:2].copy(), time

    def _begin_recovery(self, memory: _Memory, time: float, pose: Array, local: Costmap) -> Command:
        settings = self.settings
        if memory.tried >= settings.rounds * len(RECOVERIES):
            return Command(STOP, Status.FAILED, "all recoveries have failed")
        memory.recovery = RECOVERIES[memory.tried % len(RECOVERIES)]
        memory.tried += 1
        lasts = {
            "clear costmaps": 0.0,
            "spin": 2 * np.pi / settings.spin_rate,
            "wait": settings.wait_time,
            "back up": settings.backup_distance / settings.backup_speed,
        }
        memory.until = time + lasts[memory.recovery]
        # What a recovery moves is no progress.
        memory.anchor = np.full(2, np.inf)
        memory.path, memory.planned = None, -np.inf
        return self._recover(memory, pose, local)

    def _recover(self, memory: _Memory, pose: Array, local: Costmap) -> Command:
        name = memory.recovery or ""
        twist = STOP
        if name == "spin":
            twist = Twist(0.0, 0.0, self.settings.spin_rate)
        elif name == "back up":
            back = pose[:2] - 0.2 * np.array([np.cos(pose[2]), np.sin(pose[2])])
            if local.at(back) < INSCRIBED:
                twist = Twist(-self.settings.backup_speed, 0.0, 0.0)
        return Command(twist, Status.RECOVERING, name)


def _ahead(path: Array, pose: Array) -> Array:
    """The plan from the vertex nearest to the robot on: what is driven is pruned."""
    return path[int(np.argmin(np.linalg.norm(path - pose[:2], axis=1))) :]


def _brake(limits: Window, velocity: Any) -> Twist:
    """As slow as one period allows."""
    low, high = limits.bounds(velocity)
    v, w = np.clip(0.0, low, high).tolist()
    return Twist(v, 0.0, w)
