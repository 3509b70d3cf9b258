"""What drives a robot in a world: seen now goes in, a command comes out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fgplan.driving import Decision, Observation, Outcome
from fgplan.robots import Twist

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Command:
    """What to do until the next step.

    Args:
        velocity: In the map frame, shape (2,) [m/s]; what a holonomic base does.
        twist: In the base frame; where given it is what is done, by a base with wheels.
        outcome: How the step ended.
        label: Of the hypothesis that is followed; None when there is none.
        decision: All that the planner says, where it says more; for pictures.
    """

    velocity: Array
    twist: Twist | None = None
    outcome: Outcome = Outcome.FOLLOWING
    label: str | None = None
    decision: Decision | None = None


class Policy(Protocol):
    """Anything that drives; one is made anew for each episode."""

    def step(self, observation: Observation) -> Command:
        """What to do now; called once a control period, the robot's state is always seen."""
        ...
