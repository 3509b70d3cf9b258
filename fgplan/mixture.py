"""What a plan is: a weighted mixture of solved hypotheses, one of them selected, and its action."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fgplan.robots import Twist
from fgplan.safety import Check
from fgplan.trajectory import Trajectory

if TYPE_CHECKING:
    from fgplan.inference.base import Inferred

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Component:
    """One hypothesis, solved: its best local optimum, and the evidence it leaves.

    Args:
        label: Its name; hypotheses that ended in one optimum are joined with "+".
        log_prior: log w_i, summed over the hypotheses merged here.
        cost: Cost to go of its (best) global plan [s].
        energy: −log p at the optimum that is followed, see `docs/conventions.md` [nats].
        lowest: The same at the best optimum that passes the hard check: what the hypothesis is
            scored by. It is another one only where a check grades optima.
        log_evidence: log Z_i by the inference method: by default Laplace with the true Hessian,
            summed over the distinct optima found; None where it gives none, as where no optimum
            has a positive definite Hessian.
        converged: Whether the optimum is a local minimum to tolerance.
        stop: Why the solver stopped.
        iterations: Linear systems solved, over all starts.
        seconds: Share of the solver's time [s].
        start: The start that led here.
        optima: Number of distinct local optima found; with one, nothing says it is global.
        finished: Whether all its starts were followed to their end.
        check: The hard check.
        robot: f^R.
        crowd: f: people's planned (or predicted) trajectories, by name.
        levels: η_l, by name; the fixed plan where the level has no width.
        left_out: Energy of the pairs that gating left out, at this optimum: with all pairs of those
            who are planned the energy is higher by at most this [nats]. Of people who are out of
            reach, and so held at their prediction, it says nothing.
        displacement: How far each person is moved from their own prediction, as the Mahalanobis
            distance at the worst time step; 0 where people are held.
        sides: On which side each person near the robot is passed: "left" or "right".
        route: The global plan, shape (N, 2) [m]; None when no goal is known.
        inferred: All that the inference method knows: weighted trajectories, the error of
            `log_evidence`, diagnostics.
    """

    label: str
    log_prior: float
    cost: float
    energy: float
    lowest: float
    log_evidence: float | None
    converged: bool
    stop: str
    iterations: int
    seconds: float
    start: str
    optima: int
    finished: bool
    check: Check
    robot: Trajectory
    crowd: dict[str, Trajectory]
    levels: dict[str, Trajectory]
    left_out: float
    displacement: dict[str, float]
    sides: dict[str, str]
    route: Array | None
    inferred: Inferred | None = None

    @property
    def feasible(self) -> bool:
        """Whether it passed the hard check."""
        return self.check.feasible


@dataclass(frozen=True, eq=False)
class Action:
    """What to do until the next plan.

    Args:
        kind: "follow" the selected plan, or "stop".
        time: When the state below is to be reached, from now [s].
        position: Shape (2,) [m].
        velocity: Shape (2,) [m/s].
        twist: The same as a command in the robot's base frame.
        safe: Whether the trajectory behind it passed the hard check.
        reason: In words.
    """

    kind: str
    time: float
    position: Array
    velocity: Array
    twist: Twist
    safe: bool
    reason: str


@dataclass(frozen=True, eq=False)
class Mixture:
    """All hypotheses, solved and weighed.

    Args:
        name: Of the scenario.
        now: Of the scenario [s].
        components: In the order of their score, best first.
        probability_height: softmax(log w_i − lowest_i), shape (K,).
        probability_mass: softmax(log w_i + log Z_i), shape (K,); 0 where there is no evidence, so
            all 0 where nobody has any: then it says nothing, and in JSON it is null.
        selected: Index of the component that is followed; None when none is safe.
        trajectory: What will be driven: the selected plan, or the stop.
        action: Its next step.
        timing: Seconds spent, by stage.
        warnings: What to know before trusting it.
    """

    name: str
    now: float
    components: tuple[Component, ...]
    probability_height: Array
    probability_mass: Array
    selected: int | None
    trajectory: Trajectory
    action: Action
    timing: dict[str, float]
    warnings: tuple[str, ...]

    @property
    def best(self) -> Component | None:
        """The selected component."""
        return None if self.selected is None else self.components[self.selected]

    @property
    def has_mass(self) -> bool:
        """Whether anybody has evidence, and `probability_mass` a meaning."""
        return bool(self.probability_mass.any())

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON: no NaN, no infinity (null instead)."""
        best = self.best
        action = self.action
        return {
            "scenario": self.name,
            "now": self.now,
            "selected": None if best is None else best.label,
            "action": {
                "kind": action.kind,
                "time": action.time,
                "position": action.position.tolist(),
                "velocity": action.velocity.tolist(),
                "twist": action.twist.to_dict(),
                "safe": action.safe,
                "reason": action.reason,
            },
            "trajectory": self.trajectory.rows,
            "timing": self.timing,
            "warnings": list(self.warnings),
            "hypotheses": [
                _component_dict(component, height, mass if self.has_mass else None)
                for component, height, mass in zip(
                    self.components,
                    self.probability_height.tolist(),
                    self.probability_mass.tolist(),
                    strict=True,
                )
            ],
        }


def _component_dict(c: Component, height: float, mass: float | None) -> dict[str, Any]:
    return {
        "label": c.label,
        "log_prior": c.log_prior,
        "cost": c.cost,
        "energy": finite(c.energy),
        "log_evidence": None if c.log_evidence is None else finite(c.log_evidence),
        "probability_height": height,
        "probability_mass": mass,
        "converged": c.converged,
        "stop": c.stop,
        "iterations": c.iterations,
        "seconds": c.seconds,
        "start": c.start,
        "optima": c.optima,
        "finished": c.finished,
        "min_separation": finite(c.check.min_separation),
        "clearance": finite(c.check.clearance),
        "feasible": c.feasible,
        "problems": list(c.check.problems),
        "robot": c.robot.rows,
        "crowd": {name: person.rows for name, person in c.crowd.items()},
        "levels": {name: level.rows for name, level in c.levels.items()},
        "left_out": c.left_out,
        "displacement": c.displacement,
        "sides": c.sides,
        "inference": None if c.inferred is None else c.inferred.to_dict(),
    }


def finite(value: float) -> float | None:
    """The number, or None: JSON knows no infinity."""
    return value if np.isfinite(value) else None
