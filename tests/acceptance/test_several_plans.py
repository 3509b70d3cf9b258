"""Statements 9 and 10: several plans, chosen by height and by mass."""

from __future__ import annotations

import numpy as np
import pytest

from factors.coupling import coupling, coupling_to
from factors.gp_prior import gaussian
from fgplan.solver import SecondOrder
from tests.scalar import ROBOT, model, plan_variable, together
from tests.scenes import mode_evidence


def scores(assembly) -> tuple[np.ndarray, np.ndarray]:
    """−energy and log evidence of each hypothesis, as `plan` weighs them."""
    K = len(assembly.models)
    solutions = SecondOrder().solve(assembly, assembly.reference, np.arange(K))
    energy = [
        s.energy - m.log_normalizer_own for s, m in zip(solutions, assembly.models, strict=True)
    ]
    evidence = [mode_evidence(assembly, s, i) for i, s in enumerate(solutions)]
    return -np.array(energy), np.array(evidence)


def test_9_the_choice_flips_where_the_distances_say():
    prior = gaussian(np.zeros(1), np.eye(1))
    paths = (0.5, -1.0)
    assembly = together(
        [
            model(
                [ROBOT], [(prior, ("robot",))], [(coupling_to(np.array([p]), 0.1, 1), ("robot",))]
            )
            for p in paths
        ]
    )
    height, mass = scores(assembly)
    # The choice flips where log w1 − log w2 makes up for the difference of the scores.
    assert np.exp(height[1] - height[0]) == pytest.approx(0.711124, abs=5e-7)
    assert np.exp(mass[1] - mass[0]) == pytest.approx(0.711124, abs=5e-7)


@pytest.mark.parametrize("seed", range(5))
def test_9_flip_point_of_random_trajectories(seed):
    rng = np.random.default_rng(seed)
    n, h = 4, rng.uniform(0.05, 2)
    B = rng.normal(size=(n, n))
    K, m, etas = B @ B.T + np.eye(n), rng.normal(size=n), rng.normal(size=(2, n))
    robot = ROBOT.__class__("robot", n, ROBOT.key)
    assembly = together(
        [
            model([robot], [(gaussian(m, K), ("robot",))], [(coupling_to(e, h, n), ("robot",))])
            for e in etas
        ]
    )
    d = [(e - m) @ np.linalg.solve(K + h * np.eye(n), e - m) for e in etas]
    height, mass = scores(assembly)
    assert height[1] - height[0] == pytest.approx(0.5 * (d[0] - d[1]), abs=1e-9)
    assert mass[1] - mass[0] == pytest.approx(0.5 * (d[0] - d[1]), abs=1e-9)


def test_10_height_and_mass_disagree_between_a_wide_and_a_narrow_plan():
    # Seen to fail without log_normalizer_own in the energy: height then ties at w1 = w2.
    h = 1e-9
    eta = plan_variable(0)
    flat = gaussian(np.zeros(1), np.eye(1) * 1e12)
    assembly = together(
        [
            model(
                [eta, ROBOT],
                [(flat, ("robot",)), (coupling(h, (1, 1), space=1), ("level 0", "robot"))],
                [(gaussian(np.array([mean]), np.array([[variance]])), ("level 0",))],
            )
            for mean, variance in ((-2.0, 1.0), (2.0, 0.25))
        ]
    )
    height, mass = scores(assembly)
    log_w = np.log([0.6, 0.4])
    assert np.argmax(log_w + height) == 1
    assert np.argmax(log_w + mass) == 0
    assert np.exp(height[1] - height[0]) == pytest.approx(2, rel=1e-6)
    assert np.exp(mass[1] - mass[0]) == pytest.approx(1, rel=1e-6)
