"""Statements 26 to 29: stacks of levels, against closed forms, dense algebra and brute force."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from factors.coupling import coupling
from factors.gp_prior import gaussian
from fgplan import Density, GivenPlan, Level, Reading, Readings, Robot, Scenario, plan
from fgplan.assembly import Assembly
from fgplan.conditioning import reweigh
from fgplan.crowd import believe
from fgplan.hypotheses import hypothesise, log_weights
from fgplan.products import crossed
from fgplan.selection import mass
from fgplan.stack import loose
from fgplan.timing import path_length, timed
from tests.dense import Stack
from tests.scalar import ROBOT, model, optimum, plan_variable
from tests.scenes import ONE, assembled, dense

FREE = Density(limit_sigma=np.inf, obstacle_sigma=np.inf)
PATH = np.array([[0.0, 0.0], [2.0, 1.0], [6.0, 0.5]])


def scenario(levels, density=FREE, **changes):
    robot = Robot(np.zeros(2), np.array([0.7, 0.2]))
    path = (GivenPlan("the plan", PATH),)
    return Scenario(robot, plans=path, count=0, levels=levels, density=density, **changes)


def three(mu0=1.0, S=1.0, K=1.0, h01=1.0, h1R=1.0, m=0.0):
    """η_0 – η_1 – f^R in one dimension at one step; nothing is said of η_1 itself."""
    eta0, eta1 = plan_variable(0), plan_variable(1)
    shared = [(gaussian(np.array([m]), K * np.eye(1)), ("robot",))]
    own = [
        (gaussian(np.array([mu0]), S * np.eye(1)), ("level 0",)),
        (coupling(h01, (1, 1), 1), ("level 0", "level 1")),
        (coupling(h1R, (1, 1), 1), ("level 1", "robot")),
    ]
    return model([eta0, eta1, ROBOT], shared, own)


def covariance(one):
    """By inverting the library's own Hessian: (precision, covariance)."""
    assembly = Assembly([one])
    H = dense(*(part[0] for part in assembly.linear_hessian(ONE)))
    return H, np.linalg.inv(H)


