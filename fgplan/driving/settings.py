"""How a robot drives: every choice that is not part of the density, with its default."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fgplan import selection
from fgplan.driving.guard import Guard
from fgplan.driving.intake import Intake
from fgplan.driving.pricing import Pricing
from fgplan.driving.routing import Routing
from fgplan.driving.tracking import Tracking
from fgplan.driving.way_out import WayOut
from fgplan.inference import MAP, Inference
from fgplan.solver import SecondOrder, Solver
from fgplan.starts import Starts, starts


@dataclass(frozen=True)
class Settings:
    """What a `Planner` is built with, beside the scenario.

    Args:
        period: Between two steps [s]: a command is given for this long.
        deadline: Time a step may take [s]; None lets its plan end.
        commitment: Prior cost of leaving the hypothesis that is followed: a factor
            exp(−commitment) on every other one [nats].
        deliberation: Time over which the advantage of another route is averaged before it is
            taken [s]; 0 believes the last plan alone.
        wait: How long a "wait" hypothesis waits at least, where people block the way within the
            horizon [s]; 0 proposes none.
        goal_tolerance: A goal is reached this near to it [m] (Nav2's xy_goal_tolerance).
        blind: Without a usable observation the last plan goes on for this long, then the robot
            stops [s].
        stall: A robot that has not come nearer to its goal on the way it follows for this long
            makes no progress [s].
        lag: See `fgplan.driving.guard`: 0 for a simulator in which speed changes at once.
        routing, tracking, pricing, guard, intake: See there.
        way_out: What is looked for where no plan is clear or leads on; None leaves it to the guard
            alone.
        starts: Where the optimiser starts from on a route; see `fgplan.starts`.
        solver: Of each plan; there will be another one in a moment, so a thousandth of a nat is
            near enough.
        select, inference: As `fgplan.plan` takes them.

    Raises:
        ValueError: a time, a distance or a cost makes no sense.
    """

    period: float = 0.1
    deadline: float | None = 0.08
    commitment: float = 1.0
    deliberation: float = 0.5
    wait: float = 2.0
    goal_tolerance: float = 0.25
    blind: float = 1.0
    stall: float = 20.0
    lag: float = 0.5
    routing: Routing = field(default_factory=Routing)
    tracking: Tracking = field(default_factory=Tracking)
    pricing: Pricing = field(default_factory=Pricing)
    guard: Guard = field(default_factory=Guard)
    intake: Intake = field(default_factory=Intake)
    way_out: WayOut | None = field(default_factory=WayOut)
    starts: Starts = starts
    solver: Solver = SecondOrder(max_iterations=30, tolerance=1e-3, margin=0.0)  # noqa: RUF009
    select: selection.Rule = selection.height
    inference: Inference = field(default_factory=MAP)

    def __post_init__(self) -> None:
        above = {"period": self.period, "goal_tolerance": self.goal_tolerance, "stall": self.stall}
        if self.deadline is not None:
            above["deadline"] = self.deadline
        for name, value in above.items():
            if not value > 0:
                raise ValueError(f"{name} must be above 0, got {value}")
        for name in ("commitment", "deliberation", "wait", "blind"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must be 0 or above, got {getattr(self, name)}")
        if not np.isfinite(self.period):
            raise ValueError(f"period must be finite, got {self.period}")
        if not 0 <= self.lag <= 1:
            raise ValueError(f"lag is a share of a period, from 0 to 1, got {self.lag}")
