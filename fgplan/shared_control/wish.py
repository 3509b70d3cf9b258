"""How far a plan is from what the operator asked for, to be shown while driving."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgplan.conditioning import log_likelihood, nearest
from fgplan.measuring import Reading
from fgplan.scenario import Scenario
from fgplan.trajectory import Trajectory


@dataclass(frozen=True)
class Deviation:
    """A plan beside the operator's wish.

    Args:
        metres: Largest distance from where the wish would have the robot [m]: from a place, at
            its time; from a velocity that is held since now, until its time.
        nats: −log of how probable the operator's data is on this plan, against a plan that fits
            it exactly.
    """

    metres: float
    nats: float


def deviation(scenario: Scenario, plan: Trajectory) -> Deviation | None:
    """What a plan for now leaves of the operator's wishes from now on; None where there are none.

    A place without a time that the plan still comes nearer to at its end is not left behind yet.

    Args:
        scenario: With its data.
        plan: What will be driven, times from now.
    """
    now, end = scenario.now, float(plan.times[-1])
    readings = [
        reading
        for measurement in scenario.data
        for reading in measurement.readings
        if (_passed(reading, plan) if reading.time is None else now <= reading.time <= now + end)
    ]
    if not readings:
        return None
    metres = 0.0
    for reading in readings:
        t = nearest(reading, plan) if reading.time is None else reading.time - now
        where = plan.at(t)[:2]
        wished = reading.value
        if reading.quantity == "velocity":
            wished = plan.positions[0] + np.multiply(t, reading.value)
        metres = max(metres, float(np.hypot(*(where - wished))))
    return Deviation(metres, -log_likelihood(readings, plan, now))


def _passed(reading: Reading, plan: Trajectory) -> bool:
    """Whether a plan comes no nearer to a place at its end."""
    return nearest(reading, plan) < float(plan.times[-1]) - 1e-6
