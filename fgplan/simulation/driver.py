"""fgplan's planner as a policy, whole or with one feature removed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from fgplan.driving import Observation, Planner, Settings
from fgplan.holonomic import Holonomic
from fgplan.simulation.policy import Command
from fgplan.simulation.world import World


class Driver:
    """Does what a planner decides; a robot with wheels is told its twist.

    Args:
        planner: Decides.
        wheels: Whether the robot has wheels.
    """

    def __init__(self, planner: Planner, wheels: bool = False) -> None:
        self.planner = planner
        self._wheels = wheels

    def step(self, observation: Observation) -> Command:
        decision = self.planner.step(observation)
        twist = decision.action.twist if self._wheels else None
        return Command(decision.action.velocity, twist, decision.outcome, decision.label, decision)


@dataclass(frozen=True)
class Fgplan:
    """Makes drivers.

    No deadline by default: a run must not depend on what else the machine does.

    Args:
        crowd: What people do in the density; None is what the scenario says.
        count: Global plans at most; None is what the scenario says.
        density: Parameters of the density to change, by name.
        settings: Of the planner; period, lag and tolerance are those of the world, and the
            guard's margin where the world has one.
    """

    crowd: Literal["joint", "predicted"] | None = None
    count: int | None = None
    density: dict[str, Any] = field(default_factory=dict)
    settings: Settings = field(default_factory=lambda: Settings(deadline=None))

    def __call__(self, world: World) -> Driver:
        scenario = world.scenario
        if self.crowd is not None:
            scenario = scenario.replace(crowd=self.crowd)
        if self.count is not None:
            scenario = scenario.replace(count=self.count)
        scenario = scenario.replace(density=replace(scenario.density, **self.density))
        guard, clearance = self.settings.guard, world.rules.clearance
        settings = replace(
            self.settings,
            guard=guard if clearance is None else replace(guard, margin=clearance),
            period=world.rules.period,
            lag=0.0 if np.isinf(world.limits.max_acceleration) else 0.5,
            # The run ends at the tolerance: nearer, the planner would stop before it.
            goal_tolerance=0.9 * world.rules.tolerance,
        )
        return Driver(Planner(scenario, settings), not isinstance(scenario.robot.model, Holonomic))
