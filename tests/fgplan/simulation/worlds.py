"""Small worlds for tests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fgplan.driving import Observation
from fgplan.scenario import Robot, Scenario
from fgplan.simulation.body import Limits
from fgplan.simulation.people import heedless
from fgplan.simulation.policy import Command
from fgplan.simulation.walkers import Walker, Walkers
from fgplan.simulation.world import Plain, Rules, World


class Stands:
    """A policy that does nothing."""

    def step(self, observation: Observation) -> Command:
        return Command(np.zeros(2))


class Breaks:
    """A policy with a bug."""

    def step(self, observation: Observation) -> Command:
        raise RuntimeError("no idea")


def world(walkers: Sequence[Walker] = (), goal: Any = (5.0, 0.0), **changes: Any) -> World:
    """Open space; a robot of 0.3 m at the origin that takes every velocity at once."""
    scenario = Scenario(
        Robot(np.zeros(2), radius=0.3, max_speed=1.0), goal=np.array(goal, dtype=float)
    )
    return World(
        **{
            "name": "test",
            "scenario": scenario,
            "people": Walkers(walkers, heedless),
            "sensor": Plain(),
            "limits": Limits(1.0),
            "rules": Rules(time_limit=20.0),
            **changes,
        }
    )


def passer(x: float, y: float, vx: float, vy: float, radius: float = 0.3) -> Walker:
    """Somebody who walks straight on."""
    position, velocity = np.array([x, y]), np.array([vx, vy])
    return Walker(
        position,
        (position + 1000 * velocity)[None],
        velocity=velocity,
        radius=radius,
        speed=float(np.hypot(vx, vy)),
    )
