"""Two solvers against each other, dense linear algebra and physics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import gtsam
import numpy as np
import pytest

from factors.gp_prior import gaussian
from factors.interaction import Interaction
from factors.pairwise import PredictedPairs
from fgplan import Density, FgplanError, GivenPlan, GtsamLM, Level, SecondOrder, keys, plan
from fgplan.assembly import Assembly
from fgplan.inference.gaussian import at_mode
from fgplan.solver import Stop
from tests.scalar import ROBOT, model
from tests.scenes import (
    CORRIDOR,
    ONE,
    STACK,
    assembled,
    believed,
    dense,
    fork,
    forked,
    initial,
    random_scene,
    short,
    track,
)

SOLVERS = [SecondOrder(meeting=0.0, patience=np.inf), GtsamLM()]
NAMES = ["second order", "gtsam"]

VARIANTS = {
    "joint": {},
    "predicted": {"crowd": "predicted"},
    "random level": {"levels": (CORRIDOR,)},
    "two levels": {"levels": STACK},
}


@pytest.mark.parametrize("grid", [False, True], ids=["open", "map"])
@pytest.mark.parametrize("people", range(5))
@pytest.mark.parametrize("variant", VARIANTS)
def test_both_solvers_agree_where_they_end_in_one_optimum(variant, people, grid):
    scenario = random_scene(10 * people + grid, people, grid, **VARIANTS[variant])
    assembly, hypotheses = assembled(scenario)
    X, which = initial(assembly, hypotheses)
    X, which = X[:2], which[:2]
    ours = SecondOrder(meeting=0.0, patience=np.inf).solve(assembly, X, which)
    theirs = GtsamLM().solve(assembly, X, which)
    same = 0
    for one, other in zip(ours, theirs, strict=True):
        assert one.stop is Stop.CONVERGED
        if np.abs(one.state - other.state).max() < 1e-2:
            assert one.energy == pytest.approx(other.energy, abs=1e-6)
            same += 1
    assert same >= 1


@pytest.mark.parametrize("seed", range(5))
def test_where_they_end_differs_from_gtsam_only_by_the_optimum(seed):
    """Each one's optimum is a fixed point of the other."""
    assembly, hypotheses = assembled(random_scene(seed, 3, True))
    X, which = initial(assembly, hypotheses)
    for one, other in (SOLVERS, SOLVERS[::-1]):
        found = one.solve(assembly, X[:1], which[:1])[0]
        again = other.solve(assembly, found.state[None], which[:1])[0]
        assert again.energy == pytest.approx(found.energy, abs=1e-6)
        np.testing.assert_allclose(again.state, found.state, atol=1e-3)


def linear_scene(seed: int, **changes: object) -> tuple[Assembly, np.ndarray]:
    """No people, no limits, no map: everything is Gaussian; and a random start."""
    density = Density(contact_sigma=np.inf, obstacle_sigma=np.inf, limit_sigma=np.inf)
    assembly, hypotheses = assembled(forked(**{"density": density, **changes}))
    X, _ = initial(assembly, hypotheses)
    noise = np.random.default_rng(seed).standard_normal(X[0].shape)
    return assembly, X[:1] + np.where(assembly.free, noise, 0.0)


def dense_optimum(assembly: Assembly, state: np.ndarray) -> np.ndarray:
    """Least squares on the stacked Jacobian that GTSAM gives for the graph at a state (S, D)."""
    m = assembly.models[0]
    linear = replace(m, fixed={}).graph().linearize(m.values(state))
    ordering = gtsam.Ordering()
    for k in range(len(m.times)):
        for variable in m.variables:
            ordering.push_back(variable.key(k))
    A, b = linear.jacobian(ordering)
    free = np.flatnonzero(assembly.free.ravel())
    step = np.zeros(state.size)
    step[free] = np.linalg.lstsq(A[:, free], b, rcond=None)[0]
    return np.asarray(state + step.reshape(state.shape))


@pytest.mark.parametrize(
    "changes",
    [{}, {"levels": (CORRIDOR,)}, {"levels": STACK}, {"plans": ()}],
    ids=["fixed plan", "random level", "two levels", "no goal"],
)
def test_a_linear_gaussian_density_takes_one_newton_step(changes):
    assembly, X = linear_scene(1, **changes)
    expected = dense_optimum(assembly, X[0])
    once = SecondOrder(max_iterations=1).solve(assembly, X, ONE)[0]
    np.testing.assert_allclose(once.state, expected, atol=1e-8)
    found = SecondOrder().solve(assembly, X, ONE)[0]
    assert found.stop is Stop.CONVERGED
    assert found.iterations == 2  # the second one finds nothing left to gain
    np.testing.assert_allclose(found.state, expected, atol=1e-8)


