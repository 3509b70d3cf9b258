"""The density as a factor graph: what is in it, and what dt does to it."""

from __future__ import annotations

from collections import Counter

import gtsam
import numpy as np
import pytest

from factors.residual import Linear
from fgplan import Density, Level, OccupancyGrid, Robot, SecondOrder, keys, plan
from fgplan.hypotheses import hypothesise
from fgplan.hypothesis import Start
from fgplan.model import build
from fgplan.starts import coast
from tests.scenes import (
    CORRIDOR,
    STACK,
    assembled,
    believed,
    fork,
    forked,
    initial,
    jittered,
    random_scene,
    short,
    track,
)

T = 5
"""Steps of `short()`."""


def factors_on(graph: gtsam.NonlinearFactorGraph) -> Counter[tuple[str, ...]]:
    """How many factors are on each tuple of variables, by readable names."""
    factors = (graph.at(i) for i in range(graph.size()))
    return Counter(tuple(keys.name(key) for key in factor.keys()) for factor in factors)


def test_the_graph_has_one_factor_per_term_and_step():
    assembly, _ = assembled(random_scene(1, 2, grid=True, levels=(CORRIDOR,), density=short()))
    model = assembly.models[0]
    named = {term.name: term for term in model.terms}
    assert set(named) == {
        "robot prior", "crowd now", "crowd prior", "interaction", "contact", "obstacle",
        "obstacle between", "speed limit", "acceleration limit", "corridor now", "corridor prior",
        "corridor coupling",
    }  # fmt: skip
    graph = model.graph()
    assert graph.size() == sum(len(term.steps) for term in model.terms) + len(model.fixed)
    on = factors_on(graph)
    assert on["robot(0)",] == 1  # the exact state
    assert on["crowd(0)",] == 1  # p(f_0 | z^f)
    for k in range(T):
        # GP prior, acceleration limit and the obstacle between two states
        assert on[f"robot({k})", f"robot({k + 1})"] == 3
        assert on[f"robot({k + 1})",] == 2  # obstacle, speed
        assert on[f"crowd({k})", f"crowd({k + 1})"] == 1
        assert on[f"level(0, {k})", f"level(0, {k + 1})"] == 1
    for k in range(T + 1):
        assert on[f"robot({k})", f"crowd({k})"] == 2  # interaction, contact
        assert on[f"level(0, {k})", f"robot({k})"] == 1


def test_held_people_are_in_the_factors_and_not_among_the_variables():
    assembly, _ = assembled(random_scene(1, 2, crowd="predicted", density=short()))
    model = assembly.models[0]
    assert [variable.name for variable in model.variables] == ["robot"]
    on = factors_on(model.graph())
    assert on[f"robot({T})",] == 4  # fixed plan, interaction, contact, speed


@pytest.mark.parametrize("people", [0, 1, 4])
def test_the_people_are_one_variable_a_step(people):
    assembly, _ = assembled(random_scene(1, people, density=short()))
    model = assembly.models[0]
    sizes = {variable.name: variable.dim for variable in model.variables}
    assert sizes == {"robot": 4} | ({"crowd": 4 * people} if people else {})
    values = model.values(model.reference)
    assert values.size() == (T + 1) * len(sizes)


def test_levels_couple_each_to_the_next_below():
    assembly, _ = assembled(forked(levels=STACK, density=short()))
    on = factors_on(assembly.models[0].graph())
    for k in range(T + 1):
        assert on[f"level(0, {k})", f"level(1, {k})"] == 1
        assert on[f"level(1, {k})", f"robot({k})"] == 1
        assert (f"level(0, {k})", f"robot({k})") not in on


def test_a_level_without_width_is_the_fixed_path_and_no_variable():
    fixed = forked(levels=(Level("mission", sigma=0.0), CORRIDOR), density=short())
    assembly, _ = assembled(fixed)
    model = assembly.models[0]
    assert [variable.name for variable in model.variables] == ["level 1", "robot"]
    on = factors_on(model.graph())
    assert on[f"level(1, {T})",] == 1  # coupling to the fixed mission