def test_26_a_level_without_data_between_two():
    np.testing.assert_allclose(optimum(three()).state[0], [0.75, 0.5, 0.25], atol=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_26_the_closed_form_for_any_variances(seed):
    mu0, m = np.random.default_rng(seed).normal(size=2)
    S, K, h01, h1R = np.random.default_rng(seed).uniform(0.1, 3.0, 4)
    robot = optimum(three(mu0, S, K, h01, h1R, m)).state[0, 2]
    assert robot == pytest.approx(m + K * (mu0 - m) / (K + S + h01 + h1R), abs=1e-8)


@pytest.mark.parametrize(("variance", "expected"), [(1.0, 0.25), (0.5, 0.125)])
def test_28_no_precision_in_common_and_yet_a_covariance(variance, expected):
    """Σ0 K/(K + Σ0 + h01 + h1R), here with all four of them equal."""
    P, S = covariance(three(S=variance, K=variance, h01=variance, h1R=variance))
    assert P[0, 2] == 0
    assert S[0, 2] == pytest.approx(expected, abs=1e-12)


def test_28_given_the_level_between_them_they_are_independent():
    P, _ = covariance(three(S=0.7, K=1.3, h01=0.4, h1R=2.0))
    given = np.linalg.inv(P[np.ix_([0, 2], [0, 2])])
    assert given[0, 1] == 0


FLAT = Level("tactics", sigma=np.inf, h=1e-9)


@pytest.mark.parametrize("sigma", [0.0, 0.5])
def test_27_a_dataless_level_in_between_changes_nothing(sigma):
    mission = Level("mission", sigma=sigma, h=0.4)
    asked = scenario((mission,), FREE).replace(plans=ABOVE)
    without, with_it = plan(asked), plan(asked.replace(levels=(mission, FLAT)))
    for a, b in zip(without.components, with_it.components, strict=True):
        assert a.label == b.label
        np.testing.assert_allclose(b.robot.states, a.robot.states, atol=1e-5)
        np.testing.assert_allclose(b.levels["tactics"].positions, b.robot.positions, atol=1e-5)
    for a, b in (
        (without.probability_height, with_it.probability_height),
        (without.probability_mass, with_it.probability_mass),
    ):
        np.testing.assert_allclose(b, a, atol=1e-6)


def test_27_nor_one_before_it():
    """h → 0 to the level above instead: the new level is the old one."""
    mission = Level("mission", sigma=0.5, h=0.4)
    tied = (replace(mission, h=1e-9), replace(FLAT, h=0.4))
    without, with_it = plan(scenario((mission,))), plan(scenario(tied))
    a, b = without.components[0], with_it.components[0]
    np.testing.assert_allclose(b.robot.states, a.robot.states, atol=1e-5)
    np.testing.assert_allclose(
        b.levels["tactics"].positions, a.levels["mission"].positions, atol=1e-5
    )


def random_stack(seed, L, tree):
    """Any stack in which every level is held at every step."""
    rng = np.random.default_rng(seed)
    while loose(levels := _any_stack(rng, L, tree)):
        pass
    return levels


def _any_stack(rng, L, tree):
    levels = [
        Level("η0", sigma=rng.uniform(0.2, 2), length=rng.uniform(1, 5), h=rng.uniform(0.1, 2))
    ]
    for i in range(1, L):
        kind = rng.integers(3)
        sigma = rng.uniform(0.2, 2) if kind == 0 else np.inf
        Qc = rng.uniform(0.2, 3) if kind == 1 else None
        every = int(rng.choice([1, 2, 3])) if kind < 2 else 1
        follows = f"η{rng.integers(i)}" if tree else None
        levels.append(
            Level(f"η{i}", sigma, rng.uniform(1, 5), rng.uniform(0.1, 2), Qc, follows, every)
        )
    return tuple(levels)


@pytest.mark.parametrize("tree", [False, True])
@pytest.mark.parametrize("L", range(1, 7))
@pytest.mark.parametrize("seed", range(3))
def test_stacks_agree_with_dense_linear_algebra(L, tree, seed):
    levels = random_stack(seed, L, tree)
    density = replace(FREE, dt=0.5, horizon=3.0, t_ref=0.4)
    asked = scenario(levels, density)
    assembly, (hypothesis,) = assembled(asked)
    oracle = Stack(levels, [hypothesis.plan.positions] * L, asked.robot, density)
    start = assembly.models[0].initial(hypothesis.starts[0])[None]
    q = assembly.expand(start, ONE)
    H = dense(q.diagonal[0], q.upper[0])
    state = (start[0].ravel() - np.linalg.solve(H, q.gradient[0].ravel())).reshape(start[0].shape)
    S = np.linalg.inv(H)
    columns, D = assembly.models[0].columns, start.shape[2]
    places = []
    for i, expected in enumerate(oracle.mean):
        c = columns["robot" if i == L else f"level {i}"].start
        at = oracle.steps[i]
        np.testing.assert_allclose(state[at, c : c + 2], expected, rtol=0, atol=1e-10)
        places += [k * D + c for k in at]
    np.testing.assert_allclose(S[np.ix_(places, places)], oracle.covariance, rtol=0, atol=1e-10)


def test_28_in_a_whole_plan():
    """Two trajectories that are not neighbours have no block of the precision in common."""
    levels = (Level("mission", sigma=0.5, h=0.5), Level("tactics", sigma=np.inf, h=0.5))
    assembly, _ = assembled(scenario(levels))
    q = assembly.expand(assembly.reference, ONE)
    columns = assembly.models[0].columns
    above, robot = columns["level 0"], columns["robot"]
    assert not q.diagonal[0][:, above, robot].any()
    assert not q.upper[0][:, above, robot].any()
    assert not q.upper[0][:, robot, above].any()
    D = assembly.reference.shape[2]
    S = np.linalg.inv(dense(q.diagonal[0], q.upper[0]))
    assert S[3 * D + above.start, 3 * D + robot.start] > 0.01


SIDES = (
    GivenPlan("left", np.array([[0.0, 0.0], [3.0, 1.5], [7.0, 0.0]]), 2.0),
    GivenPlan("right", np.array([[0.0, 0.0], [3.0, -1.5], [7.0, 0.0]]), 1.0),
    GivenPlan("far", np.array([[0.0, 0.0], [0.0, 8.0]]), 1.0),
)
ABOVE = (
    GivenPlan("up", np.array([[0.0, 0.0], [7.0, 2.0]]), 1.0),
    GivenPlan("down", np.array([[0.0, 0.0], [7.0, -1.0]]), None),
)


@pytest.mark.parametrize("widths", [(0.4, 0.3), (0.0, 0.3), (0.4, 0.0), (0.0, 0.0)])
def test_29_hypotheses_of_two_levels_equal_brute_force(widths):
    """Every combination alone, as the only hypothesis of both levels, and then weighed by hand."""
    levels = (Level("mission", widths[0], h=0.5), Level("tactics", widths[1], h=0.8, plans=SIDES))
    asked = scenario(levels).replace(plans=ABOVE)
    together = plan(asked)
    costs = {p.label: path_length(p.path) / asked.robot.preferred_speed for p in (*ABOVE, *SIDES)}

    def prior(plans):
        given = [costs[p.label] for p in plans], asked.density.beta, [p.weight for p in plans]
        return dict(zip([p.label for p in plans], log_weights(*given), strict=True))

    w, v = prior(ABOVE), prior(SIDES)
    scores = {}
    for i, j in product(ABOVE, SIDES):
        only = (levels[0], replace(levels[1], plans=(j,)))
        alone = plan(asked.replace(plans=(i,), levels=only)).components[0]
        energy = alone.energy + _between(asked, i, j) * (max(widths) == 0)
        scores[f"{i.label}/{j.label}"] = w[i.label] + v[j.label] - energy
    total = np.logaddexp.reduce(list(scores.values()))
    expected = {label: float(np.exp(score - total)) for label, score in scores.items()}
    # Combinations that end in one optimum are one component: their weights add.
    for c, p in zip(together.components, together.probability_height, strict=True):
        assert p == pytest.approx(sum(expected.pop(x) for x in c.label.split("+")), abs=1e-9)
    assert sum(expected.values()) < 1e-9  # what a bound left out
    assert max(scores, key=scores.get) in together.best.label.split("+")


def _between(asked, i, j):
    """−log ψ of two fixed paths: where both levels are known, nothing else says it."""
    r, d = asked.robot, asked.density
    a, b = (
        timed(p.path, d.times, r.preferred_speed, r.max_acceleration, r.velocity) for p in (i, j)
    )
    return d.exponent * np.sum((a.positions - b.positions) ** 2) / (2 * asked.levels[0].h)


def test_29_what_a_bound_excludes_is_not_solved():
    levels = (Level("mission", 0.2, h=0.1), Level("tactics", 0.2, h=0.1, plans=SIDES))
    mixture = plan(scenario(levels).replace(plans=ABOVE))
    assert any("of 6 combinations left out" in note for note in mixture.warnings)
    assert not any(c.label.endswith("far") for c in mixture.components)


BENT = tuple(
    GivenPlan(label, np.array([[0.0, 0.0], [5.0, 0.0], [5.0, y]]), 1.0)
    for label, y in (("left", 4.0), ("right", -4.0))
)


@pytest.mark.parametrize("time", [None, 9.5])
@pytest.mark.parametrize("sigma", [0.0, 0.3])
@pytest.mark.parametrize("above", [(), (Level("mission", 1.0, h=1e6),)], ids=["first", "below"])
def test_29_data_beyond_the_horizon_is_of_the_plan_there_on_every_level(above, sigma, time):
    """Plans that differ beyond the horizon alone: log p(z | i) = log N(z; η_i(t), R + σ²) by hand,
    on the first level as on one with plans of its own. So loose a coupling says nothing."""
    z, R = np.array([4.5, 0.8]), 0.5
    data = (Readings((Reading(time, z, R * np.eye(2)),), "tactics"),)
    tactics = Level("tactics", sigma, h=1e6, plans=BENT if above else ())
    asked = scenario((*above, tactics), data=data)
    asked = asked if above else asked.replace(plans=BENT)
    if sigma == 0:  # what does not bend is told apart by its weight alone
        nobody = believe((), 0.0, 0.03, 0.04, 1.5)
        weighed = reweigh(asked, crossed(asked, hypothesise(asked, nobody)))
        left, right = (h.log_prior for h in weighed)
    else:
        left, right = (c.log_prior + c.log_evidence for c in plan(asked, select=mass).components)
    times, r = np.linspace(0, 15, 15001), asked.robot
    off = []
    for given in BENT:
        path = timed(given.path, times, r.preferred_speed, r.max_acceleration, r.velocity)
        squared = np.sum((path.positions - z) ** 2, axis=1)
        off.append(squared.min() if time is None else squared[np.searchsorted(times, time)])
    expected = 0.5 * (off[1] - off[0]) / (R + sigma**2)
    assert expected > 0.2
    assert left - right == pytest.approx(expected, rel=1e-3)