@pytest.mark.parametrize("solver", SOLVERS, ids=NAMES)
def test_linear_gaussian_people_are_at_their_prediction(solver):
    """With alpha = 0 and no contact the people's optimum is the Kalman prediction."""
    scenario = random_scene(3, 2, density=Density(alpha=0.0, contact_sigma=np.inf))
    assembly, hypotheses = assembled(scenario)
    X, which = initial(assembly, hypotheses)
    X = X + np.where(assembly.free, np.random.default_rng(0).standard_normal(X.shape), 0.0)
    found = solver.solve(assembly, X[:1], which[:1])[0]
    m = assembly.models[0]
    crowd = found.state[:, m.columns["crowd"]]
    mean, _ = believed(scenario).predict(m.times)
    np.testing.assert_allclose(crowd[:, :4].reshape(-1, 2, 2), mean[..., :2], atol=1e-5)
    np.testing.assert_allclose(crowd[:, 4:].reshape(-1, 2, 2), mean[..., 2:], atol=1e-5)


@pytest.mark.parametrize("solver", SOLVERS, ids=NAMES)
def test_a_start_on_a_person_with_alpha_1_is_not_finite(solver):
    scenario = forked(
        track("a", 2.0, 0.0), crowd="predicted", density=Density(alpha=1.0, contact_sigma=np.inf)
    )
    assembly, hypotheses = assembled(scenario)
    X, which = initial(assembly, hypotheses)
    X[0, 3, :2] = believed(scenario).predict(scenario.density.times)[0][3, 0, :2]
    found = solver.solve(assembly, X[:2], which[:2])
    assert found[0].stop is Stop.NOT_FINITE
    assert not found[0].converged
    assert found[0].energy == np.inf
    np.testing.assert_array_equal(found[0].state, X[0])
    assert found[1].converged  # one bad start spoils nothing


@pytest.mark.parametrize(
    "solver",
    [SecondOrder(max_iterations=1, meeting=0.0, patience=np.inf), GtsamLM(max_iterations=1)],
)
def test_too_few_iterations_are_named(solver):
    assembly, hypotheses = assembled(random_scene(2, 3))
    X, which = initial(assembly, hypotheses)
    found = solver.solve(assembly, X[:1], which[:1])[0]
    assert found.stop is Stop.ITERATIONS
    assert not found.converged
    assert found.iterations == 1


@pytest.mark.parametrize("solver", SOLVERS, ids=NAMES)
def test_a_person_at_the_mean_is_a_saddle(solver):
    # Seen to be called converged with α below h_c²/(K + h_c²) = 1/2, where it is the optimum.
    def found(alpha: float):
        pairs = PredictedPairs(Interaction(alpha, 1.0), np.zeros((1, 1)), 1)
        m = model([ROBOT], [(gaussian(np.zeros(1), np.eye(1)), ("robot",)), (pairs, ("robot",))])
        return solver.solve(Assembly([m]), np.zeros((1, 1, 1)), ONE)[0]

    assert found(0.99).stop is Stop.SADDLE
    assert found(0.49).stop is Stop.CONVERGED


