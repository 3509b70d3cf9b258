"""Gating: who is held, which pairs are left out, and the bound on what that costs."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from factors.pairwise import pair_index
from fgplan import Density, Robot, Scenario, Track, gating, keys, plan
from fgplan.assembly import Assembly
from fgplan.components import Solving
from fgplan.hypotheses import hypothesise
from fgplan.model import build
from fgplan.solver import SecondOrder
from tests.scenes import believed

ONE = np.zeros(1, dtype=int)


def crowd(seed: int, n: int, side: float, **density) -> Scenario:
    """n people in a square, some of them in the robot's way, each seen twice."""
    rng = np.random.default_rng(seed)
    places, steps = rng.uniform(0, side, (n, 2)), 0.4 * rng.normal(0, 0.8, (n, 2))
    tracks = tuple(
        Track(f"p{i}", np.array([-0.4, 0.0]), np.array([p - step, p]))
        for i, (p, step) in enumerate(zip(places, steps, strict=True))
    )
    return Scenario(
        Robot(np.array([0.0, side / 2]), np.array([0.8, 0.0])),
        goal=np.array([side, side / 2]),
        tracks=tracks,
        density=Density(**density),
    )


@pytest.mark.parametrize("seed", range(4))
def test_the_whole_energy_is_the_gated_one_plus_what_was_left_out(seed):
    # Seen to fail with the pairs of planned and held people left uncounted in gating.py.
    scenario = crowd(seed, 12, 9.0, reach=2.0)
    belief = believed(scenario)
    hypotheses = hypothesise(scenario, belief)
    (model,) = build(scenario, belief, hypotheses)
    assert 0 < len(model.people) < belief.count
    assembly = Assembly([model])
    starts = np.stack([model.initial(s) for s in hypotheses[0].starts])
    found = SecondOrder().solve(assembly, starts, np.zeros(len(starts), dtype=int))
    best = min(found, key=lambda s: s.energy)
    solving = Solving(scenario, belief, assembly, 0, True)
    people = solving.people(best)
    # Oracle: all interactions of people, pair by pair, minus those that the gated density has.
    d = scenario.density
    total = 0.0
    for i, j in zip(*pair_index(belief.count - 1, "all"), strict=True):
        d2 = ((people.states[:, i, :2] - people.states[:, j, :2]) ** 2).sum(-1)
        total -= np.log1p(-d.alpha * np.exp(-d2 / (2 * d.h_c**2))).sum()
    planned = model.gate.planned
    inside = 0.0
    for a, b in model.gate.pairs:
        if a > 0:
            i, j = planned[a - 1], planned[b - 1]
            d2 = ((people.states[:, i, :2] - people.states[:, j, :2]) ** 2).sum(-1)
            inside -= np.log1p(-d.alpha * np.exp(-d2 / (2 * d.h_c**2))).sum()
    assert solving.left_out(people) == pytest.approx(total - inside, abs=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_the_bound_encloses_the_optimum_of_the_whole_density(seed, monkeypatch):
    """Pairs alone (nobody held): E_g(x_g) ≤ E(x*) ≤ E_g(x_g) + left out, in one basin."""
    scenario = crowd(seed, 14, 10.0, reach=np.inf)
    belief = believed(scenario)
    hypotheses = hypothesise(scenario, belief)
    (gated,) = build(scenario, belief, hypotheses)
    assert len(gated.gate.left_out) > 0
    assembly = Assembly([gated])
    start = gated.initial(hypotheses[0].starts[0])
    found = SecondOrder().solve(assembly, start[None], ONE)[0]
    solving = Solving(scenario, belief, assembly, 0, True)
    left_out = solving.left_out(solving.people(found))
    monkeypatch.setattr(gating, "ALLOWANCE", np.inf)
    (whole,) = build(scenario, belief, hypotheses)
    assert len(whole.gate.left_out) == 0
    best = SecondOrder().solve(Assembly([whole]), found.state[None], ONE)[0]
    assert found.energy - 1e-8 <= best.energy <= found.energy + left_out + 1e-8
    assert left_out < 1e-3


def test_who_is_far_is_held_and_near_people_are_not():
    scenario = Scenario(
        Robot(np.zeros(2), np.array([0.8, 0.0])),
        goal=np.array([6.0, 0.0]),
        tracks=tuple(
            Track(name, np.zeros(1), np.array([[2.0, y]])) for name, y in (("near", 1), ("far", 9))
        ),
        density=Density(reach=3.0, sigma_speed=0.1),
    )
    best = plan(scenario).components[0]
    assert best.displacement["far"] == 0
    assert best.displacement["near"] > 0
    assert set(best.crowd) == {"near", "far"}


def test_held_people_are_kept_clear_of():
    """Nobody is planned, as if mode were predicted: the plans are the same."""
    scenario = crowd(1, 8, 8.0, reach=1e-9)
    held = plan(scenario).components[0]
    predicted = plan(scenario.replace(crowd="predicted")).components[0]
    np.testing.assert_array_equal(held.robot.states, predicted.robot.states)


def test_a_users_factor_on_the_crowd_plans_everybody():
    scenario = crowd(2, 5, 20.0, reach=0.5)
    n = len(scenario.tracks)
    loose = gtsam.PriorFactorVector(
        keys.crowd(3), np.zeros(4 * n), gtsam.noiseModel.Isotropic.Sigma(4 * n, 1e6)
    )
    belief = believed(scenario)
    (model,) = build(scenario, belief, hypothesise(scenario, belief), [loose])
    assert model.people == belief.names
