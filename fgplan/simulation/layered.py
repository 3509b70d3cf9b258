"""The layered ROS stack as a policy."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fgplan.driving import Observation, Outcome
from fgplan.occupancy import OccupancyGrid
from fgplan.peers.costmap import Inflation
from fgplan.peers.dwa import Window
from fgplan.peers.layered import LayeredStack, Settings, Status
from fgplan.roadmap import roadmap
from fgplan.simulation.peers import goal_for
from fgplan.simulation.policy import Command
from fgplan.simulation.world import World

Array = NDArray[np.float64]

OUTCOMES = {
    Status.FOLLOWING: Outcome.FOLLOWING,
    Status.REACHED: Outcome.GOAL_REACHED,
    Status.NO_VALID_PATH: Outcome.NO_VALID_PATH,
    Status.NO_VALID_CONTROL: Outcome.NO_VALID_CONTROL,
    Status.RECOVERING: Outcome.STOPPED,
    Status.FAILED: Outcome.NO_PROGRESS,
}
OPEN = 5.0
"""How far an empty map reaches round start and goal where a world has none [m]."""
CELL = 0.1
"""Side of its cells [m]."""


class Layered:
    """A* on the costmap once a second, the dynamic window each period, recoveries.

    Args:
        world: Robot, goal, map and limits.
        people_in: Whether people are in the "local" costmap alone or in the "global" one, too.

    Raises:
        NoGoal: the world has none.
    """

    def __init__(self, world: World, people_in: Literal["local", "global"] = "local") -> None:
        scenario, limits = world.scenario, world.limits
        robot = scenario.robot
        self._goal = goal_for("layered", scenario)
        self._grid = _open(robot.position, self._goal) if scenario.grid is None else scenario.grid
        self._people: Array = np.array([track.positions[-1] for track in scenario.tracks])
        self._label = 0
        self._path: Array | None = None
        self._radius = robot.radius
        self._stack = LayeredStack(
            Settings(
                window=Window(
                    max_speed=min(robot.preferred_speed, limits.max_speed),
                    max_yaw_rate=limits.max_yaw_rate,
                    max_acceleration=min(robot.max_acceleration, limits.max_acceleration),
                    max_yaw_acceleration=limits.max_yaw_acceleration,
                    period=world.rules.period,
                ),
                inflation=Inflation(robot.radius),
                people_in=people_in,
                person_radius=float(np.max(world.people.radii, initial=0.0)) or 0.3,
                tolerance=0.9 * world.rules.tolerance,
            )
        )

    def step(self, observation: Observation) -> Command:
        if observation.goal is not None:
            self._goal = observation.goal
        if observation.grid is not None:
            self._grid = observation.grid
        if observation.detections is not None:
            self._people = np.array([d.position for d in observation.detections])
        heading = observation.heading or 0.0
        forward = np.array([np.cos(heading), np.sin(heading)])
        speed = float(observation.velocity @ forward)
        command = self._stack.step(
            observation.time,
            np.array([*observation.position, heading]),
            np.array([speed, observation.yaw_rate]),
            self._people,
            self._grid,
            self._goal,
        )
        twist = command.twist
        return Command(
            twist.linear_x * forward, twist, OUTCOMES[command.status], self._named(observation)
        )

    def _named(self, observation: Observation) -> str | None:
        """A number for the global plan, and the next one when it winds about the obstacles in
        another way than the last plan: what a switch is for a stack without hypotheses."""
        path, last = self._stack.path, self._path
        if path is None:
            return None
        if last is not None and path is not last and observation.grid is None:
            here = observation.position
            nearest = int(np.argmin(np.linalg.norm(last - here, axis=1)))
            loop = np.vstack([here, path, last[: nearest - 1 if nearest else None : -1]])
            road = roadmap(self._grid, self._radius)
            self._label += bool(np.any(road.signature(road.to_lattice(loop))))
        self._path = path
        return f"plan {self._label}"


def _open(start: Array, goal: Array) -> OccupancyGrid:
    """A map without obstacles."""
    low = np.minimum(start, goal) - OPEN
    size = np.maximum(start, goal) + OPEN - low
    cells = np.zeros(np.ceil(size[::-1] / CELL).astype(int), dtype=bool)
    return OccupancyGrid.from_array(cells, CELL, low)
