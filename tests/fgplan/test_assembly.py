"""The vectorised density against GTSAM's own evaluation of the graph, and differences."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from fgplan import Level, Scenario, keys
from fgplan.assembly import Assembly
from fgplan.model import build
from fgplan.solver import GtsamLM, SecondOrder
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
    jittered,
    random_scene,
    short,
)

SCENES: dict[str, Scenario] = {
    "alone": random_scene(0, 0, density=short()),
    "joint": random_scene(1, 3, density=short()),
    "robot pairs": random_scene(2, 3, pairs="robot", density=short()),
    "predicted": random_scene(3, 3, crowd="predicted", density=short()),
    "obstacles": random_scene(4, 2, grid=True, density=short(dt=0.5)),
    "predicted among obstacles": random_scene(5, 2, True, crowd="predicted", density=short()),
    "random level": random_scene(6, 2, levels=(CORRIDOR,), density=short()),
    "two levels": random_scene(7, 2, levels=STACK, density=short(t_ref=None)),
    "random above fixed": random_scene(
        8, 1, levels=(CORRIDOR, Level("path", sigma=0.0)), density=short()
    ),
    "fixed above random": random_scene(
        9, 1, levels=(Level("mission"), Level("corridor", sigma=0.3)), density=short()
    ),
    "without hinges": random_scene(
        10, 2, grid=True,
        density=short(contact_sigma=np.inf, obstacle_sigma=np.inf, limit_sigma=np.inf),
    ),
}  # fmt: skip


def uncertain(scenario: Scenario) -> Scenario:
    """The same with a robot whose state is not exact: no variable is fixed."""
    robot = replace(scenario.robot, covariance=np.diag([0.1, 0.1, 0.2, 0.2]) ** 2)
    return scenario.replace(robot=robot)


SCENES["uncertain robot"] = uncertain(random_scene(11, 2, density=short()))


class Pull:
    """A user's own callback factor: e = 3 sin(x_k) − y_{k+1}, on two neighbouring states."""

    def __init__(self, k: int) -> None:
        self.keys = [keys.robot(k), keys.robot(k + 1)]

    def factor(self) -> gtsam.CustomFactor:
        first, second = self.keys

        def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: object) -> np.ndarray:
            a, b = values.atVector(first), values.atVector(second)
            if jacobians is not None:
                jacobians[0] = np.array([[3 * np.cos(a[0]), 0, 0, 0]], order="F")
                jacobians[1] = np.array([[0, -1.0, 0, 0]], order="F")
            return np.array([3 * np.sin(a[0]) - b[1]])

        return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(1), self.keys, error)


def yours() -> list[gtsam.NonlinearFactor]:
    """Three kinds of factors that a user may add, one of them backwards in time."""
    loose = gtsam.noiseModel.Isotropic.Sigma(4, 0.7)
    robust = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(1.0), loose)
    wish = np.array([2.0, 1.0, 0.5, 0.0])
    return [
        gtsam.PriorFactorVector(keys.robot(3), wish, loose),
        gtsam.PriorFactorVector(keys.robot(2), wish, robust),
        gtsam.BetweenFactorVector(keys.robot(4), keys.robot(3), np.array([-0.3, 0, 0, 0]), loose),
        Pull(1).factor(),
    ]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", SCENES)
def test_energy_is_the_error_of_the_gtsam_graph(name, seed):
    assembly, _ = assembled(SCENES[name])
    state = jittered(assembly, seed)
    for i, model in enumerate(assembly.models):
        expected = model.graph().error(model.values(state))
        assert expected > 1  # the scene says something
        energy = assembly.energy(state[None], np.array([i]))
        assert energy == pytest.approx(expected, rel=1e-10)
        assert assembly.expand(state[None], np.array([i])).energy == pytest.approx(energy)
        assert assembly.gauss_newton(state[None], np.array([i])).energy == pytest.approx(energy)


@pytest.mark.parametrize("name", ["joint", "two levels", "uncertain robot"])
def test_energy_with_a_users_factors_is_the_error_of_the_gtsam_graph(name):
    with_yours, _ = assembled(SCENES[name], yours())
    without, _ = assembled(SCENES[name])
    state = jittered(with_yours, seed=4)
    model = with_yours.models[1]
    energy = with_yours.energy(state[None], np.array([1]))
    assert energy == pytest.approx(model.graph().error(model.values(state)), rel=1e-10)
    assert energy - without.energy(state[None], np.array([1])) > 0.1


