"""The same density as a CasADi expression, written from its formulas, and solved by IPOPT.

fgplan leaves out pairs that are worth less than a millionth of a nat. A program has either all
pairs, so that it can be built once for all scenes, or those of one scene alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from time import perf_counter
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from benchmarks.solver.problem import Problem
from factors.interaction import Interaction
from fgplan.scenario import Scenario

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SMALL = 1e-6
"""Smooths a norm at zero, as in `factors.hinge` [m, or m/s]."""
LIMIT_SHARE = 0.95
"""Share of a limit at which its hinge begins."""
OPTIONS = {
    "print_time": False,
    "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-6, "max_iter": 500},
}


@dataclass(frozen=True, eq=False)
class Program:
    """The density of one problem; the plan to follow is its parameter.

    Args:
        problem: The problem.
        pairs: Interacting bodies, shape (P, 2): the robot (0) and the planned people (1, 2, ...).
        energy: (free variables, plan) → −log p [nats].
        solver: CasADi's interface to IPOPT.
        seconds: What building took, derivatives included [s].
    """

    problem: Problem
    pairs: Index
    energy: Any
    solver: Any
    seconds: float

    @classmethod
    def build(cls, problem: Problem, gated: bool = False) -> Program:
        """Write the expression and differentiate it.

        Args:
            problem: The problem.
            gated: Leave out the pairs that fgplan leaves out.

        Raises:
            ValueError: the scenario has something that the expression leaves out.
        """
        scenario = problem.scenario
        plain = scenario.grid is None and scenario.robot.covariance is None
        if not plain or len(scenario.levels) > 1 or scenario.levels[0].sigma > 0:
            raise ValueError("the expression knows no map, no level with width, no unsure robot")
        began = perf_counter()
        gate = problem.assembly.models[0].gate
        pairs = gate.pairs if gated else _all_pairs(len(gate.planned))
        x, plan, total = _expression(problem, pairs)
        solver = ca.nlpsol("density", "ipopt", {"x": x, "p": plan, "f": total}, OPTIONS)
        energy = ca.Function("energy", [x, plan], [total])
        return cls(problem, pairs, energy, solver, perf_counter() - began)

    def solve(self, state: Array, which: int) -> tuple[Array, int]:
        """The optimum (T + 1, D) from a state, and IPOPT's iterations."""
        found = self.solver(x0=state.ravel()[4:], p=self._plan(which))
        free = np.asarray(found["x"]).ravel()
        end = np.concatenate([self.problem.scenario.robot.state, free]).reshape(state.shape)
        return end, int(self.solver.stats()["iter_count"])

    def energy_of(self, state: Array, which: int) -> float:
        """−log p of a state (T + 1, D) [nats]."""
        return float(self.energy(state.ravel()[4:], self._plan(which)))

    def disagreement(self, state: Array, which: int) -> float:
        """Relative difference to fgplan's energy of a state, and of the pairs it leaves out."""
        expected = float(self.problem.assembly.energy(state, np.asarray(which)))
        left_out = set(map(tuple, self.pairs.tolist()))
        left_out -= set(map(tuple, self.problem.assembly.models[0].gate.pairs.tolist()))
        if left_out:
            n, (i, j) = (state.shape[1] - 4) // 4, np.array(sorted(left_out)).T
            bodies = np.hstack([state[:, :2], state[:, 4 : 4 + 2 * n]]).reshape(-1, n + 1, 2)
            d, d2 = self.problem.scenario.density, ((bodies[:, i] - bodies[:, j]) ** 2).sum(-1)
            expected += float(Interaction(d.alpha, d.h_c, d.exponent).energy(d2).sum())
        return abs(self.energy_of(state, which) - expected) / (1 + abs(expected))

    def _plan(self, which: int) -> Array:
        plan = self.problem.hypotheses[which].plan
        assert plan is not None
        return plan.positions.ravel()


def _all_pairs(n: int) -> Index:
    return np.column_stack(np.triu_indices(n + 1, k=1))


