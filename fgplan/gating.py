"""Who is planned with the robot, and which pairs can matter at all.

People who stay out of reach of every start are held at their prediction: the robot still keeps
clear of them, but they are not asked to react, and what that costs has no bound. Pairs of people
whose predictions stay far apart are left out. That only removes terms −log ψ ≥ 0, so for the energy
E of the density of those who are planned and E_g of the gated one, with optima x* and x_g:
E_g(x_g) ≤ E(x*) ≤ E(x_g) = E_g(x_g) + left out(x_g).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from factors.interaction import Interaction
from factors.pairwise import pair_index
from factors.radial import components, square
from fgplan.crowd import Belief
from fgplan.hypothesis import Hypothesis
from fgplan.scenario import Scenario

Array = NDArray[np.float64]
Index = NDArray[np.intp]

NEGLIGIBLE = 1e-6
"""A pair whose predicted interaction over the horizon is below this is left out [nats]."""
ALLOWANCE = 0.5
"""How much closer than predicted two people may come before that could be wrong [m]."""


@dataclass(frozen=True, eq=False)
class Gate:
    """What enters the density.

    Args:
        planned: Indices of the people who are variables.
        held: Indices of the people held at their prediction.
        pairs: Interacting bodies, shape (P, 2), among the robot (0) and the planned people
            (1, 2, ... in their order).
        left_out: Pairs of people left out, shape (Q, 2), indices of the belief.
    """

    planned: Index
    held: Index
    pairs: Index
    left_out: Index


def gate(scenario: Scenario, belief: Belief, hypotheses: Sequence[Hypothesis]) -> Gate:
    """Decide from predictions and starts; `left_out_energy` says afterwards what it cost."""
    n = belief.count
    nobody = np.zeros(0, dtype=np.intp)
    no_pairs = np.zeros((0, 2), dtype=np.intp)
    if scenario.crowd == "predicted" or n == 0:
        return Gate(nobody, np.arange(n), no_pairs, no_pairs)
    people = belief.expected(scenario.density.times)[..., :2]
    within = _within_reach(scenario, people, hypotheses)
    planned, held = np.flatnonzero(within), np.flatnonzero(~within)
    robot = np.column_stack([np.zeros_like(planned), 1 + np.arange(len(planned))])
    if scenario.pairs == "robot":
        return Gate(planned, held, robot, no_pairs)
    i, j = (index - 1 for index in pair_index(n, "all"))
    i, j = i[i >= 0], j[i >= 0]
    apart = square([c[:, i] - c[:, j] for c in components(people)]).min(axis=0)
    matter = within[i] & within[j] & (apart < (_cutoff(scenario) + ALLOWANCE) ** 2)
    body = np.cumsum(within)  # the robot is body 0
    among = np.column_stack([body[i[matter]], body[j[matter]]])
    return Gate(
        planned,
        held,
        np.vstack([robot, among]),
        np.column_stack([i[~matter], j[~matter]]),
    )


def left_out_energy(scenario: Scenario, gate_: Gate, people: Array) -> float:
    """−log ψ_int of the pairs left out, with people (S, n, ≥ 2) where they were planned [nats]."""
    d = scenario.density
    if not len(gate_.left_out) or d.alpha == 0:
        return 0.0
    i, j = gate_.left_out.T
    d2 = ((people[:, i, :2] - people[:, j, :2]) ** 2).sum(-1)
    return float(Interaction(d.alpha, d.h_c, d.exponent).energy(d2).sum())


def _within_reach(
    scenario: Scenario, people: Array, hypotheses: Sequence[Hypothesis]
) -> NDArray[np.bool_]:
    starts = np.stack([start.robot.positions for h in hypotheses for start in h.starts])
    each = zip(components(people), components(starts), strict=True)
    apart = square([person - start[..., None] for person, start in each])
    return np.asarray(apart.min(axis=(0, 1)) <= scenario.density.reach**2)


def _cutoff(scenario: Scenario) -> float:
    """Separation at which a pair is worth less than `NEGLIGIBLE` over the whole horizon [m]."""
    d = scenario.density
    strength = d.alpha * d.exponent * (d.steps + 1)
    if strength <= NEGLIGIBLE:
        return 0.0
    return float(d.h_c * np.sqrt(2 * np.log(strength / NEGLIGIBLE)))
