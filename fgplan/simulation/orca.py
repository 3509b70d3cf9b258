"""Optimal reciprocal collision avoidance, by pyrvo (extra `[sim]`): people, and a peer.

Reference:
    van den Berg, Guy, Lin, Manocha, Reciprocal n-Body Collision Avoidance, ISRR 2011.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgplan.simulation.extra import needed
from fgplan.simulation.people import Disc

Array = NDArray[np.float64]

FAR = (1e6, 1e6)
"""Where the robot is for people who do not see it."""


@dataclass(frozen=True)
class Orca:
    """Parameters, with the values of the published CrowdNav code.

    Args:
        neighbours: How many others are heeded at most.
        distance: Within which others are heeded [m].
        horizon: Time for which a velocity is free of contact with others [s].
        horizon_walls: The same for walls [s].
        skin: Added to every radius [m].
        least: Nobody is taken for thinner than this radius [m].
    """

    neighbours: int = 10
    distance: float = 10.0
    horizon: float = 5.0
    horizon_walls: float = 5.0
    skin: float = 0.01
    least: float = 0.3

    def size(self, radius: float) -> float:
        """What a radius [m] counts for."""
        return max(radius + self.skin, self.least)

    def motion(self, radii: Array, most: Array, walls: Iterable[Array] = ()) -> OrcaMotion:
        """People who keep apart; the arguments are those of `OrcaMotion`."""
        return OrcaMotion(self, radii, most, walls)


class OrcaMotion:
    """Agents who all choose their velocities by ORCA, and one more who is driven by others.

    Args:
        settings: Parameters.
        radii: Of the agents, shape (n,) [m].
        most: Their largest speeds, shape (n,) [m/s].
        walls: Polygons (N, 2), counter-clockwise [m].
    """

    def __init__(
        self, settings: Orca, radii: Array, most: Array, walls: Iterable[Array] = ()
    ) -> None:
        pyrvo = needed("pyrvo")
        common = (settings.distance, settings.neighbours, settings.horizon, settings.horizon_walls)
        self._simulator: Any = pyrvo.RVOSimulator(0.1, *common, 0.3, 1.0)
        for wall in walls:
            self._simulator.add_obstacle([tuple(vertex) for vertex in wall.tolist()])
        self._simulator.process_obstacles()
        self._count = len(radii)
        for radius, speed in zip([*radii.tolist(), 0.3], [*most.tolist(), 1.0], strict=True):
            self._simulator.add_agent(FAR, *common, settings.size(radius), speed, (0.0, 0.0))
        self._size = settings.size

    def __call__(
        self, positions: Array, velocities: Array, wishes: Array, dt: float, robot: Disc | None
    ) -> Array:
        simulator = self._simulator
        simulator.set_time_step(dt)
        rows = zip(positions.tolist(), velocities.tolist(), wishes.tolist(), strict=True)
        for i, (position, velocity, wish) in enumerate(rows):
            simulator.set_agent_position(i, position)
            simulator.set_agent_velocity(i, velocity)
            simulator.set_agent_pref_velocity(i, wish)
        other = self._count
        if robot is None:
            simulator.set_agent_position(other, FAR)
        else:
            simulator.set_agent_radius(other, self._size(robot.radius))
            simulator.set_agent_position(other, robot.position.tolist())
            simulator.set_agent_velocity(other, robot.velocity.tolist())
        simulator.do_step()
        chosen = (simulator.get_agent_velocity(i) for i in range(other))
        return np.array([(v.x, v.y) for v in chosen]).reshape(other, 2)