def _expression(problem: Problem, pairs: Index) -> tuple[Any, Any, Any]:
    """Free variables, the plan and the energy. The robot's first state is known."""
    scenario, d = problem.scenario, problem.scenario.density
    gate = problem.assembly.models[0].gate
    people, held = problem.belief.select(gate.planned), problem.belief.select(gate.held)
    T, n = d.steps, people.count
    free = [ca.SX.sym(f"x{k}", 4 + 4 * n if k else 4 * n) for k in range(T + 1)]
    plan = ca.SX.sym("plan", 2, T + 1)
    robot = [ca.DM(scenario.robot.state)] + [x[:4] for x in free[1:]]
    crowd = [free[0]] + [x[4:] for x in free[1:]]

    total = _wnoa(robot, d.Qc_robot, d.dt) + _limits(robot, scenario)
    for k in range(T + 1):
        total += d.exponent / (2 * scenario.levels[0].h) * ca.sumsqr(robot[k][:2] - plan[:, k])
        bodies = [robot[k][:2]] + [crowd[k][2 * i : 2 * i + 2] for i in range(n)]
        total += sum(_interaction(bodies[i] - bodies[j], d) for i, j in pairs.tolist())
        near = zip(bodies[1:], people.radii, strict=True)
        total += sum(_contact(bodies[0] - body, scenario, r) for body, r in near)
        total += _held(bodies[0], held.predict(d.times[k : k + 1]), scenario, held.radii)
    if n:
        total += _wnoa(crowd, d.Qc_people, d.dt)
    for i in range(n):
        e = crowd[0][[2 * i, 2 * i + 1, 2 * n + 2 * i, 2 * n + 2 * i + 1]] - people.mean[i]
        total += 0.5 * ca.bilin(ca.DM(np.linalg.inv(people.covariance[i])), e, e)
    return ca.vertcat(*free), ca.vec(plan), total


def _wnoa(states: list[Any], Qc: float, dt: float) -> Any:
    """½ eᵀ Q⁻¹ e, e = x_{k+1} − Phi x_k, over a chain of states (positions, velocities)."""
    half = states[0].shape[0] // 2
    inverse = np.linalg.inv(Qc * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]))
    total = 0.0
    for before, after in pairwise(states):
        position = after[:half] - before[:half] - dt * before[half:]
        velocity = after[half:] - before[half:]
        total += 0.5 * inverse[0, 0] * ca.sumsqr(position)
        total += 0.5 * inverse[1, 1] * ca.sumsqr(velocity)
        total += inverse[0, 1] * ca.dot(position, velocity)
    return total


def _interaction(apart: Any, d: Any, variance: float = 0.0) -> Any:
    presence = d.alpha * ca.exp(-ca.sumsqr(apart) / (2 * (d.h_c**2 + variance)))
    return -d.exponent * ca.log1p(-presence)


def _contact(apart: Any, scenario: Scenario, radius: float) -> Any:
    d = scenario.density
    reach = scenario.robot.radius + radius + d.contact_margin
    return _hinge(reach - _norm(apart), d.contact_sigma, d.exponent)


def _held(robot: Any, predicted: tuple[Array, Array], scenario: Scenario, radii: Array) -> Any:
    """The robot with people who stay at their prediction at one time."""
    total = 0.0
    for mean, covariance, radius in zip(predicted[0][0], predicted[1][0], radii, strict=True):
        apart, variance = robot - ca.DM(mean[:2]), (covariance[0, 0] + covariance[1, 1]) / 2
        total += _interaction(apart, scenario.density, variance)
        total += _contact(apart, scenario, radius)
    return total


def _limits(robot: list[Any], scenario: Scenario) -> Any:
    """Speed and acceleration of the robot."""
    d, total = scenario.density, 0.0
    speed, acceleration = scenario.robot.max_speed, scenario.robot.max_acceleration
    for before, after in pairwise(robot):
        fast = _norm(after[2:]) - LIMIT_SHARE * speed
        hard = _norm(after[2:] - before[2:]) / d.dt - LIMIT_SHARE * acceleration
        total += _hinge(fast, d.limit_sigma, d.exponent) + _hinge(hard, d.limit_sigma, d.exponent)
    return total


def _norm(v: Any) -> Any:
    return ca.sqrt(ca.sumsqr(v) + SMALL**2)


def _hinge(excess: Any, sigma: float, weight: float) -> Any:
    return 0.5 * weight * (ca.fmax(0, excess) / sigma) ** 2
