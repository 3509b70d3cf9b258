"""Robots on wheels: differential drive and car, with states (x, y, θ, v, ω).

Speed and turn rate change linearly between two states, see `factors/unicycle.py`. Their limits
are boxes, and for the car a cone |ω| ≤ |v|/radius: convex sets, so what holds at two states holds
between them, unless the speed changes its sign; that a car may do only with straight wheels.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from factors.kinematics import CurvatureLimit, LinearLimit, RestBetweenDirections
from factors.residual import Residual
from factors.unicycle import InPlane, UnicycleMotion, advance, planar, slip, unicycle_prior
from fgplan.robots import FIXED, LIMIT_SHARE, PACES, Bound, Piece, Twist
from fgplan.trajectory import Trajectory

if TYPE_CHECKING:
    from fgplan.scenario import Density, Robot

Array = NDArray[np.float64]

SLIP = 1e-3
"""How far a wheeled robot may end beside where a step leads [m]."""
CREEP = 1e-3
"""Tolerance of the limits of a wheeled robot [m/s, rad/s, m/s², rad/s²]."""
DEFECT = 3e-3
"""Standard deviation of the position's defect a step [m]. Forces of the density of up to 110 nats/m
leave a defect below `SLIP` at an optimum; what is reported and driven has none."""
HEADING_DEFECT = 1e-4
"""Standard deviation of the heading's defect a step [rad]."""
TURNS = 9
"""Turn rates that are tried when a plan must not be driven."""
STANDING = 0.01
"""Share of `limit_sigma` that a car may still move with where it changes direction."""
STIFF = 0.1
"""Limits that leave no room at rest (reverse, curvature) have this share of `limit_sigma`; a car's
reverse speed the square of it."""


