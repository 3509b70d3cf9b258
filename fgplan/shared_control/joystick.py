"""A joystick: messages in the layout of sensor_msgs/Joy, and the velocities they measure.

A stick that is held says which velocity the operator wants for the next moment. One that is
released, or centred, says nothing: it is no wish to stop, and neither is the single zero Twist
that a teleoperation node sends on release.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgplan.errors import FgplanError
from fgplan.measuring import Reading
from fgplan.robots import Piece

Array = NDArray[np.float64]

SHARES = (1 / 3, 2 / 3, 1.0)
"""Where in the window of a stick its velocity is read."""


@dataclass(frozen=True, eq=False)
class Joystick:
    """A velocity wished for over a window: z = η'(t) + noise for t in [time, time + window].

    Args:
        time: When the stick was read, on the clock of `Scenario.now` [s].
        velocity: Shape (2,) [m/s], map frame.
        covariance: Of the velocity, shape (2, 2) [m²/s²]; that of the whole window, which is read
            at a few moments that share the information.
        window: How far ahead the wish reaches [s].
        on: Level that is measured; None for the first one.
    """

    time: float
    velocity: Array
    covariance: Array
    window: float = 1.0
    on: str | None = None

    @property
    def readings(self) -> tuple[Reading, ...]:
        """The velocity at moments of the window, which together weigh as much as one.

        Raises:
            ValueError: the time or the window is no number.
        """
        for name, value in (("time", self.time), ("window", self.window)):
            if not isinstance(value, Real):
                raise ValueError(f"{name} is {value!r}; give a time in seconds")
        if not self.window > 0:
            return (Reading(self.time, self.velocity, self.covariance, "velocity"),)
        shared = len(SHARES) * np.asarray(self.covariance, dtype=float)
        return tuple(
            Reading(self.time + share * self.window, self.velocity, shared, "velocity", self.time)
            for share in SHARES
        )

    def pieces(self, now: float, times: Array) -> Iterable[Piece]:
        """None."""
        return ()


@dataclass(frozen=True)
class JoySample:
    """One message: header.stamp [s], axes in [−1, 1], buttons 0 or 1 (sensor_msgs/Joy)."""

    stamp: float
    axes: tuple[float, ...]
    buttons: tuple[int, ...]


@dataclass(frozen=True)
class Stick:
    """How a stick is read; the defaults are those of teleop_twist_joy for a common gamepad.

    Args:
        forward: Axis of the forward speed, positive ahead.
        left: Axis of the speed to the left; None where there is none.
        turn: Axis of the yaw rate, positive to the left; None where there is none.
        deadman: Button that must be held for the stick to mean anything; None needs none.
        speed: At full deflection [m/s].
        yaw_rate: At full deflection [rad/s].
        dead_zone: Deflections below it are no intention.
        frame: "robot": ahead is where the robot looks; "map": ahead is x of the map.
        timeout: A message counts for this long, where no other follows: a driver without
            autorepeat is silent while the stick is held still [s].
        sigma: Standard deviation of the wished velocity [m/s].
        persistence: For how long a hand wishes the same: messages of one such time are one
            independent datum, however many they are [s].
        window: How far ahead a wish reaches [s].
        on: Level that is measured.
    """

    forward: int = 1
    left: int | None = 0
    turn: int | None = None
    deadman: int | None = 4
    speed: float = 1.0
    yaw_rate: float = 1.0
    dead_zone: float = 0.05
    frame: str = "robot"
    timeout: float = 0.5
    sigma: float = 0.2
    persistence: float = 0.5
    window: float = 1.0
    on: str | None = None

    def problem(self, sample: JoySample, now: float = np.inf) -> str | None:
        """Why a message cannot be believed, None where it can.

        Args:
            sample: The message.
            now: [s]; a message is refused that comes from later.
        """
        if not np.isfinite(sample.stamp):
            return f"joystick stamp is {sample.stamp}"
        if sample.stamp > now + AHEAD:
            return (
                f"joystick stamp {sample.stamp:.3f} s is {sample.stamp - now:.3f} s in the future"
            )
        for axis in (self.forward, self.left, self.turn):
            if axis is None:
                continue
            if axis >= len(sample.axes):
                return f"joystick has {len(sample.axes)} axes, axis {axis} is to be read"
            if not abs(sample.axes[axis]) <= 1 + 1e-3:
                return f"joystick axis {axis} is {sample.axes[axis]}, beyond ±1"
        if self.deadman is not None and self.deadman >= len(sample.buttons):
            return f"joystick has {len(sample.buttons)} buttons, the dead man's is {self.deadman}"
        return None

    def held(self, sample: JoySample) -> bool:
        """Whether a message says anything."""
        if self.deadman is not None and not sample.buttons[self.deadman]:
            return False
        return bool(np.max(np.abs(self._deflection(sample))) > self.dead_zone)

    def velocity(self, sample: JoySample, heading: float) -> Array:
        """Wished velocity in the map frame, shape (2,) [m/s]; a turn is the mean direction of its
        window."""
        x, y, turn = self._deflection(sample)
        ahead = heading if self.frame == "robot" else 0.0
        ahead += 0.5 * self.window * self.yaw_rate * turn
        c, s = np.cos(ahead), np.sin(ahead)
        return self.speed * np.array([c * x - s * y, s * x + c * y])

    def measurements(
        self, samples: Iterable[JoySample], heading: float = 0.0, until: float | None = None
    ) -> tuple[tuple[Joystick, ...], tuple[str, ...]]:
        """What messages measure, and which were refused and why; in any order of arrival.

        Each holds from its stamp to the next one's, at most for the timeout.

        Args:
            samples: Messages.
            heading: Of the robot meanwhile [rad].
            until: Now [s]; None counts the last message for its timeout.
        """
        good, refused = [], []
        for sample in samples:
            why = self.problem(sample, np.inf if until is None else until)
            if why is None:
                good.append(sample)
            else:
                refused.append(why)
        good.sort(key=lambda sample: sample.stamp)
        found = []
        for i, sample in enumerate(good):
            later = [] if i + 1 == len(good) else [good[i + 1].stamp]
            if until is not None:
                later.append(max(until, sample.stamp))
            duration = min([self.timeout, *(t - sample.stamp for t in later)])
            if self.held(sample) and duration > 0:
                found.append(self._wish(sample, heading, duration))
        return tuple(found), tuple(refused)

    def wish(self, sample: JoySample, heading: float, period: float) -> tuple[Joystick, ...]:
        """What one message says that counts for a period of a control loop [s]."""
        return (self._wish(sample, heading, period),) if self.held(sample) else ()

    def _wish(self, sample: JoySample, heading: float, duration: float) -> Joystick:
        variance = self.sigma**2 * max(self.persistence / duration, 1.0)
        velocity = self.velocity(sample, heading)
        return Joystick(sample.stamp, velocity, variance * np.eye(2), self.window, self.on)

    def _deflection(self, sample: JoySample) -> Array:
        """Forward, left and turn, shape (3,)."""
        axes = (self.forward, self.left, self.turn)
        return np.array([0.0 if axis is None else sample.axes[axis] for axis in axes])


AHEAD = 0.1
"""Clocks of a stick and a robot may differ by this much [s]."""


def read_joy(path: str | Path) -> tuple[JoySample, ...]:
    """A log of Joy messages, one JSON object a line:
    {"header": {"stamp": {"sec": 12, "nanosec": 500000000}}, "axes": [...], "buttons": [...]}.

    Raises:
        FgplanError: the file cannot be read, or a line is no such message.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise FgplanError(f"{path}: cannot be read: {error}") from None
    samples = []
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            message = json.loads(line)
            stamp = message["header"]["stamp"]
            seconds = float(stamp["sec"]) + 1e-9 * float(stamp["nanosec"])
            axes = tuple(float(axis) for axis in message["axes"])
            buttons = tuple(int(button) for button in message["buttons"])
        except (ValueError, TypeError, KeyError, OverflowError) as error:
            raise FgplanError(f"{path}, line {number}: is no Joy message: {error!r}") from None
        samples.append(JoySample(seconds, axes, buttons))
    return tuple(samples)


def write_joy(path: str | Path, samples: Sequence[JoySample]) -> None:
    """The same log, written."""
    lines = []
    for sample in samples:
        nanoseconds = round(sample.stamp * 1e9)
        stamp = {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}
        message = {
            "header": {"stamp": stamp, "frame_id": ""},
            "axes": list(sample.axes),
            "buttons": list(sample.buttons),
        }
        lines.append(json.dumps(message))
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")
