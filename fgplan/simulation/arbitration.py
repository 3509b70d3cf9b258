"""Shared control as it is usually arbitrated: autonomy first, then the stick.

Autonomy is fgplan's own planner that is told nothing of the operator.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fgplan.driving import Observation
from fgplan.peers.blending import TwistMux, blend
from fgplan.shared_control import Joystick
from fgplan.simulation.driver import Driver, Fgplan
from fgplan.simulation.policy import Command
from fgplan.simulation.world import World

Array = NDArray[np.float64]


class _Arbitrated:
    """Remembers the stick."""

    def __init__(self, autonomy: Driver) -> None:
        self.autonomy = autonomy
        self._stick: tuple[float, Array] | None = None

    def _ask(self, observation: Observation) -> tuple[Command, Array | None, float]:
        """Autonomy's command, the operator's last one, and how old that is [s]."""
        for said in observation.operator:
            if isinstance(said, Joystick):
                self._stick = said.time, said.velocity
        command = self.autonomy.step(replace(observation, operator=()))
        if self._stick is None:
            return command, None, np.inf
        return command, self._stick[1], observation.time - self._stick[0]


class Switching(_Arbitrated):
    """The stick while it is held, else autonomy: twist_mux.

    Args:
        autonomy: Drives by itself.
        mux: Who is asked.
    """

    def __init__(self, autonomy: Driver, mux: TwistMux) -> None:
        super().__init__(autonomy)
        self.mux = mux

    def step(self, observation: Observation) -> Command:
        command, wish, age = self._ask(observation)
        return replace(command, velocity=self.mux.choose(command.velocity, wish, age), twist=None)


class Blending(_Arbitrated):
    """u = K_h u_h + (1 − K_h) u_R while the stick is held, else autonomy.

    Args:
        autonomy: Drives by itself.
        gain: K_h.
        timeout: A stick that has been silent for longer is not held [s].
    """

    def __init__(self, autonomy: Driver, gain: float, timeout: float) -> None:
        super().__init__(autonomy)
        self.gain, self.timeout = gain, timeout

    def step(self, observation: Observation) -> Command:
        command, wish, age = self._ask(observation)
        if wish is None or age > self.timeout:
            return command
        return replace(command, velocity=blend(wish, command.velocity, self.gain), twist=None)


@dataclass(frozen=True)
class TwistMuxPlanner:
    """Makes `Switching` for a world."""

    autonomy: Fgplan = Fgplan()  # noqa: RUF009 - frozen
    mux: TwistMux = TwistMux()  # noqa: RUF009 - frozen

    def __call__(self, world: World) -> Switching:
        return Switching(self.autonomy(world), self.mux)


@dataclass(frozen=True)
class BlendingPlanner:
    """Makes `Blending` for a world; K_h = ½ is that of two sides that are equally sure."""

    autonomy: Fgplan = Fgplan()  # noqa: RUF009 - frozen
    gain: float = 0.5
    timeout: float = 0.5

    def __call__(self, world: World) -> Blending:
        return Blending(self.autonomy(world), self.gain, self.timeout)
