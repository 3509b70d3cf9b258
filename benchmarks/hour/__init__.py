"""An hour of driving: 36,000 steps through a crowd that is never the same, back and forth.

Two corridors, people in both directions and across; who leaves comes in anew as somebody else. A
share of the observations can be spoilt. Every action is checked from where the robot is in truth:
velocity, twist and next position are finite, one motion, and within the robot's limits; and whether
the planner's own check calls it a contact is counted.
"""

from __future__ import annotations

import gc
from collections.abc import Callable
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.memory import resident
from fgplan.driving import Observation, Settings
from fgplan.inference import Progress
from fgplan.mixture import Action
from fgplan.scenario import Robot
from fgplan.simulation.driver import Fgplan
from fgplan.simulation.episode import Moment, run
from fgplan.simulation.file import FromFile
from fgplan.simulation.metrics import begins
from fgplan.simulation.world import World
from fgplan.trajectory import Trajectory

FILE = Path(__file__).parents[2] / "data" / "simulations" / "hour.toml"
ENDS = np.array([[18.5, 4.0], [1.5, 4.0]])
NEAR = 0.6
"""The robot turns round this near to an end [m]."""
WARM_UP = 0.1
"""Share of the steps before memory is compared."""
SLACK = 1e-6
"""Of a speed and a place [m/s, m]; limits have that of the robot's model."""


class Rounds:
    """Gives the robot a new goal whenever it has come to one.

    Args:
        tamper: What else happens to an observation; None is nothing.
    """

    def __init__(self, tamper: Callable[[Observation], Observation] | None) -> None:
        self.tamper, self.done = tamper, 0
        self.truth: Observation | None = None
        """The last observation, before anything happened to it."""

    def __call__(self, observation: Observation) -> Observation:
        self.truth = observation
        goal = ENDS[self.done % 2]
        if float(np.hypot(*(observation.position - goal))) < NEAR:
            self.done += 1
            observation = replace(observation, goal=ENDS[self.done % 2])
        return observation if self.tamper is None else self.tamper(observation)


@dataclass
class Watch:
    """Checks every step."""

    robot: Robot
    period: float
    steps: int
    rounds: Rounds
    progress: Progress | None = None
    broken: list[str] = field(default_factory=list)
    outcomes: dict[str, int] = field(default_factory=dict)
    memory: list[float] = field(default_factory=list)
    count: int = 0

    def __call__(self, moment: Moment) -> None:
        decision = moment.command.decision
        self.count += 1
        if self.count % max(1, self.steps // 100) == 0:
            gc.collect()
            self.memory.append(resident())
            if self.progress is not None:
                self.progress("steps", self.count, self.steps)
        truth = self.rounds.truth
        if decision is None or truth is None:
            self.broken.append(f"{self.count}: no decision")
            return
        name = str(decision.outcome)
        self.outcomes[name] = self.outcomes.get(name, 0) + 1
        found = problems(self.robot, truth, moment.observation, decision.action, self.period)
        self.broken += [f"{self.count}: {problem}" for problem in found]


def problems(
    robot: Robot, truth: Observation, told: Observation, action: Action, period: float
) -> list[str]:
    """What is wrong with an action, in words.

    Args:
        robot: Its model and limits.
        truth: The robot's state now.
        told: What the planner knows of it, which may be late: how far it can get since then.
        action: What it is to do.
        period: For so long [s].
    """
    if not np.all(np.isfinite([*action.velocity, *action.position, *astuple(action.twist)])):
        return [f"{action.velocity}, {action.position} or {action.twist} is not finite"]
    heading, rate, turned = truth.heading or 0.0, truth.yaw_rate, action.twist.angular_z
    driven = Trajectory(
        np.array([0.0, period]),
        np.array([truth.position, action.position]),
        np.array([truth.velocity, action.velocity]),
        np.array([heading, heading + 0.5 * period * (rate + turned)]),
        np.array([rate, turned]),
    )
    found = robot.model.problems(robot, driven)
    speed = float(np.hypot(*action.velocity))
    said = float(np.hypot(action.twist.linear_x, action.twist.linear_y))
    if abs(said - speed) > SLACK:
        found.append(f"twist of {said:.3f} m/s for a velocity of {speed:.3f} m/s")
    far = float(np.hypot(*(action.position - told.position)))
    fastest = max(robot.max_speed, float(np.hypot(*told.velocity)))
    reach = (truth.time - told.time + period) * fastest
    if far > reach + SLACK:
        found.append(f"next position {far:.4f} m away, {reach:.4f} m can be reached")
    return found


def drive(
    steps: int, faults: float = 0.0, seed: int = 0, deadline: float | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Drive, and say what was wrong.

    Args:
        steps: Of 0.1 s.
        faults: Share of the observations that are spoilt.
        seed: Of the world.
        deadline: Of a plan [s]; None lets it end.
        progress: Told how many steps are done.
    """
    world: World = FromFile(FILE, (("world.faults", str(faults)),))(seed)
    period, rounds = world.rules.period, Rounds(world.tamper)
    world = replace(
        world,
        tamper=rounds,
        # The run must not end at a goal.
        rules=replace(world.rules, time_limit=steps * period, tolerance=1e-6),
    )
    watch = Watch(world.scenario.robot, period, steps, rounds, progress)
    maker = Fgplan(settings=Settings(deadline=deadline))
    episode = run(world, maker(world), watch)
    kept = watch.memory[int(WARM_UP * len(watch.memory)) :] or [resident()]
    return {
        "steps": watch.count,
        "faults": faults,
        "end": str(episode.end),
        "error": episode.error,
        "rounds": rounds.done,
        "broken": watch.broken,
        "contacts": begins(episode.gaps < 0),
        "wall_contacts": begins(episode.blocked),
        "unsafe": episode.unsafe,
        "memory_growth_mb": kept[-1] - kept[0],
        "outcomes": watch.outcomes,
        **{
            f"step_ms_p{q}": float(np.percentile(1e3 * episode.seconds, q))
            for q in (50, 95, 99, 100)
        },
    }
