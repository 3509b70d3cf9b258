"""What of an observation can be believed: refused, repaired, or taken as it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from factors.residual import whitener
from fgplan.driving.observation import Detection, Observation
from fgplan.occupancy import OccupancyGrid
from fgplan.scenario import Robot


@dataclass(frozen=True, eq=False)
class Refused:
    """An observation that was not believed.

    Args:
        kind: What is wrong: the robot's "state", which cannot be used, or that it jumped or that
            the clock did not go on; those may be a new place ("jump") or a new "clock".
        text: The same in words.
        observation: What came.
        agreed: How many in a row, this one the last, were refused for a clock that went on from
            one to the next.
    """

    kind: Literal["state", "jump", "clock"]
    text: str
    observation: Observation
    agreed: int = 0

    @property
    def time(self) -> float:
        """Of the observation [s]; NaN where it says none."""
        time = self.observation.time
        return float(time) if _is_finite(time, ()) else np.nan


@dataclass(frozen=True)
class Intake:
    """Limits of what is plausible.

    Args:
        jump: A robot may be this far from where it can have driven [m]: more is a fault of the
            localisation, or, when it stays there, a new place.
        slack: How much faster than its limit a robot may seem to be, as a factor.
        clock: After so many observations in a row that are older than the last one that was used,
            and go on from one to the next, the clock was set anew; fewer are late ones.
    """

    jump: float = 0.5
    slack: float = 1.5
    clock: int = 3

    def refused(
        self, new: Observation, last: Observation | None, before: Refused | None, robot: Robot
    ) -> Refused | None:
        """Why an observation cannot be used at all; None where it can.

        Args:
            new: What came now.
            last: The last one that was used.
            before: The one before, if it was refused.
            robot: Its limits and its model.
        """
        if (text := _impossible(new, robot.model.dim)) is not None:
            return Refused("state", text, new)
        if last is None:
            return None
        if new.time <= last.time:
            repeated = "repeated" if new.time == last.time else "older than the last one"
            text = f"the observation of {new.time:.3f} s is {repeated} ({last.time:.3f} s)"
            goes_on = before is not None and new.time > before.time
            return Refused("clock", text, new, 1 + (before.agreed if before and goes_on else 0))
        known = [last] if before is None or before.kind != "jump" else [last, before.observation]
        if any(self._in_reach(new, old, robot.max_speed) for old in known):
            return None
        moved = float(np.hypot(*np.subtract(new.position, last.position)))
        text = f"the robot jumped by {moved:.2f} m in {new.time - last.time:.2f} s"
        return Refused("jump", text, new)

    def _in_reach(self, new: Observation, old: Observation, max_speed: float) -> bool:
        """Whether the robot can have driven from the old place to the new one."""
        moved = float(np.hypot(*np.subtract(new.position, old.position)))
        return moved <= self.slack * max_speed * (new.time - old.time) + self.jump

    def is_new_clock(self, refused: Refused) -> bool:
        """Whether what was refused shows that the clock was set anew."""
        return refused.kind == "clock" and refused.agreed >= self.clock

    def repaired(self, new: Observation, max_speed: float) -> tuple[Observation, tuple[str, ...]]:
        """The observation without what is impossible in it, and what that was."""
        notes = []
        speed = float(np.hypot(*new.velocity))
        if speed > self.slack * max_speed:
            notes.append(f"speed {speed:.2f} m/s is impossible; {max_speed:.2f} m/s taken")
            new = replace(new, velocity=np.multiply(new.velocity, max_speed / speed))
        if new.detections is not None:
            good = tuple(d for d in new.detections if _possible(d))
            if len(good) < len(new.detections):
                notes.append(f"{len(new.detections) - len(good)} impossible detection(s) left out")
                new = replace(new, detections=good)
        new, wrong = self.said(new)
        return new, (*notes, *wrong)

    def said(self, new: Observation) -> tuple[Observation, tuple[str, ...]]:
        """The observation without what is impossible in its goal, map, facts and operator data,
        whatever its state, and what that was."""
        notes = []
        if new.goal is not None and not _is_finite(new.goal, (2,)):
            notes.append(f"goal {new.goal!r} is not two finite numbers; the old one is kept")
            new = replace(new, goal=None)
        if new.grid is not None and not isinstance(new.grid, OccupancyGrid):
            notes.append(f"map {new.grid!r} is no OccupancyGrid; the old one is kept")
            new = replace(new, grid=None)
        if not isinstance(new.facts, Mapping) or not all(isinstance(n, str) for n in new.facts):
            notes.append(f"facts {new.facts!r} are no mapping of names; left out")
            new = replace(new, facts={})
        if not isinstance(new.operator, Sequence):
            notes.append(f"operator data {new.operator!r} is no sequence of measurements; left out")
            new = replace(new, operator=())
        return new, tuple(notes)


def _impossible(new: Observation, size: int) -> str | None:
    """What is wrong with the robot's state, in words; None where nothing is.

    Args:
        new: What came.
        size: Of the state of the robot's model.
    """
    if _shape(new.position) != (2,) or _shape(new.velocity) != (2,):
        return f"position {new.position!r} and velocity {new.velocity!r} need two numbers each"
    numbers = {"time": new.time, "yaw rate": new.yaw_rate}
    if new.heading is not None:
        numbers["heading"] = new.heading
    for name, value in numbers.items():
        if _shape(value) != ():
            return f"{name} {value!r} must be a number"
    state = np.array([*new.position, *new.velocity, *numbers.values()], dtype=float)
    if not np.all(np.isfinite(state)):
        return f"the robot's state is not finite: {np.round(state, 3).tolist()}"
    if new.covariance is None:
        return None
    what, shape = "the robot's covariance", _shape(new.covariance)
    if shape != (size, size):
        return f"{what} has shape {shape}, its model needs {(size, size)}"
    try:
        whitener(new.covariance, what)
    except ValueError as error:
        return str(error)
    return None


def _possible(d: Detection) -> bool:
    known = _is_finite(d.position, (2,)) and _is_finite(d.radius, ()) and d.radius >= 0
    return known and (d.velocity is None or _is_finite(d.velocity, (2,)))


def _is_finite(value: Any, shape: tuple[int, ...]) -> bool:
    return _shape(value) == shape and bool(np.all(np.isfinite(np.asarray(value, dtype=float))))


def _shape(value: Any) -> tuple[int, ...] | None:
    """Of something that may be numbers; None where it is none."""
    try:
        return np.asarray(value, dtype=float).shape
    except (TypeError, ValueError):
        return None
