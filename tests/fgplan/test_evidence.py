"""Laplace's log evidence against exact integrals and importance sampling."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from factors.coupling import coupling, coupling_to
from factors.gp_prior import gaussian
from factors.interaction import Interaction
from factors.pairwise import CrowdPairs, PredictedPairs
from fgplan import Density, GivenPlan, Level, SecondOrder
from fgplan.assembly import Assembly
from fgplan.model import Variable
from tests.scalar import ROBOT, model, optimum, plan_variable
from tests.scenes import ONE, assembled, dense, forked, initial, mode_evidence, short, track

Array = np.ndarray


def log_evidence(m, start=()) -> float | None:
    return mode_evidence(Assembly([m]), optimum(m, start), 0)


@pytest.mark.parametrize("seed", range(5))
def test_no_potentials_have_evidence_one(seed):
    rng = np.random.default_rng(seed)
    B = rng.normal(size=(3, 3))
    m = model(
        [Variable("robot", 3, ROBOT.key)],
        [(gaussian(rng.normal(size=3), B @ B.T + np.eye(3)), ("robot",))],
    )
    assert log_evidence(m) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_a_fixed_plan_has_the_evidence_of_its_distance(seed):
    """∫ N(x; m, K) exp(−‖x − η‖²/2h) dx = (2πh)^(d/2) N(η; m, K + hI)."""
    rng = np.random.default_rng(seed)
    B, mean, eta = rng.normal(size=(4, 4)), rng.normal(size=4), rng.normal(size=4)
    K, h = B @ B.T + 0.1 * np.eye(4), rng.uniform(0.1, 3)
    m = model(
        [Variable("robot", 4, ROBOT.key)],
        [(gaussian(mean, K), ("robot",)), (coupling_to(eta, h, 4), ("robot",))],
    )
    expected = multivariate_normal(mean, K + h * np.eye(4)).logpdf(eta)
    expected += 0.5 * 4 * np.log(2 * np.pi * h)
    assert log_evidence(m) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_a_random_plan_has_the_evidence_of_both_priors(seed):
    """∫∫ N(η; μ, Σ) ψ(η, x) N(x; m, K) = (2πh)^(1/2) N(μ; m, K + Σ + h), one dimension."""
    rng = np.random.default_rng(seed)
    mu, mean = rng.normal(size=(2, 1))
    K, S, h = rng.uniform(0.1, 3, 3)
    m = model(
        [plan_variable(0), ROBOT],
        [
            (gaussian(mu, [[S]]), ("level 0",)),
            (coupling(h, (1, 1), 1), ("level 0", "robot")),
            (gaussian(mean, [[K]]), ("robot",)),
        ],
    )
    expected = multivariate_normal(mean, K + S + h).logpdf(mu) + 0.5 * np.log(2 * np.pi * h)
    assert log_evidence(m) == pytest.approx(float(expected), abs=1e-9)


def test_a_linear_gaussian_trajectory_has_its_dense_integral():
    """Robot along a fixed plan, no limits: the prior's dense covariance over all steps, an exact
    Gaussian integral against the library's sparse one."""
    density = Density(dt=0.4, horizon=2.4, contact_sigma=np.inf, limit_sigma=np.inf)
    scenario = forked(density=density)
    assembly, hypotheses = assembled(scenario)
    X, which = initial(assembly, hypotheses)
    solution = SecondOrder().solve(assembly, X[:1], which[:1])[0]

    d, h = density, scenario.levels[0].h
    t = d.times[1:]
    # Positions of the WNOA process from a known state: integrated Brownian velocity,
    # cov(p(s), p(t)) = Qc (s² t/2 − s³/6), s ≤ t.
    s, u = np.minimum(t[:, None], t), np.maximum(t[:, None], t)
    K = d.Qc_robot * (s**2 * u / 2 - s**3 / 6)
    expected = 0.0
    for axis in range(2):
        mean = 0.8 * t if axis == 0 else np.zeros_like(t)
        eta = hypotheses[0].plan.positions[1:, axis]
        expected += multivariate_normal(mean, K + h * np.eye(len(t))).logpdf(eta)
        expected += 0.5 * len(t) * np.log(2 * np.pi * h)
    assert mode_evidence(assembly, solution, 0) == pytest.approx(expected, abs=1e-8)