@pytest.mark.parametrize("solver", SOLVERS, ids=NAMES)
def test_a_person_right_ahead_is_a_saddle_for_the_straight_start(solver):
    straight = (GivenPlan("straight", np.array([[0.0, 0.0], [8.0, 0.0]])),)
    assembly, hypotheses = assembled(forked(track("a", 3.0, 0.0), plans=straight))
    X, which = initial(assembly, hypotheses)
    labels = [start.label for start in hypotheses[0].starts]
    found = dict(zip(labels, solver.solve(assembly, X, which), strict=True))
    assert found["plan"].stop is Stop.SADDLE
    left, right = found["left of a"], found["right of a"]
    assert left.converged
    assert right.converged
    assert left.energy == pytest.approx(right.energy, abs=1e-6)
    assert left.energy < found["plan"].energy
    robot = assembly.models[0].columns["robot"]
    mirror = np.array([1.0, -1.0, 1.0, -1.0])
    np.testing.assert_allclose(left.state[:, robot], right.state[:, robot] * mirror, atol=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_the_energy_never_rises(seed):
    assembly, hypotheses = assembled(random_scene(seed, 4, True))
    X, which = initial(assembly, hypotheses)
    X = X + np.where(assembly.free, 0.3 * np.random.default_rng(seed).normal(size=X.shape), 0.0)
    before = assembly.energy(X, which)
    for limit in range(1, 16):
        found = SecondOrder(max_iterations=limit, meeting=0.0, patience=np.inf).solve(
            assembly, X, which
        )
        energy = np.array([s.energy for s in found])
        assert np.all(energy <= before + 1e-9)  # rounding of sums of terms of the order 1e4
        states = np.stack([s.state for s in found])
        np.testing.assert_allclose(assembly.energy(states, which), energy, rtol=1e-12)
        before = energy


@pytest.mark.parametrize("seed", range(4))
def test_at_an_optimum_no_small_step_is_better(seed):
    assembly, hypotheses = assembled(random_scene(seed, 3))
    X, which = initial(assembly, hypotheses)
    found = SecondOrder(meeting=0.0, patience=np.inf).solve(assembly, X[:1], which[:1])[0]
    assert at_mode(assembly, found.state, 0) is not None
    rng = np.random.default_rng(seed)
    steps = np.where(assembly.free, rng.standard_normal((300, *found.state.shape)), 0.0)
    steps *= 10 ** rng.uniform(-5, -1, 300)[:, None, None]
    around = assembly.energy(found.state + steps, np.zeros(300, dtype=int))
    assert np.all(around >= found.energy - 1e-9)


@pytest.mark.parametrize("solver", SOLVERS, ids=NAMES)
def test_a_state_known_without_error_stays(solver):
    assembly, hypotheses = assembled(random_scene(4, 2))
    X, which = initial(assembly, hypotheses)
    found = solver.solve(assembly, X[:1], which[:1])[0]
    robot = assembly.models[0].columns["robot"]
    np.testing.assert_allclose(found.state[0, robot], [0.0, 0.0, 0.8, 0.0], atol=1e-9)


def test_a_batch_ends_where_its_members_end_alone():
    assembly, hypotheses = assembled(random_scene(5, 3, True))
    X, which = initial(assembly, hypotheses)
    together = SecondOrder(meeting=0.0, patience=np.inf).solve(assembly, X, which)
    for b, found in enumerate(together):
        alone = SecondOrder(meeting=0.0, patience=np.inf).solve(
            assembly, X[b : b + 1], which[b : b + 1]
        )[0]
        assert alone.stop is found.stop
        assert alone.iterations == found.iterations
        assert alone.energy == pytest.approx(found.energy, abs=1e-9)
        np.testing.assert_allclose(alone.state, found.state, atol=1e-6)


def test_no_starts_give_no_solutions():
    assembly, hypotheses = assembled(random_scene(5, 1))
    X, which = initial(assembly, hypotheses)
    assert SecondOrder(meeting=0.0, patience=np.inf).solve(assembly, X[:0], which[:0]) == ()
    assert GtsamLM().solve(assembly, X[:0], which[:0]) == ()


def long_chain(steps: int, **changes: object) -> tuple[Assembly, np.ndarray]:
    """States every 0.1 s, held by the first one alone, and a start off the optimum."""
    density = Density(dt=0.1, horizon=0.1 * steps, limit_sigma=np.inf)
    assembly, hypotheses = assembled(forked(**{"plans": (), "density": density, **changes}))
    X, _ = initial(assembly, hypotheses)
    noise = 0.1 * np.random.default_rng(0).standard_normal(X[:1].shape)
    return assembly, X[:1] + np.where(assembly.free, noise, 0.0)


@pytest.mark.parametrize("steps", [300, 1000, 2000])
def test_a_long_chain_held_at_its_start_is_solved(steps):
    """GTSAM's note is that such a chain breaks Cholesky; in our band it does not."""
    assembly, X = long_chain(steps)
    found = SecondOrder(meeting=0.0, patience=np.inf).solve(assembly, X, ONE)[0]
    assert found.converged
    assert found.iterations == 2  # the warm-up's one, and one Newton step that finds nothing
    t = assembly.models[0].times
    np.testing.assert_allclose(found.state[:, 0], 0.8 * t, atol=1e-6)
    np.testing.assert_allclose(found.state[:, 2], 0.8, atol=1e-8)
    np.testing.assert_allclose(found.state[:, [1, 3]], 0.0, atol=1e-6)


def test_gtsam_solves_a_long_chain_in_many_small_steps():
    """Levenberg–Marquardt's damping makes its Cholesky safe and its steps short: it is within a
    billionth of a nat of the optimum after some fifty steps, where one would do."""
    assembly, X = long_chain(300)
    found = GtsamLM().solve(assembly, X, ONE)[0]
    assert found.stop in (Stop.CONVERGED, Stop.ITERATIONS)
    assert found.energy < 1e-9


@pytest.mark.parametrize("steps", [300, 600])
def test_both_solvers_agree_on_a_long_chain_with_a_plan(steps):
    assembly, X = long_chain(steps, plans=fork())
    ours, theirs = (solver.solve(assembly, X, ONE)[0] for solver in SOLVERS)
    assert ours.converged
    assert theirs.converged
    assert ours.energy == pytest.approx(theirs.energy, abs=1e-9)
    np.testing.assert_allclose(ours.state, theirs.state, atol=1e-5)


def test_a_long_loosely_coupled_chain_matches_dense_least_squares():
    density = Density(dt=0.1, horizon=30.0, limit_sigma=np.inf)
    assembly, X = linear_scene(2, density=density, levels=(Level(h=1e4),))
    found = SecondOrder(meeting=0.0, patience=np.inf).solve(assembly, X, ONE)[0]
    expected = dense_optimum(assembly, X[0])
    assert found.converged
    # Dense QR itself is good to 1e-6 m at 30 s, where the prior alone is 130 m wide.
    np.testing.assert_allclose(found.state, expected, atol=1e-5)
    assert found.energy == pytest.approx(assembly.energy(expected[None], ONE)[0], abs=1e-8)


def broken(error: float, slope: float) -> gtsam.NonlinearFactor:
    """A user's callback that gives no numbers, in its error or in its Jacobian."""

    def evaluate(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: object) -> np.ndarray:
        if jacobians is not None:
            jacobians[0] = np.full((1, 4), slope, order="F")
        return np.array([error])

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(1), [keys.robot(3)], evaluate)