@pytest.mark.parametrize("levels", [(CORRIDOR,), STACK])
def test_state_and_values_read_back(levels):
    assembly, _ = assembled(random_scene(2, 3, levels=levels, density=short()))
    state = jittered(assembly, seed=0)
    model = assembly.models[0]
    np.testing.assert_array_equal(model.state(model.values(state)), state)


def test_a_variable_is_found_under_its_key():
    assembly, _ = assembled(random_scene(2, 2, levels=(CORRIDOR,), density=short()))
    state = jittered(assembly, seed=1)
    model = assembly.models[0]
    values = model.values(state)
    np.testing.assert_array_equal(values.atVector(keys.robot(3)), state[3, 4:8])
    np.testing.assert_array_equal(values.atVector(keys.level(0, 2)), state[2, :4])
    np.testing.assert_array_equal(values.atVector(keys.crowd(5)), state[5, 8:])


def test_the_initial_state_is_the_start_and_the_expected_people():
    scenario = forked(track("a", 3.0, 1.0, -0.5, 0.0), density=short())
    assembly, hypotheses = assembled(scenario)
    model = assembly.models[0]
    X, _ = initial(assembly, hypotheses)
    np.testing.assert_allclose(X[0, 1:, :4], hypotheses[0].plan.states[1:])
    np.testing.assert_array_equal(X[0, 0, :4], scenario.robot.state)  # known without error
    t = scenario.density.times
    np.testing.assert_allclose(X[0, :, 4], 3.0 - 0.5 * t, atol=0.01)
    other = model.initial(Start("coast", coast(scenario)))
    np.testing.assert_allclose(other[:, 0], 0.8 * t)


def test_log_normalisers_are_those_of_the_gaussian_densities():
    """Sum of log N(mean; mean, Σ) over all linear-Gaussian factors, each from its covariance."""
    scenario = random_scene(3, 2, levels=(CORRIDOR,), density=short())
    assembly, _ = assembled(scenario)
    model, d = assembly.models[0], scenario.density

    def log_peak(covariance: np.ndarray) -> float:
        size = len(covariance)
        return float(-0.5 * (size * np.log(2 * np.pi) + np.linalg.slogdet(covariance)[1]))

    q = np.array([[d.dt**3 / 3, d.dt**2 / 2], [d.dt**2 / 2, d.dt]])
    belief = believed(scenario)
    rate = np.sqrt(3) / CORRIDOR.length
    A = np.exp(-rate * d.dt) * np.array(
        [[1 + rate * d.dt, d.dt], [-(rate**2) * d.dt, 1 - rate * d.dt]]
    )
    S = np.diag([CORRIDOR.sigma**2, (rate * CORRIDOR.sigma) ** 2])
    own = 2 * log_peak(S) + 2 * T * log_peak(S - A @ S @ A.T)
    shared = 2 * T * log_peak(d.Qc_robot * q) + 2 * belief.count * T * log_peak(d.Qc_people * q)
    shared += sum(log_peak(covariance) for covariance in belief.covariance)
    assert model.log_normalizer_own == pytest.approx(own, rel=1e-10)
    assert model.log_normalizer == pytest.approx(own + shared, rel=1e-10)


def test_potentials_have_no_normaliser():
    assembly, _ = assembled(random_scene(3, 2, grid=True, density=short()))
    for term in assembly.models[0].terms:
        if not isinstance(term.residual, Linear) or "coupling" in term.name:
            assert term.residual.log_normalizer == 0.0


def weights(dt: float, t_ref: float | None) -> dict[str, float]:
    """Energy of each potential at one step of one state, by name."""
    density = Density(dt=dt, horizon=4 * dt, t_ref=t_ref, reach=np.inf)
    assembly, _ = assembled(random_scene(4, 2, grid=True, density=density))
    model = assembly.models[0]
    state = model.reference.copy()
    state[:, :4] = [3.1, 0.1, 1.4, 0.1]  # near the block, too fast
    state[2, 3] = 2.0  # too much acceleration
    state[:, 4:8] = [3.1, 0.5, 2.9, -0.2]  # near people
    energies = {}
    for term in model.terms:
        x = [state[1 + offset, model.columns[name]] for name, offset in term.variables]
        energies[term.name] = float(term.residual.at(0).energy(*x))
    return energies