def importance(
    assembly: Assembly, state: Array, which: int, count: int, seed: int, wide: float = 1.3
) -> tuple[float, float]:
    """log Z and its standard error from samples of the Gaussian at the mode, widened."""
    rng = np.random.default_rng(seed)
    q = assembly.expand(state[None], np.array([which]))
    free = np.flatnonzero(assembly.free.ravel())
    H = dense(q.diagonal[0], q.upper[0])[np.ix_(free, free)]
    L = np.linalg.cholesky(H)
    z = rng.standard_normal((count, len(free)))
    move = wide * np.linalg.solve(L.T, z.T).T
    flat = np.zeros((count, state.size))
    flat[:, free] = move
    X = state + flat.reshape(count, *state.shape)
    log_p = assembly.models[which].log_normalizer - assembly.energy(X, np.full(count, which))
    log_q = -0.5 * (z**2).sum(1) - 0.5 * len(free) * np.log(2 * np.pi * wide**2)
    log_q += np.log(np.diag(L)).sum()
    w = log_p - log_q
    log_z = logsumexp(w) - np.log(count)
    share = np.exp(w - w.max())
    return float(log_z), float(share.std() / share.mean() / np.sqrt(count))


@pytest.mark.parametrize("distance", [2.0, 1.2, 0.9])
def test_laplace_agrees_with_importance_sampling_beside_a_person(distance):
    """A robot and a person whose priors are narrow beside h_c: the density is nearly Gaussian,
    with a curvature far from the prior's."""
    person = Variable("crowd", 2, plan_variable(0).key)
    m = model(
        [ROBOT, person],
        [
            (gaussian(np.zeros(1), np.eye(1) * 0.02), ("robot",)),
            (gaussian(np.array([distance, 0.0]), np.diag([0.01, 0.1])), ("crowd",)),
            (CrowdPairs(Interaction(0.99, 0.8), 1, robot_dim=1, space=1), ("robot", "crowd")),
        ],
    )
    solution = optimum(m, (0.0, distance, 0.0))
    log_z, sigma = importance(Assembly([m]), solution.state, 0, 200_000, seed=0)
    value = mode_evidence(Assembly([m]), solution, 0)
    assert sigma < 0.002
    assert value == pytest.approx(log_z, abs=3 * sigma + 0.003)  # what is not Gaussian in it
    assert log_z < -0.03


@pytest.mark.parametrize("crowd", ["joint", "predicted"])
def test_laplace_agrees_with_importance_sampling_on_a_trajectory(crowd):
    """Passing a person at a metre: ψ_int bends the plan; no hinge is near."""
    straight = (GivenPlan("straight", np.array([[0.0, 0.0], [8.0, 0.0]])),)
    scenario = forked(
        track("a", 1.6, 1.0), plans=straight, crowd=crowd,
        density=short(contact_sigma=np.inf, limit_sigma=np.inf, h_c=0.8, Qc_robot=0.1),
        levels=(Level(h=0.05),),
    )  # fmt: skip
    assembly, hypotheses = assembled(scenario)
    X, which = initial(assembly, hypotheses)
    solution = SecondOrder().solve(assembly, X[:1], which[:1])[0]
    log_z, sigma = importance(assembly, solution.state, 0, 40_000, seed=1, wide=1.1)
    assert sigma < 0.05
    value = mode_evidence(assembly, solution, 0)
    # Laplace is good to a few hundredths of a nat here; a wrong determinant or normaliser is
    # off by nats, and the Gauss–Newton Hessian by more than the tolerance.
    assert value == pytest.approx(log_z, abs=3 * sigma + 0.05)
    free = np.flatnonzero(assembly.free.ravel())
    flat = assembly.gauss_newton(solution.state[None], ONE)
    H = dense(flat.diagonal[0], flat.upper[0])[np.ix_(free, free)]
    volume = 0.5 * len(free) * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(H)[1]
    rough = assembly.models[0].log_normalizer - solution.energy + volume
    assert abs(rough - log_z) > abs(value - log_z)


def test_a_saddle_has_no_evidence():
    pairs = PredictedPairs(Interaction(0.99, 1.0), np.zeros((1, 1)), 1)
    m = model([ROBOT], [(gaussian(np.zeros(1), np.eye(1)), ("robot",)), (pairs, ("robot",))])
    assert log_evidence(m, (0.0,)) is None
    assert log_evidence(m, (1.0,)) is not None


def test_two_modes_have_the_sum_of_their_masses():
    # Statement 13: two-mode Laplace 0.305537, truth 0.299964; importance sampling sees the truth.
    pairs = PredictedPairs(Interaction(0.99, 1.0), np.zeros((1, 1)), 1)
    m = model([ROBOT], [(gaussian(np.zeros(1), np.eye(1)), ("robot",)), (pairs, ("robot",))])
    modes = [log_evidence(m, (x,)) for x in (-1.0, 1.0)]
    assert np.exp(np.logaddexp(*modes)) == pytest.approx(0.305537, abs=1e-6)


def test_evidence_does_not_depend_on_the_units_of_a_fixed_state():
    """A state known without error is no random variable: it adds nothing to the dimension."""
    assembly, _ = assembled(forked(density=short()))
    assert assembly.dimension == 4 * 5
