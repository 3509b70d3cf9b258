"""People who pick their way as pedestrians do, by navground (extra `[sim]`).

Each looks at how far every direction is free and takes the one that brings them nearest to where
they want to go, at a speed that leaves time to stop.

Reference:
    Guzzi, Giusti, Gambardella, Theraulaz, Di Caro, Human-friendly Robot Navigation in Dynamic
    Environments, ICRA 2013; after Moussaid, Helbing, Theraulaz, PNAS 108, 2011.
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


@dataclass(frozen=True)
class HumanLike:
    """Parameters.

    Args:
        horizon: How far people look ahead [m].
        aperture: Half of the angle in which they look for a way [rad].
        tau: Relaxation time of their velocity [s].
        eta: Time they want to have left to stop [s].
        margin: Kept from everybody [m].
        distance: Within which others are heeded [m].
    """

    horizon: float = 5.0
    aperture: float = np.pi / 2
    tau: float = 0.25
    eta: float = 0.5
    margin: float = 0.05
    distance: float = 6.0

    def motion(self, radii: Array, most: Array, walls: Iterable[Array] = ()) -> HumanLikeMotion:
        """People who make way; the arguments are those of `HumanLikeMotion`."""
        return HumanLikeMotion(self, radii, most, walls)


class HumanLikeMotion:
    """A behaviour of navground for each person.

    Args:
        settings: Parameters.
        radii: Of the people, shape (n,) [m].
        most: Their largest speeds, shape (n,) [m/s].
        walls: Polygons (N, 2), counter-clockwise [m].
    """

    def __init__(
        self, settings: HumanLike, radii: Array, most: Array, walls: Iterable[Array] = ()
    ) -> None:
        self._core: Any = needed("navground.core")
        core = self._core
        self._radii, self._distance = radii, settings.distance
        lines = [
            core.LineSegment(tuple(a), tuple(b))
            for wall in walls
            for a, b in zip(wall.tolist(), np.roll(wall, -1, axis=0).tolist(), strict=True)
        ]
        self._behaviours: list[Any] = []
        for radius, speed in zip(radii.tolist(), most.tolist(), strict=True):
            kinematics = core.kinematics.OmnidirectionalKinematics(speed, 10.0)
            behaviour = core.behaviors.HLBehavior(kinematics, radius)
            behaviour.horizon = settings.horizon
            behaviour.aperture = settings.aperture
            behaviour.tau = settings.tau
            behaviour.eta = settings.eta
            behaviour.safety_margin = settings.margin
            behaviour.environment_state.line_obstacles = lines
            self._behaviours.append(behaviour)

    def __call__(
        self, positions: Array, velocities: Array, wishes: Array, dt: float, robot: Disc | None
    ) -> Array:
        core = self._core
        seen = [
            core.Neighbor(tuple(p), r, tuple(v), i)
            for i, (p, v, r) in enumerate(
                zip(positions.tolist(), velocities.tolist(), self._radii.tolist(), strict=True)
            )
        ]
        places = positions
        if robot is not None:
            at, way = robot.position.tolist(), robot.velocity.tolist()
            seen.append(core.Neighbor(tuple(at), robot.radius, tuple(way), len(seen)))
            places = np.vstack([positions, robot.position])
        apart = np.linalg.norm(positions[:, None] - places, axis=-1)
        chosen = np.zeros_like(velocities)
        for i, behaviour in enumerate(self._behaviours):
            vx, vy = wishes[i].tolist()
            speed = float(np.hypot(vx, vy))
            heading = float(np.arctan2(vy, vx)) if speed > 0 else behaviour.orientation
            behaviour.pose = core.Pose2(tuple(positions[i].tolist()), heading)
            behaviour.velocity = tuple(velocities[i].tolist())
            near = np.flatnonzero(apart[i] < self._distance).tolist()
            behaviour.environment_state.neighbors = [seen[j] for j in near if j != i]
            if speed > 0:
                behaviour.target = core.Target.Velocity((vx, vy))
            else:
                behaviour.target = core.Target.Stop()
            command = behaviour.compute_cmd(dt, core.Frame.absolute)
            chosen[i] = command.velocity
        return chosen