def test_potentials_carry_the_exponent_dt_over_t_ref():
    plain, scaled = weights(0.6, None), weights(0.6, 1.2)
    potentials = {
        "mission coupling", "interaction", "contact", "obstacle", "obstacle between",
        "speed limit", "acceleration limit",
    }  # fmt: skip
    for name in potentials:
        assert plain[name] > 0
        assert scaled[name] == pytest.approx(0.5 * plain[name], rel=1e-12)
    for name in set(plain) - potentials:
        assert scaled[name] == plain[name]


@pytest.mark.parametrize("speed", [0.5, 0.6, 1.2])
def test_what_a_wall_costs_does_not_depend_on_the_length_of_a_step(speed):
    """A drive along a wall that is too near, 3.2 s long, in steps of any length."""
    energies = []
    for dt in (0.8, 0.4, 0.2, 0.1):
        density = Density(dt=dt, horizon=3.2, t_ref=0.4)
        wall = OccupancyGrid.from_polygons(
            [[(-1.0, 0.2), (9.0, 0.2), (9.0, 1.0), (-1.0, 1.0)]], (-2, -2, 10, 2), 0.05
        )
        robot = Robot(np.zeros(2), np.array([speed, 0.0]), preferred_speed=speed, max_speed=speed)
        scenario = forked(density=density, grid=wall, plans=fork()[:1]).replace(robot=robot)
        (model,) = build(scenario, believed(scenario), hypothesise(scenario, believed(scenario)))
        x = np.zeros((len(model.times), model.reference.shape[1]))
        robot_columns = model.columns["robot"]
        x[:, robot_columns] = np.column_stack(
            [speed * model.times, 0 * model.times, 0 * model.times + speed, 0 * model.times]
        )
        total = 0.0
        for term in model.terms:
            if term.name.startswith("obstacle"):
                steps = np.array(term.steps)
                at = [x[steps + offset, model.columns[name]] for name, offset in term.variables]
                total += float(np.sum(term.residual.energy(*at)))
        energies.append(total)
    assert energies[0] > 0.1
    np.testing.assert_allclose(energies, energies[0], rtol=1e-6)


def test_without_t_ref_the_potentials_are_the_papers_plain_product():
    assert weights(0.6, None) == weights(0.6, 0.6)
    assert Density(dt=0.3, t_ref=None).exponent == 1.0
    assert Density(dt=0.2, t_ref=0.4).exponent == 0.5


def by_label(scenario) -> dict[str, float]:
    mixture = plan(scenario)
    assert all(component.converged for component in mixture.components)
    return {component.label: component.energy for component in mixture.components}


@pytest.mark.parametrize("crowd", ["joint", "predicted"])
@pytest.mark.parametrize("seed", range(4))
def test_halving_dt_keeps_the_choice_and_changes_the_energy_less_than_without_t_ref(seed, crowd):
    # Decision 15. Without t_ref every potential counts twice as often.
    scenario = random_scene(seed, 3, crowd=crowd)

    def energies(dt: float, t_ref: float | None) -> dict[str, float]:
        return by_label(scenario.replace(density=Density(dt=dt, t_ref=t_ref)))

    one, half = energies(0.4, 0.4), energies(0.2, 0.4)
    assert min(one, key=one.__getitem__) == min(half, key=half.__getitem__)
    difference = one["left"] - one["right"]
    assert half["left"] - half["right"] == pytest.approx(difference, abs=0.25, rel=0.25)
    drift = abs(sum(half.values()) - sum(one.values()))
    plain = sum(energies(0.2, None).values()) - sum(one.values())
    assert plain > drift


def test_the_solver_sees_the_same_density_at_any_t_ref():
    """t_ref = dt and t_ref = None are one and the same."""
    scenario = random_scene(5, 2)
    one = plan(scenario.replace(density=Density(t_ref=0.4)), solver=SecondOrder())
    other = plan(scenario.replace(density=Density(t_ref=None)), solver=SecondOrder())
    np.testing.assert_array_equal(one.trajectory.states, other.trajectory.states)