@dataclass(frozen=True)
class _Wheeled(ABC):
    """Moves along its heading only: (x, y, θ, v, ω), see `factors/unicycle.py`."""

    @property
    @abstractmethod
    def _reverse(self) -> float: ...

    @property
    @abstractmethod
    def _yaw(self) -> tuple[float, float, float]:
        """Largest yaw rate, largest yaw acceleration, and spectral density of the latter."""

    @property
    @abstractmethod
    def _radius(self) -> float:
        """Smallest turning radius; 0 turns on the spot."""

    @property
    def dim(self) -> int:
        return 5

    def state(self, robot: Robot, heading: float) -> Array:
        """Of the robot's velocity only the part along its heading counts."""
        v = robot.velocity[0] * np.cos(heading) + robot.velocity[1] * np.sin(heading)
        return np.concatenate([robot.position, [heading, v, robot.yaw_rate]])

    def of_any_speed(self, robot: Robot) -> Array:
        return np.diag([FIXED, FIXED, FIXED, robot.max_speed**2, FIXED])

    def prior(self, density: Density) -> Iterable[Piece]:
        accelerations = unicycle_prior(density.dt, density.Qc_robot, self._yaw[2], HEADING_DEFECT)
        yield Piece("robot prior", accelerations, (0, 1))
        yield Piece("robot motion", UnicycleMotion(density.dt, DEFECT), (0, 1))

    def limits(self, robot: Robot, density: Density) -> Iterable[Piece]:
        sigma, weight, dt = density.limit_sigma, density.exponent, density.dt
        both, v, w = np.zeros((4, 5)), np.zeros((1, 5)), np.zeros((2, 5))
        v[0, 3] = 1
        w[:, 4] = 1, -1
        both[:2, 3] = both[2:, 4] = 1, -1
        top, rate, acceleration = robot.max_speed, self._yaw[0], robot.max_acceleration
        speed = LinearLimit((v,), np.array([LIMIT_SHARE * top]), sigma, weight)
        yield Piece("speed limit", speed, (0,), 1)
        slowest = np.array([LIMIT_SHARE * self._reverse])
        # A car that rolls back by a hair would have its wheels turned there.
        stiff = STIFF**2 if self._radius > 0 else STIFF
        yield Piece("reverse limit", LinearLimit((-v,), slowest, stiff * sigma, weight), (0,), 1)
        if np.isfinite(rate):
            turn = LinearLimit((w,), np.full(2, LIMIT_SHARE * rate), sigma, weight)
            yield Piece("turn limit", turn, (0,), 1)
        if self._radius > 0:
            curvature = CurvatureLimit(self._radius / LIMIT_SHARE, STIFF * sigma, weight)
            yield Piece("curvature limit", curvature, (0,), 1)
        if self._radius > 0 and self._reverse > 0:
            rest = RestBetweenDirections(STANDING * robot.max_speed * sigma, weight)
            yield Piece("rest between directions", rest, (0, 1))
        limit = LIMIT_SHARE * np.repeat([acceleration, self._yaw[1]], 2)
        change = LinearLimit((-both / dt, both / dt), limit, sigma, weight)
        yield Piece("acceleration limit", change, (0, 1))

    def on_plane(self, residual: Residual) -> Residual:
        return InPlane(residual)

    def trajectory(self, times: Array, states: Array) -> Trajectory:
        """What the speeds and turn rates of these states drive, from the first of them: without
        the defects, which an optimum has left of a tenth of a millimetre a step."""
        driven = states.copy()
        for k, dt in enumerate(np.diff(times).tolist()):
            driven[k + 1] = advance(driven[k], states[k + 1, 3:] - driven[k, 3:], dt)
        return self.in_plane(times, driven)

    def in_plane(self, times: Array, states: Array) -> Trajectory:
        """States (S, 5) as they are, in the plane."""
        flat = planar(states)
        return Trajectory(times, flat[:, :2], flat[:, 2:], states[:, 2], states[:, 4])

    def states(self, trajectory: Trajectory) -> Array:
        """States (S, 5) of a trajectory with headings.

        Raises:
            ValueError: the trajectory has no headings.
        """
        theta, omega = trajectory.headings, trajectory.yaw_rates
        if theta is None or omega is None:
            raise ValueError("a robot with wheels needs a trajectory with headings and yaw rates")
        ahead = np.stack([np.cos(theta), np.sin(theta)], axis=1)
        v = np.einsum("ki,ki->k", trajectory.velocities, ahead)
        return np.column_stack([trajectory.positions, theta, v, omega])

    def lift(self, robot: Robot, now: Array, guess: Trajectory) -> Array:
        """Driven after the guess within the limits; a guess with headings is taken as it is."""
        times = guess.times
        if guess.headings is not None:
            states = self.states(guess)
            states[:, 2] += 2 * np.pi * np.round((now[2] - states[0, 2]) / (2 * np.pi))
            return states
        states = np.empty((len(times), 5))
        states[0] = now
        for k, dt in enumerate(np.diff(times).tolist()):
            wish = self._towards(robot, states[k], guess, k + 1, dt)
            states[k + 1] = self._step(robot, states[k], wish, dt)
        return states

    def _towards(self, robot: Robot, x: Array, guess: Trajectory, k: int, dt: float) -> Array:
        """Speed and yaw rate (2,) wished for, to be near the guess: first turn, then drive."""
        ahead = min(k + 1, len(guess.times) - 1)
        offset = guess.positions[ahead] - x[:2]
        distance = float(np.hypot(*offset))
        if distance < 0.1 * robot.radius:
            return np.zeros(2)
        turn = np.arctan2(offset[1], offset[0]) - x[2]
        turn = float(np.arctan2(np.sin(turn), np.cos(turn)))
        v = distance * max(0.0, np.cos(turn)) / (dt * (ahead - k + 1))
        w = turn / (2 * dt)
        if self._radius > 0:
            v = max(v, min(self._radius * abs(w), robot.preferred_speed))
        return np.array([v, w])

    def _step(self, robot: Robot, x: Array, wish: Array, dt: float) -> Array:
        """The state after dt when (v, ω) go to the wish as far as the limits allow."""
        low, high = self._speeds(robot, x, dt)
        v = np.clip(wish[..., 0], low, high)
        left, right = self._turns(x, v, dt)
        w = np.clip(wish[..., 1], left, right)
        return advance(x, np.stack([v - x[..., 3], w - x[..., 4]], axis=-1), dt)

    def _speeds(self, robot: Robot, x: Array, dt: float) -> tuple[Array, Array]:
        """Least and largest next speed, each (...). Who is too fast must not get faster; a car
        does not turn round in a step, and does not slow down faster than its wheels straighten."""
        v, change = x[..., 3], robot.max_acceleration * dt
        high = np.minimum(v + change, np.maximum(robot.max_speed, v))
        low = np.maximum(v - change, np.minimum(-self._reverse, v))
        if self._radius > 0:
            least = self._radius * np.maximum(np.abs(x[..., 4]) - self._yaw[1] * dt, 0.0)
            low = np.where(v > 0, np.maximum(low, np.minimum(least, v)), low)
            high = np.where(v < 0, np.minimum(high, np.maximum(-least, v)), high)
        return low, high

    def _turns(self, x: Array, v: Array, dt: float) -> tuple[Array, Array]:
        """Least and largest next yaw rate, given the next speed."""
        w, change = x[..., 4], self._yaw[1] * dt
        most = np.full_like(v, self._yaw[0])
        if self._radius > 0:
            most = np.minimum(most, np.abs(v) / self._radius)
        else:
            most = np.maximum(most, np.abs(w))
        # A car faster in its turn than allowed comes back as fast as it can.
        low, high = np.maximum(w - change, -most), np.minimum(w + change, most)
        return np.minimum(low, w + change), np.maximum(high, w - change)

    def problems(self, robot: Robot, trajectory: Trajectory) -> list[str]:
        x = self.states(trajectory)
        bounds = self._bounds(robot, trajectory.times, x)
        found = [problem for bound in bounds if (problem := bound.problem(3))]
        if len(x) > 1 and (worst := float(np.max(slip(x, np.diff(trajectory.times))))) > SLIP:
            found.append(f"slides sideways by {1000 * worst:.1f} mm in a step")
        return found

    def within(self, robot: Robot, times: Array, states: Array) -> NDArray[np.bool_]:
        """As they are driven they do not slide, whatever defect the states have."""
        kept = [bound.kept for bound in self._bounds(robot, times, states)]
        return np.asarray(np.logical_and.reduce(kept))

    def _bounds(self, robot: Robot, times: Array, states: Array) -> Iterator[Bound]:
        """Of states (..., S, 5). Who is beyond a limit now must not go further beyond it."""

        def least(value: Array) -> Array:
            return np.asarray(np.minimum.accumulate(value, axis=-1))

        def bound(what: str, value: Array, limit: Array | float, unit: str) -> Bound:
            return Bound(what, value, limit, unit, CREEP)

        v, w, dt = states[..., 3], states[..., 4], np.diff(times)
        yield bound("speed", v, np.maximum(robot.max_speed, least(v)), "m/s")
        yield bound("reverse speed", -v, np.maximum(self._reverse, least(-v)), "m/s")
        turn = np.abs(w)
        yield bound("yaw rate", turn, np.maximum(self._yaw[0], least(turn)), "rad/s")
        if self._radius > 0:
            tight = self._radius * turn
            # Who turns too tightly now may straighten.
            allowed = np.maximum(np.abs(v), least(tight - np.abs(v)) + np.abs(v))
            yield bound("speed needed for its turn", tight, allowed, "m/s")
            yield bound("turn while changing direction", self._cusps(v, w), 0.0, "m/s")
        a, alpha = np.abs(np.diff(v)) / dt, np.abs(np.diff(w)) / dt
        yield bound("acceleration", a, robot.max_acceleration, "m/s²")
        yield bound("yaw acceleration", alpha, self._yaw[1], "rad/s²")

    def _cusps(self, v: Array, w: Array) -> Array:
        """radius·|ω| at the moments between states when the speed changes its sign."""
        before, after = v[..., :-1], v[..., 1:]
        crossing = before * after < 0
        share = np.where(crossing, before / np.where(crossing, before - after, 1.0), 0.0)
        turn = w[..., :-1] + share * np.diff(w)
        return np.where(crossing, self._radius * np.abs(turn), 0.0)

    def coast(self, now: Array, times: Array) -> Trajectory:
        states, still = np.tile(now, (len(times), 1)), np.zeros(2)
        for k, dt in enumerate(np.diff(times).tolist()):
            states[k + 1] = advance(states[k], still, dt)
        return self.in_plane(times, states)

    def braking(self, robot: Robot, now: Array, times: Array, share: float) -> Trajectory:
        """Along its heading; a car keeps to the arc it is on, the other straightens as it can."""
        a, alpha = share * robot.max_acceleration, share * self._yaw[1]
        duration = np.array([abs(now[3]) / a, abs(now[4]) / alpha])
        if self._radius > 0:
            duration[:] = duration.max()
        states = np.empty((len(times), 5))
        states[0] = now
        for k, dt in enumerate(np.diff(times).tolist()):
            left = np.maximum(duration - (times[k + 1] - times[0]), 0.0)
            target = now[3:] * left / np.maximum(duration, 1e-12)
            states[k + 1] = advance(states[k], target - states[k, 3:], dt)
        return self.in_plane(times, states)

    def commands(self, robot: Robot, now: Array) -> Array:
        v = np.linspace(-self._reverse, robot.max_speed, PACES)
        most = self._yaw[0] if self._radius <= 0 else robot.max_speed / self._radius
        grid = np.stack(np.meshgrid(v, np.linspace(-most, most, TURNS), indexing="ij"), axis=-1)
        return np.concatenate([np.zeros((1, 2)), now[None, 3:], grid.reshape(-1, 2)])

    def commands_of(self, trajectory: Trajectory) -> Array:
        return self.states(trajectory)[:, 3:]

    def driven(
        self, robot: Robot, now: Array, wishes: Array, times: Array, lag: float = 0.5
    ) -> Array:
        """Speeds and turn rates change evenly over a step: there is no other lag than ½."""
        states = np.empty((len(wishes), len(times), 5))
        states[:, 0] = now
        for k, dt in enumerate(np.diff(times).tolist()):
            states[:, k + 1] = self._step(robot, states[:, k], wishes[:, k], dt)
        return states

    def sample(
        self, robot: Robot, density: Density, now: Array, count: int, rng: np.random.Generator
    ) -> Array:
        """v' ~ N(v, Qc dt) and ω' ~ N(ω, Qc_yaw dt), each within what the limits leave for it,
        step by step, and no defect."""
        from scipy.special import ndtr, ndtri

        dt = density.dt
        sigma = np.sqrt(dt * np.array([density.Qc_robot, self._yaw[2]]))

        def draw(mean: Array, low: Array, high: Array, spread: float) -> Array:
            # Above the mean by the mirror image: next to 1 a probability has no digits left.
            sign = np.where(low > mean, -1.0, 1.0)
            one, other = sign * (low - mean) / spread, sign * (high - mean) / spread
            a, b = ndtr(np.minimum(one, other)), ndtr(np.maximum(one, other))
            drawn = mean + sign * spread * ndtri(a + (b - a) * rng.random(len(mean)))
            return np.asarray(np.clip(drawn, low, high))

        states = np.empty((count, density.steps + 1, 5))
        states[:, 0] = now
        for k in range(density.steps):
            x = states[:, k]
            low, high = self._speeds(robot, x, dt)
            if self._radius > 0:  # through rest only from rest
                low, high = (
                    np.where(x[:, 3] > 0, np.maximum(low, 0), low),
                    np.where(x[:, 3] < 0, np.minimum(high, 0), high),
                )
            v = draw(x[:, 3], low, high, float(sigma[0]))
            w = draw(x[:, 4], *self._turns(x, v, dt), float(sigma[1]))
            states[:, k + 1] = advance(x, np.stack([v, w], axis=1) - x[:, 3:], dt)
        return states

    def twist(self, trajectory: Trajectory, step: int, heading: float) -> Twist:
        x = self.states(trajectory)[step]
        return Twist(float(x[3]), 0.0, float(x[4]))


