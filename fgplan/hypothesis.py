"""A hypothesis: one global plan, its weight, and where the optimiser starts from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fgplan.trajectory import Array, Trajectory


@dataclass(frozen=True, eq=False)
class Course:
    """A plan through time: what it was at each moment until now, and what it is now.

    Plans are rebuilt from where the robot is, so a datum of two seconds ago cannot be compared
    with a plan of now: it is compared with the plan there was when it was said.

    Args:
        starts: When each plan was made, increasing, the last one usually 0 [s from now].
        plans: On their own clocks, which begin at 0.
    """

    starts: Array
    plans: tuple[Trajectory, ...]

    @property
    def times(self) -> Array:
        """From the first plan's beginning to the last one's end [s from now]."""
        last = self.starts[-1] + self.plans[-1].times
        return np.concatenate([self.starts[:-1], last])

    def at(self, times: Any, said: Any = None) -> Array:
        """States (x, y, vx, vy) at times from now, shape (..., 4), each by the plan there was
        when it was `said` [s from now], by default at that time itself."""
        t = np.asarray(times, dtype=float)
        when = t if said is None else np.broadcast_to(np.asarray(said, dtype=float), t.shape)
        if len(self.plans) == 1:
            return self.plans[0].at(t - self.starts[0])
        which = np.clip(np.searchsorted(self.starts, when + 1e-6, side="right") - 1, 0, None)
        states = np.empty((*t.shape, 4))
        for k in np.unique(which):
            mine = which == k
            states[mine] = self.plans[k].at(t[mine] - self.starts[k])
        return states


@dataclass(frozen=True, eq=False)
class Heard:
    """What data that is kept no longer says of a level: exp(−½‖A x − b‖²), x its state less the
    plan that there was.

    Args:
        time: Of the state [s], on the clock of `Scenario.now`.
        A: Shape (r, 4), r ≤ 4.
        b: Shape (r,).
    """

    time: float
    A: Array
    b: Array


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
            horizon. None goes on from both ends of the plan at the velocity there. A trajectory
            is the plan of now, at more times.
        own: Plans of levels that have hypotheses of their own, by the level's name.
        heard: What is left of data that is kept no longer, by the level's name; what it says
            against the hypothesis is in `log_prior`.
        own_courses: `own` at the times of data; without one a plan goes straight on at its end.
    """

    label: str
    log_prior: float
    plan: Trajectory | None
    cost: float
    starts: tuple[Start, ...]
    route: Array | None = None
    course: Course | Trajectory | None = None
    own: Mapping[str, Trajectory] = field(default_factory=dict)
    heard: Mapping[str, Heard] = field(default_factory=dict)
    own_courses: Mapping[str, Trajectory] = field(default_factory=dict)

    def plan_of(self, level: str) -> Trajectory | None:
        """The plan that is the mean of a level."""
        return self.own.get(level, self.plan)

    def along_of(self, level: str) -> Course:
        """The same at any time.

        Raises:
            ValueError: there is no plan.
        """
        own = self.own_courses.get(level, self.own.get(level))
        return self.along if own is None else Course(np.zeros(1), (own,))

    @property
    def along(self) -> Course:
        """The plan at any time.

        Raises:
            ValueError: there is no plan.
        """
        if isinstance(self.course, Course):
            return self.course
        known = self.course or self.plan
        if known is None:
            raise ValueError(f"hypothesis {self.label!r} has no plan that data could measure")
        return Course(np.zeros(1), (known,))
