"""Hypotheses at more than one level: their product, p(i, j, ...) ∝ w_i v_j ... times couplings.

A level may have plans of its own (`Level.plans`). Every combination of one plan a level is a
hypothesis of the joint density, solved and weighed like any other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from fgplan.hypotheses import driven_along, log_weights
from fgplan.hypothesis import Hypothesis, Start
from fgplan.labels import OF_LEVELS
from fgplan.scenario import Level, Scenario
from fgplan.stack import links
from fgplan.timing import path_length
from fgplan.trajectory import Trajectory


class _Choice(NamedTuple):
    """One plan of a level: at the steps, and at the times of data where there is any."""

    label: str
    weight: float
    plan: Trajectory
    course: Trajectory | None


def crossed(scenario: Scenario, hypotheses: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """The combinations of the first level's hypotheses with those of the levels below.

    Where no level has plans of its own, the hypotheses as they are.

    Args:
        scenario: What is known now.
        hypotheses: Of the first level.
    """
    hypotheses = tuple(hypotheses)
    own = [level for level in scenario.levels[1:] if level.plans]
    if not own or any(h.plan is None for h in hypotheses):
        return hypotheses
    choices = [_choices(scenario, level) for level in own]
    found = []
    for first, others in product(hypotheses, product(*choices)):
        labels = [first.label, *(other.label for other in others)]
        chosen = {level.name: other for level, other in zip(own, others, strict=True)}
        courses = {name: one.course for name, one in chosen.items() if one.course is not None}
        tries = tuple(Start(other.label, other.plan) for other in others)
        combination = replace(
            first,
            label=OF_LEVELS.join(labels),
            log_prior=first.log_prior + sum(other.weight for other in others),
            starts=(*first.starts, *tries),
            own={name: one.plan for name, one in chosen.items()},
            own_courses=courses,
        )
        between = _between_fixed(scenario, combination)
        found.append(replace(combination, log_prior=combination.log_prior - between))
    score = np.array([h.log_prior for h in found])
    score -= np.logaddexp.reduce(score)
    return tuple(replace(h, log_prior=w) for h, w in zip(found, score.tolist(), strict=True))


def _choices(scenario: Scenario, level: Level) -> list[_Choice]:
    """The plans of a level with a weight above 0."""
    robot, paths = scenario.robot, []
    for given in level.plans:
        vertices = np.asarray(given.path, dtype=float)
        if not np.allclose(vertices[0], robot.position, atol=1e-9):
            vertices = np.vstack([robot.position, vertices])
        paths.append(vertices)
    costs = [path_length(path) / robot.preferred_speed for path in paths]
    weights = log_weights(costs, scenario.density.beta, [given.weight for given in level.plans])
    found = []
    for given, weight, path, cost in zip(level.plans, weights.tolist(), paths, costs, strict=True):
        if weight == -np.inf:
            continue
        found.append(_Choice(given.label, weight, *driven_along(scenario, path, cost)))
    return found


def _between_fixed(scenario: Scenario, hypothesis: Hypothesis) -> float:
    """−log ψ of couplings between levels without width: a constant of the combination [nats]."""
    levels, energy = scenario.levels, 0.0
    for link in links(levels):
        if link.below is None or levels[link.above].sigma > 0 or levels[link.below].sigma > 0:
            continue
        above = hypothesis.plan_of(levels[link.above].name)
        below = hypothesis.plan_of(levels[link.below].name)
        assert above is not None
        assert below is not None
        apart = (above.positions - below.positions)[:: link.every]
        weight = link.every * scenario.density.exponent
        energy += weight * float(np.sum(apart**2)) / (2 * link.h)
    return energy
