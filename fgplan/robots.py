"""What kind of robot it is: its state, its prior p(f^R | z^R), its limits, its action.

A model is a field of `fgplan.scenario.Robot`: that of `fgplan.holonomic`, or one of
`fgplan.wheeled`, which move along their heading only. Whatever the model, the first two components
of a state are the position; `docs/robots.md` has the equations.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from factors.residual import Residual
from fgplan.trajectory import Trajectory

if TYPE_CHECKING:
    from fgplan.scenario import Density, Robot

Array = NDArray[np.float64]

LIMIT_SHARE = 0.95
"""Share of a limit at which its hinge begins: an optimum leans on a hinge, the check does not."""
FIXED = 1e-6
"""Variance of what is known of a state [m², ...]."""
PACES = 4
"""Speeds that are tried, when a plan must not be driven."""


class Piece(NamedTuple):
    """A residual on one trajectory's states at (k + offset for each offset), for all k from
    `first` on, or to `last` where it is given."""

    name: str
    residual: Residual
    offsets: tuple[int, ...]
    first: int = 0
    last: int | None = None

    def steps(self, T: int) -> range:
        """All k, where the trajectory has T + 1 states."""
        end = T - max(self.offsets)
        return range(self.first, 1 + (end if self.last is None else min(end, self.last)))


class Bound(NamedTuple):
    """What must not exceed its limit at any step: `value` (..., n), `limit` of that shape or one
    that broadcasts, both in `unit`."""

    what: str
    value: Array
    limit: Array | float
    unit: str
    tolerance: float

    @property
    def kept(self) -> NDArray[np.bool_]:
        """Which trajectories keep it, shape (...)."""
        return np.asarray(np.all(self.value <= self.limit + self.tolerance, axis=-1))

    def problem(self, digits: int) -> str:
        """What one trajectory, n values, does wrong in words; empty where it keeps the limit."""
        limit = np.broadcast_to(self.limit, self.value.shape)
        excess = np.where(np.isfinite(limit), self.value - limit, -np.inf)
        if not excess.size or excess.max() <= self.tolerance:
            return ""
        worst = int(np.argmax(excess))
        reached, allowed = (f"{v[worst]:.{digits}f} {self.unit}" for v in (self.value, limit))
        return f"{self.what} {reached} above {allowed}"


@dataclass(frozen=True)
class Twist:
    """A velocity command in the base frame (REP-103: x forward, y left, yaw counter-clockwise).

    Args:
        linear_x: Forward [m/s].
        linear_y: To the left [m/s]; 0 for a robot with wheels.
        angular_z: [rad/s].
    """

    linear_x: float
    linear_y: float
    angular_z: float

    def to_dict(self) -> dict[str, dict[str, float]]:
        """As in geometry_msgs/Twist, without the components that a plane does not have."""
        return {
            "linear": {"x": self.linear_x, "y": self.linear_y},
            "angular": {"z": self.angular_z},
        }


@runtime_checkable
class RobotModel(Protocol):
    """What planning asks of a kind of robot; `robot` holds its sizes and limits."""

    @property
    def dim(self) -> int:
        """Size of a state; its first two components are the position."""
        ...

    def state(self, robot: Robot, heading: float) -> Array:
        """The state now, shape (dim,), of a robot that looks to `heading` [rad]."""
        ...

    def of_any_speed(self, robot: Robot) -> Array:
        """Covariance (dim, dim) of a state of which all is known but the speed, which may be any
        that the robot can have."""
        ...

    def prior(self, density: Density) -> Iterable[Piece]:
        """p(f^R | state now) as factors between consecutive states."""
        ...

    def limits(self, robot: Robot, density: Density) -> Iterable[Piece]:
        """What the robot can do, as one-sided penalties."""
        ...

    def on_plane(self, residual: Residual) -> Residual:
        """A residual on states (x, y, vx, vy), applied to states of this model."""
        ...

    def lift(self, robot: Robot, now: Array, guess: Trajectory) -> Array:
        """States (S, dim) from `now` on that come near a guess; the optimiser starts from them."""
        ...

    def trajectory(self, times: Array, states: Array) -> Trajectory:
        """States (S, dim) in the plane."""
        ...

    def problems(self, robot: Robot, trajectory: Trajectory) -> list[str]:
        """Which limits a trajectory of this model breaks, in words."""
        ...

    def within(self, robot: Robot, times: Array, states: Array) -> NDArray[np.bool_]:
        """Which of many trajectories (..., S, dim), as they are driven, break no limit: those
        without `problems`. Shape (...)."""
        ...

    def coast(self, now: Array, times: Array) -> Trajectory:
        """The mean of the prior: no acceleration."""
        ...

    def braking(self, robot: Robot, now: Array, times: Array, share: float) -> Trajectory:
        """A stop at a share of the largest deceleration."""
        ...

    def commands(self, robot: Robot, now: Array) -> Array:
        """Commands worth trying, shape (M, 2): velocities of a holonomic robot [m/s], (v, ω) of
        one with wheels."""
        ...

    def commands_of(self, trajectory: Trajectory) -> Array:
        """The command at each state of a trajectory, shape (S, 2)."""
        ...

    def driven(
        self, robot: Robot, now: Array, wishes: Array, times: Array, lag: float = 0.5
    ) -> Array:
        """What the robot does when it wishes for commands and its limits of acceleration allow
        what they allow.

        Args:
            robot: Its limits.
            now: State (dim,), or one for each of M robots (M, dim).
            wishes: From each time to the next one, shape (M, S − 1, 2).
            times: Shape (S,) [s].
            lag: Share of a change of velocity that the position lags behind: ½ when it is
                reached evenly over the step, 0 when at once.

        Returns:
            States, shape (M, S, dim).
        """
        ...

    def sample(
        self, robot: Robot, density: Density, now: Array, count: int, rng: np.random.Generator
    ) -> Array:
        """Draws from the prior within the limits, shape (count, T + 1, dim); `now` is one state
        (dim,) or one for each draw (count, dim)."""
        ...

    def twist(self, trajectory: Trajectory, step: int, heading: float) -> Twist:
        """The command that leads to a step of a trajectory, from a robot looking to `heading`."""
        ...
