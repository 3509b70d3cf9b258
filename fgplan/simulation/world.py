"""A world to drive in: people, the robot's body, what is seen, and when a run ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fgplan.driving import Detection, Observation
from fgplan.measuring import Measurement
from fgplan.occupancy import OccupancyGrid
from fgplan.regions import Region
from fgplan.scenario import Scenario
from fgplan.simulation.body import Body, Limits
from fgplan.simulation.gaps import Gap, moved
from fgplan.simulation.people import People

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rules:
    """How a run goes, and when it ends.

    Args:
        period: Between two commands [s].
        substeps: Of the motion, in a period.
        time_limit: [s].
        tolerance: The goal is reached when the robot is nearer than this [m].
        contact_ends: Whether a contact with a person ends the run.
        discomfort: A person whose edge is nearer than this feels uneasy [m].
        clearance: From people, that a robot is to keep where it can [m]; None leaves it to the
            planner (`fgplan.driving.Guard.margin`).
        seen_by_people: Whether people see the robot.
        slows_down: Whether ORCA's wish shrinks within a second of the goal, as CrowdNav's does.
        gap: What counts as the distance of robot and people during a substep.
    """

    period: float = 0.1
    substeps: int = 2
    time_limit: float = 60.0
    tolerance: float = 0.3
    contact_ends: bool = False
    discomfort: float = 0.2
    clearance: float | None = None
    seen_by_people: bool = True
    slows_down: bool = True
    gap: Gap = moved


@dataclass(frozen=True, eq=False)
class Seen:
    """What the robot's sensors say at one moment; fields as in `Observation`."""

    detections: tuple[Detection, ...] | None = ()
    grid: OccupancyGrid | None = None


class Sensor(Protocol):
    """What the robot sees of a world."""

    def __call__(self, time: float, body: Body, people: People) -> Seen:
        """What is seen at a time [s]; called once a period."""
        ...


class Operator(Protocol):
    """Somebody who tells the robot where to go while it drives."""

    def __call__(self, time: float, body: Body, people: People) -> tuple[Measurement, ...]:
        """What is said at a time since the start of the run [s]; called once a period. Its stamps
        are on the clock of `Scenario.now`."""
        ...


@dataclass(frozen=True, eq=False)
class Event:
    """Something that happens at a time of a run.

    Args:
        time: [s].
        goal: The goal from then on, shape (2,) [m]; None keeps it.
        facts: What a mission's facts are from then on.
    """

    time: float
    goal: Array | None = None
    facts: dict[str, bool] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class World:
    """One run's world, made anew for each run: people, body and sensor change while it goes on.

    Args:
        name: Of the world, with its seed.
        scenario: What a policy knows before the first step.
        people: Who is about.
        sensor: What the robot sees.
        limits: Of the robot's base.
        rules: Of the run.
        grid: The true map, which stops the robot; the scenario's may say less.
        events: By time.
        via: Regions to be visited, each at least once, before the goal counts.
        tamper: What happens to an observation before a policy sees it; faults are put in here.
        operator: Who holds a stick; None is nobody.
        reference: Length of the shortest way from the start to the goal [m]; None is the straight
            line.
    """

    name: str
    scenario: Scenario
    people: People
    sensor: Sensor
    limits: Limits
    rules: Rules = Rules()
    grid: OccupancyGrid | None = None
    events: tuple[Event, ...] = ()
    via: tuple[Region, ...] = ()
    tamper: Callable[[Observation], Observation] | None = None
    operator: Operator | None = None
    reference: float | None = None


Setup = Callable[[int], World]
"""Makes the world of a seed."""


@dataclass(frozen=True)
class Plain:
    """Sees everybody exactly, with names and velocities: the rule of CrowdNav.

    Args:
        velocities: Whether it says how people move.
    """

    velocities: bool = True

    def __call__(self, time: float, body: Body, people: People) -> Seen:
        return Seen(
            tuple(
                Detection(
                    people.positions[i].copy(),
                    people.names[i],
                    float(people.radii[i]),
                    people.velocities[i].copy() if self.velocities else None,
                )
                for i in np.flatnonzero(people.present).tolist()
            )
        )