@dataclass(frozen=True)
class DifferentialDrive(_Wheeled):
    """Two driven wheels: turns on the spot, drives along its heading.

    Args:
        max_reverse_speed: [m/s].
        max_yaw_rate: [rad/s].
        max_yaw_acceleration: [rad/s²].
        Qc_yaw: Power spectral density of the yaw acceleration [rad²/s³].
    """

    max_reverse_speed: float = 0.3
    max_yaw_rate: float = 1.5
    max_yaw_acceleration: float = 3.0
    Qc_yaw: float = 2.0

    @property
    def _reverse(self) -> float:
        return self.max_reverse_speed

    @property
    def _yaw(self) -> tuple[float, float, float]:
        return self.max_yaw_rate, self.max_yaw_acceleration, self.Qc_yaw

    @property
    def _radius(self) -> float:
        return 0.0


@dataclass(frozen=True)
class CarLike(_Wheeled):
    """Steered wheels: |ω| ≤ |v|/min_turning_radius, so it turns only as it drives.

    Args:
        min_turning_radius: [m].
        max_reverse_speed: [m/s]; it changes direction only with straight wheels.
        max_yaw_acceleration: How fast its turn may change [rad/s²].
        Qc_yaw: Power spectral density of that change [rad²/s³].
    """

    min_turning_radius: float = 1.0
    max_reverse_speed: float = 0.0
    max_yaw_acceleration: float = 3.0
    Qc_yaw: float = 2.0

    @property
    def _reverse(self) -> float:
        return self.max_reverse_speed

    @property
    def _yaw(self) -> tuple[float, float, float]:
        return np.inf, self.max_yaw_acceleration, self.Qc_yaw

    @property
    def _radius(self) -> float:
        return self.min_turning_radius
