"""A robot that moves in any direction, whatever way it looks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from factors.gp_prior import isotropic_prior, transition
from factors.kinematics import AccelerationLimit, SpeedLimit
from factors.residual import Residual
from fgplan.robots import FIXED, LIMIT_SHARE, PACES, Bound, Piece, Twist
from fgplan.trajectory import Trajectory, length

if TYPE_CHECKING:
    from fgplan.scenario import Density, Robot

Array = NDArray[np.float64]

TOLERANCE = 1e-6
"""Of the limits [m/s, m/s²]."""
COURSES = 16
"""Directions that are tried, when its plan must not be driven."""
ROUNDING = 1e-12
"""Of a velocity [m/s]."""


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

    def of_any_speed(self, robot: Robot) -> Array:
        return np.diag([FIXED, FIXED, robot.max_speed**2, robot.max_speed**2])

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
        steps = np.diff(times)
        before = np.concatenate([states[:, :1, 2:], wishes[:, :-1]], axis=1)
        granted = _granted(robot, before, wishes, steps)
        for k, dt in enumerate(steps.tolist()):
            v = states[:, k, 2:]
            if granted[k] and np.abs(v - before[:, k]).max() < ROUNDING:
                mean = before[:, k:] + (1 - lag) * (wishes[:, k:] - before[:, k:])
                moved = np.cumsum(steps[k:, None] * mean, axis=1)
                states[:, k + 1 :, :2] = states[:, k, None, :2] + moved
                states[:, k + 1 :, 2:] = wishes[:, k:]
                break
            wish = shortened(wishes[:, k], np.maximum(robot.max_speed, length(v)))
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
                radius = np.sqrt(-2 * q * dt * np.log1p(-u * largest))
                angle = 2 * np.pi * angle
                tried = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
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


def _granted(robot: Robot, before: Array, wishes: Array, steps: Array) -> NDArray[np.bool_]:
    """From which step on everybody (M, S − 1, 2) gets what they wish for, shape (S − 1,), if they
    had what they wished for before it."""
    change, limit = length(wishes - before), np.maximum(robot.max_speed, length(before))
    fits = (change <= robot.max_acceleration * steps) & (length(wishes) <= limit)
    all_fit: NDArray[np.bool_] = np.all(fits, axis=0)
    return np.logical_and.accumulate(all_fit[::-1])[::-1]


def shortened(vectors: Array, longest: Array | float) -> Array:
    """Vectors (M, 2), none longer than a length, or than (M,)."""
    long = length(vectors)
    if (long <= longest).all():
        return vectors
    return np.asarray(vectors * (np.minimum(long, longest) / np.maximum(long, 1e-300))[:, None])
