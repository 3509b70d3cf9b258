"""A hypothesis: one global plan, its weight, and where the optimiser starts from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from fgplan.trajectory import Array, Trajectory


class Course(Protocol):
    """Where a plan is at any time: a `Trajectory` is one."""

    @property
    def times(self) -> Array:
        """The times it covers [s from now]."""
        ...

    def at(self, times: Any) -> Array:
        """States (x, y, vx, vy), shape (..., 4)."""
        ...


@dataclass(frozen=True, eq=False)
class Start:
    """An initial value for the optimiser: one guess of the robot's trajectory.

    Args:
        label: What the guess is: "plan", "wait", "left of p3", ...
        robot: States at the time steps of the density.
        crowd: The same for people by name; who is not named starts at their prediction.
    """

    label: str
    robot: Trajectory
    crowd: Mapping[str, Trajectory] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One global plan i of p(η_0) = Σ_i w_i p(η_0 | i).

    Args:
        label: Its name.
        log_prior: log w_i, normalised over the hypotheses.
        plan: The timed path, with states at the time steps of the density; None when no goal is
            known (the plan is then the robot's prior alone).
        cost: Cost to go J_i from where the robot is now to the goal [s].
        starts: Initial values, at least one.
        route: The untimed path, shape (N, 2) [m], for pictures; None when no goal is known.
        course: The plan at the times of data that the steps do not cover: before now, beyond the
            horizon. None goes on from both ends of the plan at the velocity there.
        own: Plans of levels that have hypotheses of their own, by the level's name.
    """

    label: str
    log_prior: float
    plan: Trajectory | None
    cost: float
    starts: tuple[Start, ...]
    route: Array | None = None
    course: Course | None = None
    own: Mapping[str, Trajectory] = field(default_factory=dict)

    def plan_of(self, level: str) -> Trajectory | None:
        """The plan that is the mean of a level."""
        return self.own.get(level, self.plan)

    def along_of(self, level: str) -> Course:
        """The same at any time.

        Raises:
            ValueError: there is no plan.
        """
        own = self.own.get(level)
        return self.along if own is None else own

    @property
    def along(self) -> Course:
        """The plan at any time.

        Raises:
            ValueError: there is no plan.
        """
        known = self.plan if self.course is None else self.course
        if known is None:
            raise ValueError(f"hypothesis {self.label!r} has no plan that data could measure")
        return known
