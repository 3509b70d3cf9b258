"""What drives a robot in a world: seen now goes in, a command comes out."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fgplan.driving import Decision, Observation, Outcome
from fgplan.errors import FgplanError
from fgplan.robots import Twist

Array = NDArray[np.float64]


class NotFinite(FgplanError, ValueError):
    """A command that no robot can execute."""


@dataclass(frozen=True, eq=False)
class Command:
    """What to do until the next step.

    Args:
        velocity: In the map frame, shape (2,) [m/s]; what a holonomic base does.
        twist: In the base frame; where given it is what is done, by a base with wheels.
        outcome: How the step ended.
        label: Of the hypothesis that is followed; None when there is none.
        decision: All that the planner says, where it says more; for pictures.

    Raises:
        NotFinite: a velocity or a twist is not a finite number.
    """

    velocity: Array
    twist: Twist | None = None
    outcome: Outcome = Outcome.FOLLOWING
    label: str | None = None
    decision: Decision | None = None

    def __post_init__(self) -> None:
        twist = () if self.twist is None else astuple(self.twist)
        if not np.all(np.isfinite([*self.velocity, *twist])):
            raise NotFinite(
                f"command: got velocity {np.asarray(self.velocity).tolist()}, twist {self.twist}; "
                "give finite numbers"
            )


class Policy(Protocol):
    """Anything that drives; one is made anew for each episode."""

    def step(self, observation: Observation) -> Command:
        """What to do now; called once a control period, the robot's state is always seen."""
        ...
