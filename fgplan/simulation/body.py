"""The robot's body: what a command makes of it, within its limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from factors.unicycle import advance
from fgplan.crowd import heading
from fgplan.occupancy import OccupancyGrid
from fgplan.scenario import Scenario
from fgplan.simulation.policy import Command

Array = NDArray[np.float64]

TOUCH = 0.01
"""A body whose edge is further inside a wall than this touches it [m]: maps are made of cells."""


@dataclass(frozen=True)
class Limits:
    """What the base can do, whatever it is told.

    Args:
        max_speed: [m/s].
        max_acceleration: [m/s²]; inf takes every velocity at once.
        max_yaw_rate: Of a base that is given a twist [rad/s].
        max_yaw_acceleration: The same [rad/s²].
    """

    max_speed: float
    max_acceleration: float = np.inf
    max_yaw_rate: float = 1.5
    max_yaw_acceleration: float = 3.0


class Body:
    """A disc on a holonomic base, which drives as a base with wheels where it is given a twist.

    Speeds change at the largest allowed rate until they are those of the command. A wall stops it:
    it stays where it was before a motion that would lead into one, or through it.

    Args:
        scenario: The robot at the start, and the map.
        limits: Of the base.
    """

    def __init__(self, scenario: Scenario, limits: Limits) -> None:
        robot = scenario.robot
        self.limits = limits
        self.radius = robot.radius
        self.position: Array = np.array(robot.position, dtype=float)
        self.velocity: Array = np.array(robot.velocity, dtype=float)
        self.heading = heading(scenario)
        self.yaw_rate = robot.yaw_rate
        self.blocked = False
        """Whether a wall stopped the last motion."""

    def advance(self, command: Command, dt: float, grid: OccupancyGrid | None) -> None:
        """Move on by dt [s]."""
        before = self.position
        if command.twist is None:
            self._slide(np.asarray(command.velocity, dtype=float), dt)
        else:
            self._roll(command.twist.linear_x, command.twist.angular_z, dt)
        self.blocked = False
        if grid is not None:
            way = _between(before, self.position, 0.5 * max(self.radius, grid.resolution))
            touching = grid.clearance(way, self.radius) < -TOUCH
            # Who is inside a wall may leave it.
            deeper = grid.clearance(way, 0.0) < grid.clearance(before, 0.0)
            if (touching & deeper).any():
                self.position, self.velocity = before, np.zeros(2)
            self.blocked = bool(touching.any())

    def _slide(self, wish: Array, dt: float) -> None:
        limits = self.limits
        wish = _shortened(wish, limits.max_speed)
        if np.isinf(limits.max_acceleration):
            self.velocity = wish
            self.position = self.position + dt * wish
        else:
            change = _shortened(wish - self.velocity, limits.max_acceleration * dt)
            self.position = self.position + dt * (self.velocity + 0.5 * change)
            self.velocity = self.velocity + change
        vx, vy = self.velocity.tolist()
        if vx * vx + vy * vy > 1e-4:
            self.heading = float(np.arctan2(vy, vx))

    def _roll(self, v: float, w: float, dt: float) -> None:
        limits = self.limits
        c, s = float(np.cos(self.heading)), float(np.sin(self.heading))
        along = float(self.velocity @ (c, s))
        v = float(np.clip(v, -limits.max_speed, limits.max_speed))
        w = float(np.clip(w, -limits.max_yaw_rate, limits.max_yaw_rate))
        most = dt * np.array([limits.max_acceleration, limits.max_yaw_acceleration])
        change = np.clip(np.array([v - along, w - self.yaw_rate]), -most, most)
        state = np.array([*self.position, self.heading, along, self.yaw_rate])
        state = advance(state, change, dt)
        self.position, self.heading = state[:2], float(state[2])
        self.yaw_rate = float(state[4])
        self.velocity = state[3] * np.array([np.cos(state[2]), np.sin(state[2])])


def _between(start: Array, end: Array, spacing: float) -> Array:
    """Points on the way from a point to another one, the last of them, no further apart than this
    [m]; shape (n, 2)."""
    count = max(1, int(np.ceil(np.hypot(*(end - start)) / spacing)))
    return np.linspace(start, end, count + 1)[1:]


def _shortened(vector: Array, most: float) -> Array:
    """The vector, at most so long."""
    x, y = vector.tolist()
    length = (x * x + y * y) ** 0.5
    return vector if length <= most else vector * (most / length)
