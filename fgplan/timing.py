"""From an untimed path to a trajectory: accelerate, cruise, brake along its arc length."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgplan.trajectory import Trajectory

Array = NDArray[np.float64]

NEGLIGIBLE = 1e-9
"""A length [m] that takes no time: braking within it would take an acceleration near infinity."""


@dataclass(frozen=True)
class SpeedLaw:
    """Arc length and speed over time: phases of constant acceleration, from t = 0 on.

    After the last phase the last speed is held.

    Args:
        initial_speed: At t = 0 [m/s].
        phases: (duration [s], acceleration [m/s²]) one after the other.
    """

    initial_speed: float
    phases: tuple[tuple[float, float], ...] = ()

    @property
    def duration(self) -> float:
        """Of all phases [s]."""
        return float(self._knots[0][-1])

    @property
    def length(self) -> float:
        """Arc length at the end of the last phase [m]."""
        return float(self._knots[1][-1])

    @property
    def final_speed(self) -> float:
        """Speed after the last phase [m/s]."""
        return float(self._knots[2][-1])

    def at(self, times: Any) -> tuple[Array, Array]:
        """Arc length [m] and speed [m/s] at the times (...) [s], each of shape (...)."""
        t = np.maximum(np.asarray(times, dtype=float), 0.0)
        start, length, speed, acceleration = self._knots
        k = np.searchsorted(start, t, side="right") - 1
        since = t - start[k]
        s = length[k] + since * (speed[k] + 0.5 * acceleration[k] * since)
        return s, speed[k] + acceleration[k] * since

    def then(self, other: SpeedLaw) -> SpeedLaw:
        """This law and, after its last phase, another one that starts at the speed reached."""
        return SpeedLaw(self.initial_speed, self.phases + other.phases)

    @cached_property
    def _knots(self) -> tuple[Array, Array, Array, Array]:
        """Time, arc length, speed and acceleration at the start of each phase and at the end."""
        rows = [(0.0, 0.0, self.initial_speed)]
        for duration, a in self.phases:
            t, s, v = rows[-1]
            rows.append((t + duration, s + duration * (v + 0.5 * a * duration), v + a * duration))
        t, s, v = np.array(rows).T
        return t, s, v, np.array([a for _, a in self.phases] + [0.0])


def speed_law(
    length: float,
    speed: float,
    acceleration: float,
    initial_speed: float = 0.0,
    end_speed: float = 0.0,
) -> SpeedLaw:
    """The quickest law over a length: to the speed, on with it, to the end speed at the end.

    With v_peak² = (2 a L + v_0² + v_1²)/2 the law is a trapezoid, or a triangle where v_peak is
    below the preferred speed. Where the length is too short to brake from the initial to the end
    speed, it brakes harder than `acceleration`, just as hard as it must; where it is too short to
    reach the end speed, it ends slower.

    Args:
        length: [m], not negative.
        speed: Preferred speed [m/s]; only the initial speed may exceed it.
        acceleration: Of speeding up and of braking [m/s²].
        initial_speed: [m/s], not negative.
        end_speed: [m/s], at most `speed`.

    Raises:
        ValueError: a number is not finite or out of its range.
    """
    _check(length, speed, acceleration, initial_speed, end_speed)
    L, a, v0, v1 = length, acceleration, initial_speed, end_speed
    if L < NEGLIGIBLE:
        return SpeedLaw(v1)
    if v0**2 - v1**2 >= 2 * a * L:
        return SpeedLaw(v0, ((2 * L / (v0 + v1), (v1**2 - v0**2) / (2 * L)),))
    if v1**2 - v0**2 >= 2 * a * L:
        return SpeedLaw(v0, (((np.sqrt(v0**2 + 2 * a * L) - v0) / a, a),))
    cruise = min(speed, float(np.sqrt(a * L + 0.5 * (v0**2 + v1**2))))
    first = np.copysign(a, cruise - v0)
    rest = L - (cruise**2 - v0**2) / (2 * first) - (cruise**2 - v1**2) / (2 * a)
    phases = (
        (abs(cruise - v0) / a, float(first)),
        (max(rest, 0.0) / cruise, 0.0),
        ((cruise - v1) / a, -a),
    )
    return SpeedLaw(v0, phases)


def waiting_law(
    length: float,
    speed: float,
    acceleration: float,
    initial_speed: float,
    delay: float,
    end_speed: float = 0.0,
    place: float = 0.0,
) -> SpeedLaw:
    """Come to a stop, stand until `delay`, then go as `speed_law` does.

    A delay of 0 still comes to a stop first; `speed_law` is the law without waiting.

    Args:
        delay: When to start again [s]; later where it takes longer to come to a stop.
        place: Where to stand [m]; further where braking takes longer, and at most at the end.

    Raises:
        ValueError: a number is not finite or out of its range.
    """
    _check(length, speed, acceleration, initial_speed, 0.0)
    if not (np.isfinite(delay) and delay >= 0):
        raise ValueError(f"delay must be finite and not negative, got {delay}")
    stop = min(max(place, initial_speed**2 / (2 * acceleration)), length)
    come = speed_law(stop, speed, acceleration, initial_speed)
    stand = SpeedLaw(0.0, ((max(delay - come.duration, 0.0), 0.0),))
    go = speed_law(length - stop, speed, acceleration, end_speed=end_speed)
    return come.then(stand).then(go)


def arc_length(path: Any) -> Array:
    """From the start of a polyline (N, 2) to each of its vertices, shape (N,) [m]."""
    steps = np.diff(np.asarray(path, dtype=float), axis=0)
    return np.append(0.0, np.cumsum(np.linalg.norm(steps, axis=1)))


def path_length(path: Any) -> float:
    """Of a polyline (N, 2) [m]."""
    steps = np.diff(np.asarray(path, dtype=float), axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())


def speed_along(path: Any, velocity: Any) -> float:
    """Part of a velocity (2,) that leads along the start of a path (N, 2), not negative [m/s]."""
    _, tangents, _ = _arc(path)
    return max(0.0, float(tangents[0] @ np.asarray(velocity, dtype=float)))


def timed(
    path: Any,
    times: Any,
    speed: float,
    acceleration: float,
    velocity: Any = (0.0, 0.0),
    end_speed: float = 0.0,
) -> Trajectory:
    """A path driven from now on, by `speed_law`.

    It starts with the part of the velocity that leads along the path: a path has no room for the
    rest of it.

    Args:
        path: Vertices, shape (N, 2), N ≥ 1 [m]; the first is where the robot is.
        times: Shape (S,) [s]; 0 is now.
        speed: Preferred speed [m/s].
        acceleration: [m/s²].
        velocity: Of the robot now, shape (2,) [m/s].
        end_speed: At the end of the path [m/s]; beyond it the trajectory runs straight on at that
            speed, or rests there when it is 0.

    Raises:
        ValueError: the path is no polyline, or a number is not finite or out of its range.
    """
    start = speed_along(path, velocity)
    law = speed_law(path_length(path), speed, acceleration, start, end_speed)
    return along(path, times, law)


def along(path: Any, times: Any, law: SpeedLaw) -> Trajectory:
    """A path (N, 2) driven by a law, with states at times (S,); velocities are tangent to it.

    Raises:
        ValueError: the path is no polyline of finite numbers.
    """
    vertices, tangents, reached = _arc(path)
    t = np.asarray(times, dtype=float)
    s, v = law.at(t)
    # Beyond the end the last segment goes on. A law ends at the path's end up to rounding.
    over = np.where(t > law.duration, law.final_speed * (t - law.duration), 0.0)
    s = np.minimum(s, reached[-1])
    k = np.clip(np.searchsorted(reached, s, side="right") - 1, 0, len(tangents) - 1)
    positions = vertices[k] + (s - reached[k] + over)[:, None] * tangents[k]
    return Trajectory(t, positions, v[:, None] * tangents[k])


def _arc(path: Any) -> tuple[Array, Array, Array]:
    """Vertices (N, 2) without repetitions, unit tangents (max(N − 1, 1), 2) of the segments, and
    arc length (N,) at the vertices. A single point has the tangent 0: there is nowhere to go."""
    p = np.asarray(path, dtype=float)
    if p.ndim != 2 or p.shape[1] != 2 or len(p) == 0:
        raise ValueError(f"path must have shape (N, 2) with N ≥ 1, got {p.shape}")
    if not np.all(np.isfinite(p)):
        raise ValueError("path holds a number that is not finite")
    keep = np.append(True, np.any(np.diff(p, axis=0) != 0, axis=1))
    p = p[keep]
    steps = np.diff(p, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    if len(p) == 1:
        return p, np.zeros((1, 2)), np.zeros(1)
    return p, steps / lengths[:, None], np.append(0.0, np.cumsum(lengths))


def _check(length: float, speed: float, acceleration: float, start: float, end: float) -> None:
    for name, value, good in (
        ("length", length, length >= 0),
        ("speed", speed, speed > 0),
        ("acceleration", acceleration, acceleration > 0),
        ("initial_speed", start, start >= 0),
        ("end_speed", end, 0 <= end <= speed),
    ):
        if not (np.isfinite(value) and good):
            raise ValueError(f"{name} is out of range: {value}")
