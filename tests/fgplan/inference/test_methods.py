"""What all methods promise: one interface, finite trajectories, the same bits for the same seed."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise

import gtsam
import numpy as np
import pytest

from factors.interaction import Interaction
from factors.pairwise import PredictedPairs
from fgplan import keys, plan, selection
from fgplan.assembly import Assembly
from fgplan.inference import (
    HMC,
    MAP,
    METHODS,
    EllipticalSlice,
    Importance,
    Inference,
    Inferred,
    Laplace,
    probabilities,
)
from fgplan.inference.base import Diagnostics
from fgplan.inference.bridge import bridge
from fgplan.solver import SecondOrder, Solution
from tests.scalar import ROBOT, model, optimum
from tests.scenes import assembled, blocks, forked, initial, short, track

SMALL: list[Inference] = [
    MAP(),
    Laplace(check=200),
    Importance(draws=300, batch=128),
    EllipticalSlice(chains=4, draws=16, warmup=16, thin=1),
    HMC(chains=4, draws=16, warmup=24),
]
IDS = [m.name for m in SMALL]


def scene(**changes: object) -> tuple[Assembly, list[Solution]]:
    """Everything at once: people planned, walls, limits, a state known without error."""
    people = (track("a", 2.0, 0.3, -0.5), track("b", 3.0, -1.0))
    assembly, hypotheses = assembled(
        forked(*people, **{"density": short(horizon=1.6), "grid": blocks(), **changes})
    )
    X, which = initial(assembly, hypotheses)
    solved = SecondOrder().solve(assembly, X[which == 0], which[which == 0])
    return assembly, [s for s in solved if s.converged]


@pytest.mark.parametrize("method", SMALL, ids=IDS)
def test_every_trajectory_is_finite_and_keeps_the_state_now(method):
    assembly, optima = scene()
    result = method.infer(assembly, 0, optima)
    m = assembly.models[0]
    assert np.isfinite(result.states).all()
    assert result.weights.sum() == pytest.approx(1)
    now = result.states[:, 0, m.columns["robot"]]
    np.testing.assert_array_equal(now, np.broadcast_to(m.fixed["robot", 0], now.shape))
    which = np.zeros(len(result.states), dtype=int)
    np.testing.assert_allclose(
        assembly.energy(result.states, which), result.energies, rtol=1e-8, atol=1e-6
    )
    assert np.shape(result.covariance) == (result.mean.size, result.mean.size)
    assert len(result.trajectories()) == len(result.states)
    for name, column in (("robot", m.columns["robot"].start), ("b", m.columns["crowd"].start + 2)):
        first = result.trajectories(name)[0]
        np.testing.assert_array_equal(first.positions, result.states[0, :, column : column + 2])
    assert np.isfinite(result.resampled(7)).all()
    json.dumps(result.to_dict(), allow_nan=False)


@pytest.mark.parametrize("method", SMALL, ids=IDS)
def test_the_same_seed_gives_the_same_bits_and_another_does_not(method):
    assembly, optima = scene()
    one, same, other = (method.infer(assembly, 0, optima, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.states, same.states)
    np.testing.assert_array_equal(one.weights, same.weights)
    assert one.to_dict() == same.to_dict()
    if method.name not in ("map", "laplace"):
        assert not np.array_equal(one.states, other.states)


@pytest.mark.parametrize("method", SMALL[2:], ids=IDS[2:])
def test_progress_goes_up_to_the_end(method):
    assembly, optima = scene()
    told: list[tuple[str, int, int]] = []
    method.infer(assembly, 0, optima, 0, lambda *step: told.append(step))
    done = [d for _, d, _ in told]
    assert all(a < b for a, b in pairwise(done))
    assert told[-1][0] == method.name
    assert told[-1][1] == told[-1][2]


@pytest.mark.parametrize("method", SMALL, ids=IDS)
def test_users_factors_between_far_steps_are_sampled_too(method):
    far = gtsam.BetweenFactorVector(
        keys.robot(0), keys.robot(4), np.array([1.0, 0.2, 0, 0]), gtsam.noiseModel.Unit.Create(4)
    )
    scenario = forked(density=short(horizon=1.6))
    assembly, hypotheses = assembled(scenario, [far])
    X, which = initial(assembly, hypotheses)
    found = SecondOrder().solve(assembly, X[:1], which[:1])
    assert np.isfinite(method.infer(assembly, 0, found).states).all()


@pytest.mark.parametrize(
    "make",
    [
        lambda: Laplace(check=-1),
        lambda: Laplace(modes="some"),  # type: ignore[arg-type]
        lambda: Importance(draws=1),
        lambda: Importance(defensive=0),
        lambda: EllipticalSlice(chains=1),
        lambda: HMC(draws=2),
        lambda: HMC(target=1.0),
        lambda: HMC(jump_every=-2),
        lambda: EllipticalSlice(jump_every=-1),
        lambda: EllipticalSlice(reference="priors"),  # type: ignore[arg-type]
        lambda: Importance(source="lapalce"),  # type: ignore[arg-type]
    ],
)
def test_settings_out_of_range_are_refused(make):
    with pytest.raises(ValueError, match="got"):
        make()


def test_map_names_the_modes_it_leaves_out_and_has_no_evidence():
    assembly, optima = scene()
    result = MAP().infer(assembly, 0, [optima[0], replace(optima[0], energy=1e3)])
    assert result.warnings == ("one mode of 2",)
    assert result.log_evidence is None
    np.testing.assert_array_equal(result.best, optima[0].state)


def test_a_trajectory_that_is_not_there_is_said():
    assembly, optima = scene()
    result = MAP().infer(assembly, 0, optima)
    with pytest.raises(ValueError, match=r"'c' is none of \['robot', 'a', 'b'\]"):
        result.trajectories("c")
    with pytest.raises(ValueError, match="without the density"):
        result_of(0.0, 0.1).trajectories()


def test_a_saddle_has_no_laplace_evidence_but_can_be_sampled_from():
    psi = PredictedPairs(Interaction(0.99, 1.0), np.zeros((1, 1)), robot_dim=1)
    from factors.gp_prior import gaussian

    m = model([ROBOT], [(gaussian(np.zeros(1), np.eye(1)), ("robot",)), (psi, ("robot",))])
    assembly, stuck = Assembly([m]), optimum(m, [0.0])
    result = Laplace().infer(assembly, 0, [stuck])
    assert result.log_evidence is None
    assert "its Hessian is not positive definite" in result.warnings
    sampled = Importance(draws=20_000).infer(assembly, 0, [stuck])
    assert sampled.log_evidence == pytest.approx(
        np.log(0.299964), abs=4 * sampled.log_evidence_error
    )
    assert "more probable than every optimum found" in sampled.warnings[-1]


def test_too_few_effective_samples_are_flagged_and_have_no_error():
    # Limits that the prior knows nothing of: one sample in thousands is possible at all.
    assembly, optima = scene()
    result = Importance(draws=500, source="prior").infer(assembly, 0, optima)
    assert result.diagnostics.ess < 10
    assert result.warnings[0].startswith("effective sample size")
    assert result.log_evidence_error is None


def test_chains_that_never_change_modes_are_flagged():
    """A person so wide that no path gets past, and no jumps."""
    psi = PredictedPairs(Interaction(1 - 1e-16, 0.3), np.zeros((1, 1)), robot_dim=1)
    from factors.gp_prior import gaussian

    m = model([ROBOT], [(gaussian(np.zeros(1), 0.05 * np.eye(1)), ("robot",)), (psi, ("robot",))])
    optima = [optimum(m, [x]) for x in (0.6, -0.6)]
    result = HMC(chains=4, draws=50, warmup=50, jump_every=0).infer(Assembly([m]), 0, optima)
    assert any("mixed" in w for w in result.warnings)
    assert any("from one of 2 modes" in w for w in result.warnings)


def test_bridge_between_two_gaussians():
    """p = 3 N(0, 1), q = N(0.5, 1.2²): log Z = log 3."""
    rng = np.random.default_rng(0)

    def log_ratio(x):
        log_q = -0.5 * ((x - 0.5) / 1.2) ** 2 - np.log(1.2)
        return np.log(3) - 0.5 * x**2 - log_q

    runs = [
        bridge(log_ratio(rng.normal(size=(4, 500))), log_ratio(rng.normal(0.5, 1.2, 2000)))
        for _ in range(40)
    ]
    off = np.array([r.log_z for r in runs]) - np.log(3)
    claimed = np.mean([r.error for r in runs])
    assert abs(off.mean()) < 4 * claimed / np.sqrt(40)
    assert off.std() == pytest.approx(claimed, rel=0.4)


def result_of(log_evidence: float | None, error: float | None) -> Inferred:
    return Inferred("x", np.zeros((1, 1, 1)), np.ones(1), np.zeros(1), log_evidence, error,
                    Diagnostics(1))  # fmt: skip


def test_probabilities_of_two_hypotheses_and_their_errors():
    """p = 1/(1 + e^−Δ), dp/dΔ = p (1 − p)."""
    p, error = probabilities(np.log([0.7, 0.3]), [result_of(0.0, 0.1), result_of(1.0, 0.2)])
    expected = 0.7 / (0.7 + 0.3 * np.e)
    assert p[0] == pytest.approx(expected)
    np.testing.assert_allclose(error, expected * (1 - expected) * np.hypot(0.1, 0.2))


def test_probabilities_without_evidence_or_without_an_error():
    p, error = probabilities([0.0, 0.0], [result_of(None, None), result_of(2.0, 0.1)])
    np.testing.assert_array_equal(p, [0, 1])
    np.testing.assert_array_equal(error, [0, 0])
    p, error = probabilities([0.0, 0.0], [result_of(2.0, None), result_of(2.0, 0.1)])
    assert np.isinf(error).all()
    p, error = probabilities([0.0], [result_of(None, None)])
    np.testing.assert_array_equal(p, [0])


def test_a_method_may_be_named():
    scenario = forked(track("a", 3.0, 0.6), crowd="predicted", density=short())
    by_name = plan(scenario, inference="importance", seed=3)
    by_object = plan(scenario, inference=Importance(), seed=3)
    assert list(METHODS) == ["map", "laplace", "importance", "mcmc", "hmc"]
    for one, two in zip(by_name.components, by_object.components, strict=True):
        assert one.inferred.method == "importance"
        assert one.log_evidence == two.log_evidence
    with pytest.raises(ValueError, match="one of map, laplace, importance, mcmc, hmc, got 'nuts'"):
        plan(scenario, inference="nuts")


def test_plan_weighs_hypotheses_by_the_method_it_is_given():
    density = short(contact_sigma=np.inf, limit_sigma=np.inf)
    scenario = forked(track("a", 3.0, 0.6), crowd="predicted", density=density)
    default = plan(scenario)
    method = HMC(chains=4, draws=60, warmup=60)
    told: list[str] = []
    by_hmc = plan(scenario, inference=method, seed=5, select=selection.mass,
                  progress=lambda what, *_: told.append(what))  # fmt: skip
    again = plan(scenario, inference=method, seed=5)
    assert {"left: hmc", "right: hmc"} == set(told)
    for c in by_hmc.components:
        before = next(d for d in default.components if d.label == c.label)
        np.testing.assert_array_equal(c.robot.states, before.robot.states)
        assert c.log_evidence == c.inferred.log_evidence != before.log_evidence
        same = next(d for d in again.components if d.label == c.label)
        assert c.log_evidence == same.log_evidence
    listed = by_hmc.to_dict()["hypotheses"][0]["inference"]
    assert listed["method"] == "hmc"
    assert listed["log_evidence_error"] > 0
    log_z = [c.log_evidence for c in by_hmc.components]
    log_w = [c.log_prior for c in by_hmc.components]
    expected = np.exp(np.add(log_w, log_z) - np.logaddexp.reduce(np.add(log_w, log_z)))
    np.testing.assert_allclose(by_hmc.probability_mass, expected)
    assert any("hmc: chains have not mixed" in w for w in by_hmc.warnings)
