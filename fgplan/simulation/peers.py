"""Policies to measure against."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import believe
from fgplan.driving import Detection, Observation
from fgplan.errors import FgplanError
from fgplan.scenario import Density, Scenario, Track
from fgplan.simulation.orca import Orca, OrcaMotion
from fgplan.simulation.policy import Command
from fgplan.simulation.world import World

Array = NDArray[np.float64]

FORGET = 0.9
"""Who was not seen for this long is forgotten [s]."""
SETTLE = 1.0
"""ORCA slows down within this time of a goal where it stops, as in the CrowdNav code [s]."""
KEPT = 6
"""Detections kept of each person."""


class NoGoal(FgplanError, ValueError):
    """A peer in a world without a goal."""


class Straight:
    """To the goal at the preferred speed, through everything: what happens if nobody plans."""

    def __init__(self, world: World) -> None:
        self._goal = goal_for("straight", world.scenario)
        self._speed = world.scenario.robot.preferred_speed
        self._period = world.rules.period

    def step(self, observation: Observation) -> Command:
        if observation.goal is not None:
            self._goal = observation.goal
        return Command(_towards(self._goal, observation.position, self._speed, self._period))


class OrcaRobot:
    """ORCA towards the goal; it knows people and no map.

    Args:
        world: Robot, goal, who was seen before, and the rules.
        settings: Parameters.
    """

    def __init__(self, world: World, settings: Orca | None = None) -> None:
        self._goal = goal_for("orca", world.scenario)
        self._robot = world.scenario.robot
        self._period = world.rules.period
        self._settle = SETTLE if world.rules.slows_down else self._period
        self._settings = Orca() if settings is None else settings
        self._memory = Memory(world.scenario)
        self._motions: dict[tuple[float, ...], OrcaMotion] = {}

    def step(self, observation: Observation) -> Command:
        if observation.goal is not None:
            self._goal = observation.goal
        states, radii = self._memory.update(observation)
        # Agent 0 is the robot; the others' wishes do not matter to it.
        key = tuple(radii)
        motion = self._motions.get(key)
        if motion is None:
            self._motions.clear()
            sizes = np.array([self._robot.radius, *radii])
            most = np.full(len(sizes), self._robot.max_speed)
            motion = self._motions[key] = OrcaMotion(self._settings, sizes, most)
        positions = np.vstack([observation.position, states[:, :2]])
        velocities = np.vstack([observation.velocity, states[:, 2:]])
        wishes = np.zeros_like(positions)
        speed = self._robot.preferred_speed
        wishes[0] = _towards(self._goal, observation.position, speed, self._settle)
        return Command(motion(positions, velocities, wishes, self._period, None)[0])


class Memory:
    """Who was seen lately, and how they move: as the detector says, else by the density's own
    belief about their track."""

    def __init__(self, scenario: Scenario) -> None:
        self._density = scenario.density
        self._tracks: dict[str, list[tuple[float, float, float]]] = {}
        self._radii: dict[str, float] = {}
        for track in scenario.tracks:
            rows = np.column_stack([track.times, track.positions])[-KEPT:]
            self._tracks[track.identity] = [tuple(row) for row in rows.tolist()]
            self._radii[track.identity] = track.radius

    def update(self, observation: Observation) -> tuple[Array, list[float]]:
        """States now, shape (n, 4), and radii."""
        told: dict[str, Array] = {}
        for number, detection in enumerate(observation.detections or ()):
            name = detection.identity or f"unnamed {number}"
            if detection.velocity is not None:
                told[name] = np.concatenate([detection.position, detection.velocity])
                self._radii[name] = detection.radius
            else:
                self._note(observation.time, name, detection)
        for name in [n for n, t in self._tracks.items() if t[-1][0] < observation.time - FORGET]:
            del self._tracks[name]
        states = [*told.values(), *self._believed(observation.time)]
        names = [*told, *self._tracks]
        return np.array(states).reshape(-1, 4), [self._radii[name] for name in names]

    def _note(self, time: float, name: str, detection: Detection) -> None:
        rows = self._tracks.setdefault(name, [])
        if rows and rows[-1][0] >= time:
            return
        rows.append((time, *detection.position.tolist()))
        del rows[:-KEPT]
        self._radii[name] = detection.radius

    def _believed(self, now: float) -> Array:
        if not self._tracks:
            return np.zeros((0, 4))
        density: Density = self._density
        tracks = []
        for name, rows in self._tracks.items():
            table = np.array(rows)
            tracks.append(Track(name, table[:, 0], table[:, 1:]))
        sigmas = density.sigma_track, density.sigma_speed
        return believe(tracks, now, density.Qc_people, *sigmas).mean


def goal_for(planner: str, scenario: Scenario) -> Array:
    """The goal, shape (2,) [m], for a planner that knows nothing else to do.

    Raises:
        NoGoal: the scenario has none.
    """
    if scenario.goal is None:
        raise NoGoal(
            f"planner {planner} needs a goal: got none in {scenario.name!r}; give the scenario a "
            "`goal`, or take fgplan, which drives to do a [mission]"
        )
    return np.asarray(scenario.goal, dtype=float)


def _towards(goal: Array, position: Array, speed: float, settle: float) -> Array:
    """The speed towards the goal, less within a time of it [s]."""
    offset = goal - position
    away = float(np.hypot(offset[0], offset[1]))
    return offset * min(1.0 / settle, speed / max(away, 1e-9))
