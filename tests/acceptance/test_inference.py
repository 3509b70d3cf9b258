"""Statements 17 and 18: inference, on the library's own factors."""

from __future__ import annotations

import numpy as np
import pytest

from factors.coupling import coupling_to
from factors.gp_prior import gaussian
from factors.interaction import Interaction
from factors.pairwise import PredictedPairs
from fgplan import Density, GivenPlan, Level, OccupancyGrid
from fgplan.assembly import Assembly
from fgplan.inference import HMC, EllipticalSlice, Importance, Laplace, probabilities
from fgplan.solver import SecondOrder, Solution
from tests.scalar import ROBOT, model, optimum
from tests.scenes import assembled, forked, initial, random_scene

SAMPLERS = [
    Importance(draws=20000),
    Importance(draws=20000, source="prior"),
    EllipticalSlice(draws=500, warmup=100, thin=2),
    EllipticalSlice(draws=400, warmup=50, reference="prior", jump_every=0),
    HMC(draws=600, warmup=150),
]
NAMES = ["importance", "from the prior", "mcmc", "mcmc against the prior", "hmc"]


def one_plan(h: float, eta: float) -> Assembly:
    """f^R ~ N(0, 1) and a fixed plan at eta."""
    return Assembly(
        [
            model(
                [ROBOT],
                [(gaussian(np.zeros(1), np.eye(1)), ("robot",))],
                [(coupling_to(np.array([eta]), h, 1), ("robot",))],
            )
        ]
    )


def test_17_the_sample_of_the_largest_density_and_the_weighted_mean():
    assembly = one_plan(h=1.0, eta=1.0)
    found = optimum(assembly.models[0])
    result = Importance(draws=100_000, source="prior").infer(assembly, 0, [found])
    x = result.states[:, 0, 0]
    assert result.best[0, 0] == pytest.approx(0.5, abs=1e-3)
    psi = np.exp(-0.5 * (1 - x) ** 2)
    np.testing.assert_allclose(result.weights, psi / psi.sum(), rtol=1e-9)
    assert result.mean[0, 0] == pytest.approx(0.5, abs=0.01)
    # What weights ψ·p would say: the density a second time.
    twice = result.weights * np.exp(-0.5 * x**2)
    assert np.average(x, weights=twice) == pytest.approx(1 / 3, abs=0.01)


@pytest.mark.parametrize("eta", [0.0, 1.0, 2.0])
@pytest.mark.parametrize("h", [0.01, 0.1, 1.0, 10.0])
def test_17_effective_sample_size_has_its_closed_form(h, eta):
    assembly = one_plan(h, eta)
    found = optimum(assembly.models[0])
    N = 20_000
    sizes = [
        Importance(draws=N, source="prior").infer(assembly, 0, [found], seed).diagnostics.ess / N
        for seed in range(8)
    ]
    first = np.sqrt(h / (1 + h)) * np.exp(-(eta**2) / (2 * (1 + h)))
    second = np.sqrt(h / (2 + h)) * np.exp(-(eta**2) / (2 + h))
    error = np.std(sizes, ddof=1) / np.sqrt(len(sizes))
    assert np.mean(sizes) == pytest.approx(first**2 / second, abs=4 * error, rel=0)


def trajectory_case() -> tuple[Assembly, list[Solution]]:
    """A robot along a fixed plan, no people and no limits: linear-Gaussian, 12 coordinates."""
    density = Density(horizon=1.2, contact_sigma=np.inf, limit_sigma=np.inf)
    assembly, hypotheses = assembled(forked(density=density, levels=(Level(h=0.5),)))
    X, which = initial(assembly, hypotheses)
    return assembly, [SecondOrder().solve(assembly, X[:1], which[:1])[0]]


def scalar_case() -> tuple[Assembly, list[Solution]]:
    assembly = one_plan(h=1.0, eta=1.0)
    return assembly, [optimum(assembly.models[0])]


