"""fgplan's planner as a policy."""

from __future__ import annotations

from typing import Protocol

from fgplan.driving import Decision, Observation
from fgplan.robots import Holonomic
from fgplan.scenario import Scenario
from fgplan.simulation.policy import Command


class Decides(Protocol):
    """What `fgplan.driving.Planner` does."""

    def step(self, observation: Observation) -> Decision:
        """What to do until the next step."""
        ...


class Driver:
    """Does what a planner decides; a robot with wheels is told its twist.

    Args:
        planner: Decides.
        scenario: Whose robot it drives.
    """

    def __init__(self, planner: Decides, scenario: Scenario) -> None:
        self._planner = planner
        self._wheels = not isinstance(scenario.robot.model, Holonomic)

    def step(self, observation: Observation) -> Command:
        decision = self._planner.step(observation)
        twist = decision.action.twist if self._wheels else None
        return Command(decision.action.velocity, twist, decision.outcome, decision.label, decision)
