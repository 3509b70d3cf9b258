"""What kind of robot it is: its state, its prior p(f^R | z^R), its limits, its action.

A model is a field of `fgplan.scenario.Robot`. `Holonomic` is here; those that move along their
heading only are in `fgplan.wheeled`. Whatever the model, the first two components of a state are
the position; `docs/robots.md` has the equations.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from factors.gp_prior import isotropic_prior, transition
from factors.kinematics import AccelerationLimit, SpeedLimit
from factors.residual import Residual
from fgplan.trajectory import Trajectory

if TYPE_CHECKING:
    from fgplan.scenario import Density, Robot

Array = NDArray[np.float64]

LIMIT_SHARE = 0.95
"""Share of a limit at which its hinge begins: an optimum leans on a hinge, the check does not."""
TOLERANCE = 1e-6
"""Of the limits of a holonomic robot [m/s, m/s²]."""

COURSES, PACES = 16, 4
"""Directions and speeds that a holonomic robot tries, when its plan must not be driven."""


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


@dataclass(frozen=True)
class Holonomic:
    """Moves in any direction: (x, y, vx, vy) with white noise on acceleration.

    Speed and acceleration are limited as vectors, by `max_speed` and `max_acceleration`.
    """

    @property
    def dim(self) -> int:
        return 4

    def state(self, robot: Robot, heading: float) -> Array:
        return robot.state

    def prior(self, density: Density) -> Iterable[Piece]:
        prior = isotropic_prior(density.dt, density.Qc_robot, 2)
        yield Piece("robot prior", prior, (0, 1))

    def limits(self, robot: Robot, density: Density) -> Iterable[Piece]:
        sigma, weight = density.limit_sigma, density.exponent
        speed = SpeedLimit(LIMIT_SHARE * robot.max_speed, sigma, weight=weight)
        yield Piece("speed limit", speed, (0,), 1)
        limit = LIMIT_SHARE * robot.max_acceleration
        acceleration = AccelerationLimit(limit, sigma, density.dt, weight=weight)
        yield Piece("acceleration limit", acceleration, (0, 1))

    def on_plane(self, residual: Residual) -> Residual:
        return residual

    def lift(self, robot: Robot, now: Array, guess: Trajectory) -> Array:
        return guess.states

    def trajectory(self, times: Array, states: Array) -> Trajectory:
        return Trajectory.from_states(times, states)

    def problems(self, robot: Robot, trajectory: Trajectory) -> list[str]:
        bounds = self._bounds(robot, trajectory.times, trajectory.states)
        return [problem for bound in bounds if (problem := bound.problem(2))]

    def within(self, robot: Robot, times: Array, states: Array) -> NDArray[np.bool_]:
        kept = [bound.kept for bound in self._bounds(robot, times, states)]
        return np.asarray(np.logical_and.reduce(kept))

    def _bounds(self, robot: Robot, times: Array, states: Array) -> Iterator[Bound]:
        """Of states (..., S, 4). Who is too fast now may slow down, and must not get faster."""
        v = states[..., 2:]
        speed = np.linalg.norm(v, axis=-1)
        limit = np.maximum(robot.max_speed, np.minimum.accumulate(speed, axis=-1))
        yield Bound("speed", speed, limit, "m/s", TOLERANCE)
        change = np.linalg.norm(np.diff(v, axis=-2), axis=-1) / np.diff(times)
        yield Bound("acceleration", change, robot.max_acceleration, "m/s²", TOLERANCE)

    def coast(self, now: Array, times: Array) -> Trajectory:
        along = np.outer(times - times[0], now[2:])
        return Trajectory(times, now[:2] + along, np.tile(now[2:], (len(times), 1)))

    def braking(self, robot: Robot, now: Array, times: Array, share: float) -> Trajectory:
        speed = float(np.linalg.norm(robot.velocity))
        direction = robot.velocity / speed if speed > 0 else np.zeros(2)
        rate = share * robot.max_acceleration
        moving = np.minimum(times, speed / rate)
        along = speed * moving - 0.5 * rate * moving**2
        velocity = np.maximum(speed - rate * times, 0.0)
        return Trajectory(
            times, robot.position + along[:, None] * direction, velocity[:, None] * direction
        )

    def commands(self, robot: Robot, now: Array) -> Array:
        angle = 2 * np.pi / COURSES * np.arange(COURSES)
        course = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        speed = robot.max_speed * np.arange(1, PACES + 1) / PACES
        moving = (speed[:, None, None] * course).reshape(-1, 2)
        return np.concatenate([np.zeros((1, 2)), now[None, 2:], moving])

    def commands_of(self, trajectory: Trajectory) -> Array:
        return trajectory.velocities

    def driven(
        self, robot: Robot, now: Array, wishes: Array, times: Array, lag: float = 0.5
    ) -> Array:
        states = np.empty((len(wishes), len(times), 4))
        states[:, 0] = now
        for k, dt in enumerate(np.diff(times).tolist()):
            v = states[:, k, 2:]
            wish = shortened(wishes[:, k], np.maximum(robot.max_speed, _length(v)))
            change = shortened(wish - v, robot.max_acceleration * dt)
            states[:, k + 1, :2] = states[:, k, :2] + dt * (v + (1 - lag) * change)
            states[:, k + 1, 2:] = v + change
        return states

    def sample(
        self, robot: Robot, density: Density, now: Array, count: int, rng: np.random.Generator
    ) -> Array:
        r"""x' ~ N(Φ x, Q), given that ‖v' − v‖ ≤ a dt and ‖v'‖ ≤ max(max_speed, ‖v‖), step by step.

        The change of speed is drawn from its law within the limit of acceleration, again and
        again where the speed is too high; what is left after many draws keeps its velocity.
        """
        dt, q = density.dt, density.Qc_robot
        states = np.empty((count, density.steps + 1, 4))
        states[:, 0] = now
        largest = 1 - np.exp(-((robot.max_acceleration * dt) ** 2) / (2 * q * dt))
        spread = np.sqrt(q * dt**3 / 12)  # of the position, given both velocities
        for k in range(density.steps):
            v = states[:, k, 2:]
            limit = np.maximum(robot.max_speed, np.linalg.norm(v, axis=1))
            change, waiting = np.zeros_like(v), np.arange(count)
            for _ in range(64):
                u, angle = rng.random((2, len(waiting)))
                length = np.sqrt(-2 * q * dt * np.log1p(-u * largest))
                angle = 2 * np.pi * angle
                tried = length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
                fine = np.linalg.norm(v[waiting] + tried, axis=1) <= limit[waiting]
                change[waiting[fine]] = tried[fine]
                waiting = waiting[~fine]
                if not len(waiting):
                    break
            mean = states[:, k] @ transition(dt, 2).T
            mean[:, :2] += 0.5 * dt * change + spread * rng.standard_normal((count, 2))
            mean[:, 2:] += change
            states[:, k + 1] = mean
        return states

    def twist(self, trajectory: Trajectory, step: int, heading: float) -> Twist:
        vx, vy = trajectory.velocities[step].tolist()
        c, s = float(np.cos(heading)), float(np.sin(heading))
        return Twist(c * vx + s * vy, c * vy - s * vx, 0.0)


def shortened(vectors: Array, longest: Array | float) -> Array:
    """Vectors (M, 2), none longer than a length, or than (M,)."""
    length = _length(vectors)
    if (length <= longest).all():
        return vectors
    return np.asarray(vectors * (np.minimum(length, longest) / np.maximum(length, 1e-300))[:, None])


def _length(vectors: Array) -> Array:
    """Of vectors (M, 2), shape (M,)."""
    return np.asarray(np.sqrt(np.einsum("mi,mi->m", vectors, vectors)))