@pytest.mark.parametrize("case", [scalar_case, trajectory_case], ids=["scalar", "trajectory"])
@pytest.mark.parametrize("method", SAMPLERS, ids=NAMES)
def test_18_all_agree_where_the_density_is_linear_gaussian(method, case):
    """Within 4 standard errors, of which there are many: 12 means and 78 covariances."""
    assembly, optima = case()
    exact = Laplace(check=0).infer(assembly, 0, optima)
    got = method.infer(assembly, 0, optima, seed=1)
    sd = np.sqrt(np.diag(exact.covariance))
    free = sd > 0
    n = got.diagnostics.ess
    assert n > 400
    z = (got.mean - exact.mean).ravel()[free] / sd[free] * np.sqrt(n)
    assert np.abs(z).max() < 4
    scale = np.outer(sd, sd)[np.ix_(free, free)]
    off = (got.covariance - exact.covariance)[np.ix_(free, free)] / scale
    assert np.abs(off).max() < 4 * np.sqrt(2 / n)
    # Where the proposal is the density itself there is no error but rounding.
    error = max(got.log_evidence_error, 1e-9)
    assert got.log_evidence == pytest.approx(exact.log_evidence, abs=4 * error)
    assert not [w for w in got.warnings if "mixed" not in w]


def person_at_the_mean() -> tuple[Assembly, list[Solution]]:
    """One dimension, a person held at the robot's own mean: two modes."""
    psi = PredictedPairs(Interaction(0.99, 1.0), np.zeros((1, 1)), robot_dim=1)
    m = model([ROBOT], [(gaussian(np.zeros(1), np.eye(1)), ("robot",)), (psi, ("robot",))])
    return Assembly([m]), [optimum(m, [x]) for x in (1.0, -1.0)]


@pytest.mark.parametrize(
    "method", [SAMPLERS[0], SAMPLERS[1], SAMPLERS[2], HMC()], ids=["is", "prior", "mcmc", "hmc"]
)
def test_18_both_sides_of_the_person_get_half_of_the_mass(method):
    assembly, optima = person_at_the_mean()
    result = method.infer(assembly, 0, optima)
    left = result.weights[result.states[:, 0, 0] < 0].sum()
    assert left == pytest.approx(0.5, abs=0.02)
    assert result.log_evidence == pytest.approx(np.log(0.299964), abs=4 * result.log_evidence_error)
    assert result.warnings == ()


def test_18_without_jumps_hmc_says_that_it_has_not_mixed():
    """Paths alone seldom carry enough energy over 3.2 nats in one dimension."""
    assembly, optima = person_at_the_mean()
    result = HMC(draws=300, warmup=100, jump_every=0).infer(assembly, 0, optima)
    assert any("have not mixed" in w for w in result.warnings)


def test_18_one_mode_of_two_is_flagged():
    # Seen to fail with the check and the count of modes taken out of Laplace.
    assembly, optima = person_at_the_mean()
    both = Laplace().infer(assembly, 0, optima)
    assert np.exp(both.log_evidence) == pytest.approx(0.305537, abs=1e-6)
    assert both.warnings == ()
    best = Laplace(modes="best").infer(assembly, 0, optima)
    assert "one mode of 2" in best.warnings
    # And where the solver found one only, the draws of the check see the other side.
    assert Laplace().infer(assembly, 0, optima[:1]).warnings


def smooth(seed: int, **changes: object) -> tuple[Assembly, list[list[Solution]], list[float]]:
    """A fork, two people held at their prediction, ψ_int only: the paper's model."""
    density = Density(horizon=2.4, contact_sigma=np.inf, limit_sigma=np.inf, Qc_robot=0.3)
    scene = random_scene(seed, 2, crowd="predicted", levels=(Level(h=0.2),)).replace(
        **{"density": density, **changes}
    )
    assembly, hypotheses = assembled(scene)
    X, which = initial(assembly, hypotheses)
    solved = SecondOrder(meeting=0.0, patience=np.inf).solve(assembly, X, which)
    optima = []
    for i in range(len(hypotheses)):
        own: list[Solution] = []
        for s in sorted((s for s, w in zip(solved, which, strict=True) if w == i),
                        key=lambda s: s.energy):  # fmt: skip
            if s.converged and all(np.abs(s.state - o.state).max() > 0.02 for o in own):
                own.append(s)
        optima.append(own)
    return assembly, optima, [h.log_prior for h in hypotheses]