def differences(assembly: Assembly, state: np.ndarray, which: int) -> tuple[np.ndarray, np.ndarray]:
    """Gradient by differences of the energy, Hessian by differences of that gradient's own
    energies: four evaluations a pair, all from `Assembly.energy`."""
    free = np.flatnonzero(assembly.free.ravel())
    step = 1e-4

    def energies(moves: np.ndarray) -> np.ndarray:
        X = state + moves.reshape(-1, *state.shape)
        return assembly.energy(X, np.full(len(X), which))

    unit = np.zeros((len(free), state.size))
    unit[np.arange(len(free)), free] = step
    ahead, behind = energies(unit), energies(-unit)
    gradient = (ahead - behind) / (2 * step)
    i, j = np.triu_indices(len(free))
    plus = energies(unit[i] + unit[j]) + energies(-unit[i] - unit[j])
    minus = energies(unit[i] - unit[j]) + energies(unit[j] - unit[i])
    hessian = np.zeros((len(free), len(free)))
    hessian[i, j] = hessian[j, i] = (plus - minus) / (4 * step**2)
    return gradient, hessian


@pytest.mark.parametrize(
    "name", ["joint", "predicted", "predicted among obstacles", "two levels", "uncertain robot"]
)
def test_gradient_and_hessian_match_central_differences(name):
    assembly, _ = assembled(SCENES[name])
    state = jittered(assembly, seed=5, scale=0.2)
    gradient, hessian = differences(assembly, state, 1)
    q = assembly.expand(state[None], np.array([1]))
    free = np.flatnonzero(assembly.free.ravel())
    H = dense(q.diagonal[0], q.upper[0])
    np.testing.assert_allclose(
        q.gradient[0].ravel()[free], gradient, rtol=1e-6, atol=1e-5 * np.abs(gradient).max()
    )
    # A second difference of an energy of a thousand nats, over 1e-4: 1e-5 of the largest entry.
    scale = np.abs(hessian).max()
    np.testing.assert_allclose(H[np.ix_(free, free)], hessian, rtol=1e-4, atol=1e-4 * scale)


@pytest.mark.parametrize("name", SCENES)
def test_gradient_matches_the_linearisation_of_the_gtsam_graph(name):
    """And so does the Gauss–Newton Hessian, which is what GTSAM's own optimisers see."""
    assembly, _ = assembled(SCENES[name], yours())
    state = jittered(assembly, seed=6)
    model = assembly.models[1]
    graph = replace(model, fixed={}).graph()  # GTSAM gives no Hessian of a constraint
    linear = graph.linearize(model.values(state))
    ordering = gtsam.Ordering()
    for k in range(len(model.times)):
        for variable in model.variables:
            ordering.push_back(variable.key(k))
    H, b = linear.hessian(ordering)
    q = assembly.gauss_newton(state[None], np.array([1]))
    free = np.flatnonzero(assembly.free.ravel())
    expected = -b[free]
    np.testing.assert_allclose(
        q.gradient[0].ravel()[free], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max()
    )
    np.testing.assert_allclose(
        dense(q.diagonal[0], q.upper[0])[np.ix_(free, free)],
        H[np.ix_(free, free)], rtol=1e-9, atol=1e-9 * np.abs(H[np.ix_(free, free)]).max(),
    )  # fmt: skip


@pytest.mark.parametrize("name", ["joint", "obstacles", "two levels"])
def test_gauss_newton_hessian_is_positive_semidefinite_where_the_true_one_is_not(name):
    assembly, _ = assembled(SCENES[name])
    state = jittered(assembly, seed=8, scale=0.6)
    columns = assembly.models[0].columns
    person = state[1:, columns["crowd"].start :][:, :2]
    state[1:, columns["robot"].start :][:, :2] = person + 0.1  # deep in the contact
    flat, full = assembly.gauss_newton(state[None], ONE), assembly.expand(state[None], ONE)
    H = dense(flat.diagonal[0], flat.upper[0])
    assert np.linalg.eigvalsh(dense(full.diagonal[0], full.upper[0]))[0] < 0
    assert np.linalg.eigvalsh(H)[0] > -1e-9 * np.abs(H).max()


EXPANSION = ("energy", "gradient", "diagonal", "upper")


@pytest.mark.parametrize("name", ["joint", "predicted among obstacles", "two levels"])
def test_a_batch_equals_its_members_one_by_one(name):
    assembly, hypotheses = assembled(SCENES[name], yours())
    X, which = initial(assembly, hypotheses)
    X = X + 0.1 * np.random.default_rng(7).standard_normal(X.shape)
    together = assembly.expand(X, which)
    energies = assembly.energy(X, which)
    scaled = assembly.energy(np.array([0.5, 1.0])[:, None, None, None] * X, which)
    assert scaled.shape == (2, len(X))
    np.testing.assert_allclose(scaled[1], energies, rtol=1e-12)
    for b in range(len(X)):
        alone = assembly.expand(X[b : b + 1], which[b : b + 1])
        for name in EXPANSION:
            whole, part = getattr(together, name), getattr(alone, name)
            scale = np.abs(part).max()
            np.testing.assert_allclose(whole[b], part[0], rtol=1e-10, atol=1e-12 * scale)


