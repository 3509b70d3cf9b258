"""Which of an operator's data can be believed; the rest is refused by name and not used."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgplan.measuring import Measurement, Reading
from fgplan.scenario import Scenario
from fgplan.shared_control.joystick import AHEAD, Joystick
from fgplan.validation import find_data_mistakes


@dataclass(frozen=True, eq=False)
class Admitted:
    """Operator data after a look at it.

    Args:
        data: What can be used.
        notes: What was refused or changed, and what will be met only as far as it can be.
    """

    data: tuple[Measurement, ...]
    notes: tuple[str, ...]


def admit(data: Iterable[Measurement], scenario: Scenario) -> Admitted:
    """Refuse what makes no sense and report what cannot be fulfilled.

    Refused: numbers that are not finite, shapes that do not fit, covariances that are not positive
    definite, levels that do not exist, sticks stamped in the future. Changed: a stick that asks for
    more than the robot's top speed asks for that. Reported and kept, since it is only as strong as
    its covariance: a place inside an obstacle or outside the map.
    """
    levels = [level.name for level in scenario.levels]
    kept: list[Measurement] = []
    notes: list[str] = []
    for number, measurement in enumerate(data):
        name = _name(measurement, number)
        wrong = list(find_data_mistakes(name, measurement, levels))
        if wrong:
            notes.append(f"{wrong[0]}: refused")
        elif isinstance(measurement, Joystick) and measurement.time > scenario.now + AHEAD:
            late = measurement.time - scenario.now
            notes.append(f"{name}: its stamp is {late:.2f} s in the future: refused")
        elif isinstance(measurement, Joystick):
            limited, note = _limited(measurement, scenario)
            kept.append(limited)
            notes += note
        else:
            kept.append(measurement)
            notes += _placed(name, measurement.readings, scenario)
    return Admitted(tuple(kept), tuple(notes))


def _name(measurement: object, number: int) -> str:
    known = getattr(measurement, "name", type(measurement).__name__.lower())
    return f"operator data {number} ({known})"


def _limited(stick: Joystick, scenario: Scenario) -> tuple[Joystick, list[str]]:
    speed, top = float(np.linalg.norm(stick.velocity)), scenario.robot.max_speed
    if speed <= top * (1 + 1e-9):
        return stick, []
    note = f"joystick asks for {speed:.2f} m/s; {top:.2f} m/s taken"
    return replace(stick, velocity=np.multiply(stick.velocity, top / speed)), [note]


def _placed(name: str, readings: Sequence[Reading], scenario: Scenario) -> list[str]:
    """Positions where the robot cannot be."""
    grid = scenario.grid
    notes = []
    for reading in readings:
        if grid is None or reading.quantity != "position":
            continue
        x, y = np.asarray(reading.value, dtype=float).tolist()
        if not grid.contains(np.array([x, y])):
            notes.append(f"{name}: ({x:.2f}, {y:.2f}) is outside the map: as near as can be")
        elif grid.clearance(np.array([[x, y]]), scenario.robot.radius)[0] < 0:
            where = (
                "inside an obstacle" if grid.is_occupied(np.array([x, y])) else "too near a wall"
            )
            notes.append(f"{name}: ({x:.2f}, {y:.2f}) is {where}: as near as can be")
    return notes
