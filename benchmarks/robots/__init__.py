"""Robots with wheels: how many iterations a start takes, and how far an optimum slides.

One start (the plan) of one hypothesis, among three people held at their prediction, from
a robot that drives along its plan ("along") or stands and looks away from it ("reversed": between
90° and 270°).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.scenes import World
from factors.unicycle import slip
from fgplan import CarLike, Density, DifferentialDrive, Holonomic, Robot, Scenario, SecondOrder
from fgplan.assembly import Assembly
from fgplan.crowd import believe, seen
from fgplan.hypotheses import hypothesise
from fgplan.model import build
from fgplan.robots import RobotModel

Array = NDArray[np.float64]
Bar = Callable[[Iterable[int]], Iterable[int]]

MODELS: dict[str, RobotModel] = {
    "holonomic": Holonomic(),
    "differential": DifferentialDrive(),
    "car": CarLike(),
    "car that reverses": CarLike(max_reverse_speed=0.4),
}
PEOPLE = 3
DENSITY = Density()


@dataclass(frozen=True)
class Row:
    """One model from one kind of start, over all scenes.

    Args:
        model: Its name.
        start: "along" or "reversed".
        scenes: How many.
        converged: Share of starts that ended in a local optimum.
        within: Share of them that keep all limits of their model.
        iterations_p50: Linear systems solved.
        iterations_p90: The same.
        ms_p50: CPU time of the solve.
        ms_p90: The same.
        energy_p50: Of the optimum [nats].
        slip_optimum_mm: Largest slip of an optimum's own states in a step.
        slip_driven_mm: The same of the trajectory that is checked and driven.
    """

    model: str
    start: str
    scenes: int
    converged: float
    within: float
    iterations_p50: float
    iterations_p90: float
    ms_p50: float
    ms_p90: float
    energy_p50: float
    slip_optimum_mm: float
    slip_driven_mm: float


def scene(seed: int, model: RobotModel, start: str) -> Scenario:
    """A random world with one plan, and a robot of this model in it."""
    rng = np.random.default_rng([seed, 1])
    world = World.random(seed, PEOPLE)
    scenario = world.scenario(DENSITY.steps, 1, "predicted", density=DENSITY)
    if start == "along":
        robot = Robot(world.robot[:2], world.robot[2:], 0.0, model=model)
    else:
        robot = Robot(world.robot[:2], heading=rng.uniform(0.5, 1.5) * np.pi, model=model)
    return scenario.replace(robot=robot)


def solve(scenario: Scenario, solver: SecondOrder) -> dict[str, Any]:
    """Its first start, solved."""
    d, robot = scenario.density, scenario.robot
    belief = believe(seen(scenario), scenario.now, d.Qc_people, d.sigma_track, d.sigma_speed)
    hypotheses = hypothesise(scenario, belief)
    assembly = Assembly(build(scenario, belief, hypotheses))
    model = assembly.models[0]
    X = model.initial(hypotheses[0].starts[0])[None]
    began = process_time()
    found = solver.solve(assembly, X, np.zeros(1, dtype=np.intp))[0]
    took = process_time() - began
    states, driven = found.state[:, model.columns["robot"]], model.trajectory(found.state)
    wheels = driven.headings is not None
    return {
        "iterations": found.iterations,
        "ms": 1e3 * took,
        "converged": found.converged,
        "energy": found.energy,
        "within": not robot.model.problems(robot, driven),
        "slip": 1e3 * slip(states, d.dt).max() if wheels else 0.0,
        "driven": 1e3 * slip(robot.model.states(driven), d.dt).max() if wheels else 0.0,  # type: ignore[attr-defined]
    }


def run(scenes: int, bar: Bar = iter) -> list[Row]:
    """All models from both starts."""
    rows = []
    for name, model in MODELS.items():
        for start in ("along", "reversed"):
            ends = [solve(scene(seed, model, start), SecondOrder()) for seed in bar(range(scenes))]
            of = {key: np.array([end[key] for end in ends], dtype=float) for key in ends[0]}
            good = of["converged"] > 0
            rows.append(
                Row(
                    name, start, scenes, float(good.mean()), float(of["within"][good].mean()),
                    *_percentiles(of["iterations"]), *_percentiles(of["ms"]),
                    float(np.median(of["energy"])),
                    float(of["slip"][good].max()), float(of["driven"].max()),
                )
            )  # fmt: skip
    return rows


def _percentiles(x: Array) -> tuple[float, float]:
    return float(np.percentile(x, 50)), float(np.percentile(x, 90))
