"""One plan to be made: a scenario, its hypotheses, and the starts that every solver is given."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.scenes import World
from fgplan.assembly import Assembly
from fgplan.backend import Backend
from fgplan.components import Solving
from fgplan.crowd import Belief, believe, seen
from fgplan.hypotheses import hypothesise
from fgplan.hypothesis import Hypothesis, Start
from fgplan.model import build
from fgplan.scenario import Scenario
from fgplan.search import shift
from fgplan.solver import Solution, Stop
from fgplan.trajectory import Trajectory

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Problem:
    """What every solver is given.

    Args:
        scenario: What is known now.
        belief: The people.
        hypotheses: The K global plans.
        starts: B starts.
        which: Hypothesis of each, shape (B,).
    """

    scenario: Scenario
    belief: Belief
    hypotheses: tuple[Hypothesis, ...]
    starts: tuple[Start, ...]
    which: Index

    def assemble(self, backend: Backend | None = None) -> Assembly:
        """The density, from scratch: a planner does this for every plan."""
        return Assembly(build(self.scenario, self.belief, self.hypotheses), backend)

    @cached_property
    def assembly(self) -> Assembly:
        """The same, kept: for what nobody is timed for."""
        return self.assemble()

    @cached_property
    def initial(self) -> Array:
        """States to start from, shape (B, T + 1, D)."""
        models = self.assembly.models
        pairs = zip(self.which.tolist(), self.starts, strict=True)
        return np.stack([models[i].initial(start) for i, start in pairs])

    def energies(self, states: Array) -> Array:
        """−log p of the states (B, T + 1, D) that the starts led to [nats]."""
        return self.assembly.energy(states, self.which)

    def best(self, states: Array) -> Array:
        """The one with the lowest energy, shape (T + 1, D); all plans have the same weight."""
        return np.asarray(states[int(np.argmin(self.energies(states)))])


def cold(scenario: Scenario) -> Problem:
    """Each hypothesis from its own plan, everybody else from their prediction."""
    belief, hypotheses = _proposed(scenario)
    starts = tuple(h.starts[0] for h in hypotheses)
    return Problem(scenario, belief, hypotheses, starts, np.arange(len(hypotheses)))


def warm(world: World, before: Problem, states: Array, **size: Any) -> Problem:
    """The problem one step later, from what the starts before led to, shifted by that step.

    Args:
        world: Where `before` was solved; its robot follows the best of the states.
        before: The problem before.
        states: Where it ended, shape (B, T + 1, D).
        size: Arguments of `World.scenario`.
    """
    robot = before.assembly.models[0].columns["robot"]
    world = world.moved(before.best(states)[1, robot])
    scenario = world.scenario(**size)
    belief, hypotheses = _proposed(scenario)
    starts = tuple(_shifted(before, state, scenario, belief) for state in states)
    return Problem(scenario, belief, hypotheses, starts, before.which)


def _proposed(scenario: Scenario) -> tuple[Belief, tuple[Hypothesis, ...]]:
    d = scenario.density
    belief = believe(seen(scenario), scenario.now, d.Qc_people, d.sigma_track, d.sigma_speed)
    return belief, tuple(hypothesise(scenario, belief))


def _shifted(before: Problem, state: Array, scenario: Scenario, belief: Belief) -> Start:
    """One state (T + 1, D) as `fgplan.search.shifted` makes a start of it."""
    solving = Solving(before.scenario, before.belief, before.assembly, 0)
    solution = Solution(state, 0.0, 0, Stop.CONVERGED, 0.0)
    people = solving.people(solution)
    crowd = {
        name: Trajectory.from_states(people.times, people.states[:, i])
        for i, name in enumerate(before.belief.names)
    }
    return shift(solving.robot(solution), crowd, before.scenario.now, scenario, belief)