ONLY_LIMITS = Density(horizon=2.4, contact_sigma=np.inf)
"""The paper's model and the default limits of speed and acceleration."""


@pytest.mark.parametrize("density", [None, ONLY_LIMITS], ids=["no limits", "default limits"])
def test_hypotheses_get_one_probability_by_laplace_and_by_sampling_where_laplace_is_quiet(density):
    # Seen to fail under the default limits when they are seen by their curvature alone.
    quiet, worst = 0, 0.0
    sampler = Importance(draws=8192, source="linear" if density is None else "laplace")
    for seed in range(24):
        assembly, optima, log_prior = smooth(seed, **({"density": density} if density else {}))
        by_laplace = [Laplace().infer(assembly, i, o, (seed, i)) for i, o in enumerate(optima)]
        if any(r.warnings for r in by_laplace):
            continue
        quiet += 1
        sampled = [sampler.infer(assembly, i, o, (seed, i, 1)) for i, o in enumerate(optima)]
        assert not any(r.warnings for r in sampled)
        p, p_error = probabilities(log_prior, by_laplace)
        q, q_error = probabilities(log_prior, sampled)
        worst = max(worst, float(np.max(np.abs(p - q) / np.hypot(p_error, q_error))))
    assert quiet >= 20
    assert worst < 3


def test_where_laplace_warns_sampling_shows_why_a_limit():
    """A limit that the optimum only just keeps: half of the curvature's Gaussian is beyond it."""
    assembly, optima, _ = smooth(0, density=Density(horizon=1.2, contact_sigma=np.inf))
    by_curvature = Laplace(limits="curvature").infer(assembly, 0, optima[0])
    assert by_curvature.warnings
    drawn = Importance(draws=60_000, source="linear").infer(assembly, 0, optima[0])
    chains = HMC(draws=300, warmup=150).infer(assembly, 0, optima[0])
    error = np.hypot(drawn.log_evidence_error, chains.log_evidence_error)
    assert error < 0.1
    assert drawn.log_evidence == pytest.approx(chains.log_evidence, abs=4 * error)
    assert by_curvature.log_evidence > chains.log_evidence + 1
    propagated = Laplace().infer(assembly, 0, optima[0])
    assert propagated.warnings == ()
    assert propagated.log_evidence == pytest.approx(chains.log_evidence, abs=0.2)


def test_where_laplace_warns_sampling_shows_why_a_wall():
    """Close to a wall the Hessian takes its hinge for two-sided, or for none: chains find most of
    the mass where the optimum's Gaussian hardly is."""
    wall = OccupancyGrid.from_polygons(
        [np.array([[0.0, -0.6], [9.0, -0.6], [9.0, -0.35], [0.0, -0.35]])], (-2, -4, 10, 4), 0.1
    )
    ways = (GivenPlan("on", np.array([[0.0, 0.0], [9.0, 0.0]])),)
    assembly, optima, _ = smooth(0, density=ONLY_LIMITS, grid=wall, plans=ways, tracks=())
    by_laplace = Laplace().infer(assembly, 0, optima[0])
    assert by_laplace.warnings
    chains = HMC(draws=300, warmup=200).infer(assembly, 0, optima[0])
    assert chains.log_evidence_error < 0.1
    assert abs(by_laplace.log_evidence - chains.log_evidence) > 1
    y = assembly.models[0].columns["robot"].start + 1
    spread = np.sqrt(np.diag(chains.covariance)).reshape(chains.mean.shape)[-1, y]
    assert abs(chains.mean[-1, y] - by_laplace.best[-1, y]) > 0.5 * spread