def cliff() -> gtsam.NonlinearFactor:
    """A user's callback with a square root of something that turns negative on the way."""

    def evaluate(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: object) -> np.ndarray:
        x = values.atVector(keys.robot(3))[0]
        root = np.sqrt(1.05 - x) if x <= 1.05 else np.nan
        if jacobians is not None:
            slope = -5 / root if root > 0 else np.nan
            jacobians[0] = np.array([[slope, 0, 0, 0]], order="F")
        return np.array([10 * root])

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(1), [keys.robot(3)], evaluate)


BROKEN: dict[str, Callable[[], gtsam.NonlinearFactor]] = {
    "error": lambda: broken(np.nan, 1.0),
    "infinite error": lambda: broken(np.inf, 1.0),
    "Jacobian": lambda: broken(1.0, np.nan),
    "infinite Jacobian": lambda: broken(1.0, np.inf),
    "on the way": cliff,
}


@pytest.mark.parametrize("solver", SOLVERS, ids=NAMES)
@pytest.mark.parametrize("kind", BROKEN)
def test_a_users_factor_without_numbers_never_makes_a_plan_without_numbers(kind, solver):
    try:
        mixture = plan(forked(track("a", 3.0, 0.2)), factors=[BROKEN[kind]()], solver=solver)
    except FgplanError:
        return
    for component in mixture.components:
        assert np.isfinite(component.energy)
        assert np.isfinite(component.robot.states).all()
        assert component.stop in {stop.value for stop in Stop}
    assert np.isfinite(mixture.trajectory.states).all()
    if kind != "on the way":
        assert not any(component.converged for component in mixture.components)


@pytest.mark.parametrize("solver", SOLVERS, ids=NAMES)
def test_a_users_factor_bends_both_solvers_alike(solver):
    noise = gtsam.noiseModel.Isotropic.Sigma(4, 0.05)
    wish = np.array([1.2, 0.5, 0.6, 0.2])
    factor = gtsam.PriorFactorVector(keys.robot(3), wish, noise)
    assembly, hypotheses = assembled(forked(density=short()), [factor])
    X, which = initial(assembly, hypotheses)
    found = solver.solve(assembly, X[:1], which[:1])[0]
    assert found.converged
    np.testing.assert_allclose(found.state[3, :4], wish, atol=0.15)
    reference = SecondOrder(meeting=0.0, patience=np.inf).solve(assembly, X[:1], which[:1])[0]
    np.testing.assert_allclose(found.state, reference.state, atol=1e-4)


def test_hessian_at_an_optimum_equals_the_dense_one():
    assembly, hypotheses = assembled(random_scene(6, 2, density=short()))
    X, which = initial(assembly, hypotheses)
    found = SecondOrder(meeting=0.0, patience=np.inf).solve(assembly, X[:1], which[:1])[0]
    gaussian = at_mode(assembly, found.state, 0)
    q = assembly.expand(found.state[None], ONE)
    assert gaussian is not None
    expected = np.linalg.slogdet(dense(q.diagonal[0], q.upper[0]))[1]
    assert gaussian.factor.log_determinant == pytest.approx(expected, rel=1e-10)