def test_a_hypothesis_among_others_is_the_hypothesis_alone():
    scenario = random_scene(12, 2, levels=(CORRIDOR,), density=short(reach=np.inf))
    both, _ = assembled(scenario)
    state = jittered(both, seed=1)
    for i in range(2):
        alone, _ = assembled(scenario.replace(plans=(scenario.plans[i],)))
        expected = alone.energy(state[None], ONE)
        assert both.energy(state[None], np.array([i])) == pytest.approx(expected, rel=1e-12)
        q, p = both.expand(state[None], np.array([i])), alone.expand(state[None], ONE)
        for name in EXPANSION:
            np.testing.assert_allclose(getattr(q, name), getattr(p, name), rtol=1e-10, atol=1e-9)


def test_a_state_known_without_error_does_not_move():
    assembly, _ = assembled(SCENES["joint"])
    robot = assembly.models[0].columns["robot"]
    assert not assembly.free[0, robot].any()
    assert assembly.free.sum() == assembly.dimension == assembly.free.size - 4
    q = assembly.expand(jittered(assembly, seed=2)[None], ONE)
    assert not q.gradient[0, 0, robot].any()
    np.testing.assert_array_equal(q.diagonal[0, 0, robot, robot], np.eye(4))
    assert not q.upper[0, 0, robot].any()


def test_models_of_two_builds_do_not_mix():
    one, _ = assembled(SCENES["joint"])
    other, _ = assembled(SCENES["joint"])
    with pytest.raises(ValueError, match="one build"):
        Assembly([one.models[0], other.models[1]])


def test_a_factor_on_an_unknown_key_is_named():
    noise = gtsam.noiseModel.Unit.Create(4)
    beyond = gtsam.PriorFactorVector(keys.robot(77), np.zeros(4), noise)
    with pytest.raises(ValueError, match=r"robot\(77\)"):
        assembled(SCENES["alone"], [beyond])
    people = gtsam.PriorFactorVector(keys.crowd(1), np.zeros(4), noise)
    with pytest.raises(ValueError, match=r"crowd\(1\)"):
        assembled(SCENES["alone"], [people])
    foreign = gtsam.PriorFactorVector(gtsam.symbol("q", 3), np.zeros(4), noise)
    with pytest.raises(ValueError, match="q3"):
        assembled(SCENES["alone"], [foreign])


@pytest.mark.parametrize("name", ["alone", "joint"])
def test_a_factor_across_steps_that_are_no_neighbours_is_solved_densely(name):
    """The oracle is GTSAM's own optimiser on the graph with that factor."""
    far = gtsam.BetweenFactorVector(
        keys.robot(1), keys.robot(4), np.array([0.3, 0.2, 0, 0]), gtsam.noiseModel.Unit.Create(4)
    )
    assembly, hypotheses = assembled(SCENES[name], [far])
    X, which = initial(assembly, hypotheses)
    (ours,) = SecondOrder().solve(assembly, X[:1], which[:1])
    (theirs,) = GtsamLM().solve(assembly, X[:1], which[:1])
    assert ours.converged
    assert ours.energy == pytest.approx(theirs.energy, abs=1e-6)
    np.testing.assert_allclose(ours.state, theirs.state, atol=1e-4)


def test_a_users_factor_may_join_different_variables():
    """Robot and people, of one step and of the next."""
    scenario = forked(random_scene(3, 1).tracks[0], density=short())
    noise = gtsam.noiseModel.Isotropic.Sigma(4, 0.5)
    factors = [
        gtsam.BetweenFactorVector(keys.crowd(2), keys.robot(2), np.ones(4), noise),
        gtsam.BetweenFactorVector(keys.crowd(4), keys.robot(3), np.ones(4), noise),
    ]
    assembly, _ = assembled(scenario, factors)
    state = jittered(assembly, seed=3)
    model = assembly.models[0]
    expected = model.graph().error(model.values(state))
    assert assembly.energy(state[None], ONE) == pytest.approx(expected, rel=1e-10)
    gradient, hessian = differences(assembly, state, 0)
    q = assembly.expand(state[None], ONE)
    free = np.flatnonzero(assembly.free.ravel())
    np.testing.assert_allclose(
        dense(q.diagonal[0], q.upper[0])[np.ix_(free, free)], hessian,
        atol=1e-4 * np.abs(hessian).max(),
    )  # fmt: skip
    np.testing.assert_allclose(
        q.gradient[0].ravel()[free], gradient, atol=1e-5 * np.abs(gradient).max()
    )


def test_hypotheses_share_their_terms():
    scenario = forked(plans=fork(), density=short())
    models = build(scenario, believed(scenario), assembled(scenario)[1])
    assert models[0].shared is models[1].shared
    assert models[0].own is not models[1].own
