"""What a robot program says at each step, and what it is told."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fgplan.mixture import Action, Mixture
from fgplan.trajectory import Trajectory

if TYPE_CHECKING:
    from fgplan.measuring import Measurement
    from fgplan.mission import Mission
    from fgplan.occupancy import OccupancyGrid
    from fgplan.shared_control import Deviation

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Detection:
    """One person, seen now.

    Args:
        position: Shape (2,) [m], map frame.
        identity: Name of the person where the detector tracks; None leaves it to the planner.
        radius: Of the person's disc [m].
        velocity: Shape (2,) [m/s], where the detector knows it; None leaves it to the track.
    """

    position: Array
    identity: str | None = None
    radius: float = 0.3
    velocity: Array | None = None


@dataclass(frozen=True, eq=False)
class Observation:
    """What is known at one moment; all but the robot's state is optional.

    Args:
        time: On the robot's clock [s], increasing from step to step.
        position: Of the robot, shape (2,) [m], map frame.
        velocity: Shape (2,) [m/s], map frame.
        heading: [rad], for a robot that has one.
        yaw_rate: [rad/s].
        covariance: Of the robot model's state; None means exact.
        detections: People seen now. An empty tuple says that nobody is in sight; None, that
            nothing was sensed since the last step (a dropout): known people go on as predicted.
        grid: A map that replaces the one so far; None keeps it.
        goal: A goal that replaces the one so far, shape (2,) [m]; None keeps it.
        operator: New operator data, each item once (`fgplan.measuring`).
        facts: What a mission's facts are from now on ("door_closed": True); those that are not
            named stay as they are.
    """

    time: float
    position: Array
    velocity: Array = field(default_factory=lambda: np.zeros(2))
    heading: float | None = None
    yaw_rate: float = 0.0
    covariance: Array | None = None
    detections: tuple[Detection, ...] | None = ()
    grid: OccupancyGrid | None = None
    goal: Array | None = None
    operator: tuple[Measurement, ...] = ()
    facts: Mapping[str, bool] = field(default_factory=dict)


@dataclass(frozen=True)
class Intent:
    """What the operator is taken to want.

    Args:
        probability: Of each hypothesis by name: of each candidate goal, where no goal is known.
        since: When the most probable one became certain, and has stayed so [s]; None where it has
            not.
        deviation: How far the plan stays behind what was asked for; None where nothing is asked.
    """

    probability: dict[str, float]
    since: float | None
    deviation: Deviation | None

    @property
    def best(self) -> str:
        """The most probable one."""
        return max(self.probability, key=lambda name: self.probability[name])


class Outcome(StrEnum):
    """How a step ended, for a robot program to act on; Nav2's names where it has one."""

    FOLLOWING = "FOLLOWING"
    SWITCHING = "SWITCHING"
    WAITING = "WAITING"
    REPLANNING = "REPLANNING"
    GOAL_REACHED = "GOAL_REACHED"
    STOPPED = "STOPPED"
    NO_VALID_PATH = "NO_VALID_PATH"
    START_OCCUPIED = "START_OCCUPIED"
    START_OUTSIDE_MAP = "START_OUTSIDE_MAP"
    GOAL_OCCUPIED = "GOAL_OCCUPIED"
    GOAL_OUTSIDE_MAP = "GOAL_OUTSIDE_MAP"
    NO_VALID_CONTROL = "NO_VALID_CONTROL"
    NO_PROGRESS = "NO_PROGRESS"
    TIMEOUT = "TIMEOUT"
    BAD_OBSERVATION = "BAD_OBSERVATION"


@dataclass(frozen=True, eq=False)
class Decision:
    """What to do until the next step.

    Args:
        time: Of the observation it answers [s].
        action: Velocity in the map frame and Twist in the base frame; always finite, within the
            robot's limits, and never one that the planner's own check calls a collision while
            another one is clear.
        outcome: How the step ended.
        reason: The same in words: why this hypothesis, why the robot stands.
        trajectory: What will be driven.
        mixture: All hypotheses, weighed; None where there was nothing to plan or no time.
        label: Of the hypothesis that is followed; None when none is.
        repairs: What was wrong with the observation, and what was done about it.
        seconds: Time spent.
        mission: How far the mission is done; None where none was given.
        intent: What the operator is taken to want; None where nobody said anything.
    """

    time: float
    action: Action
    outcome: Outcome
    reason: str
    trajectory: Trajectory
    mixture: Mixture | None = None
    label: str | None = None
    repairs: tuple[str, ...] = ()
    seconds: float = 0.0
    mission: Mission | None = None
    intent: Intent | None = None
