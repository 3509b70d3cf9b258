"""Statements 19 to 25 of the acceptance list: the operator."""

from __future__ import annotations

import numpy as np
import pytest

from factors.coupling import coupling
from factors.gp_prior import gaussian
from factors.measurement import position_measurement
from fgplan import (
    Density,
    GivenPlan,
    GtsamLM,
    Level,
    OccupancyGrid,
    Reading,
    Readings,
    Robot,
    Scenario,
    Track,
    Trajectory,
    plan,
)
from fgplan.conditioning import log_likelihood, reweigh, weigh
from fgplan.crowd import Belief, believe
from fgplan.hypotheses import hypothesise
from fgplan.hypothesis import Hypothesis, Start
from fgplan.inference.gaussian import at_mode
from fgplan.peers.blending import Arbitration, Modes, blend, blend_gain
from fgplan.shared_control import Candidate, Joystick, toward
from fgplan.solver import SecondOrder
from tests.scalar import ROBOT, model, optimum, plan_variable, together
from tests.scenes import mode_evidence

SOLVERS = [SecondOrder(), GtsamLM()]


def line(y: float, times: np.ndarray) -> Trajectory:
    """A plan that keeps to y and goes on at 1 m/s."""
    ahead = np.ones_like(times)
    return Trajectory(
        times, np.column_stack([times, y * ahead]), np.column_stack([ahead, 0 * ahead])
    )


def two_lines(weights, ys):
    """A source of fixed plans, parallel, with stated weights."""

    def hypotheses(scenario: Scenario, belief: Belief):
        found = []
        for w, y in zip(weights, ys, strict=True):
            eta = line(y, scenario.density.times)
            found.append(Hypothesis(f"y={y:g}", np.log(w), eta, 0.0, (Start("plan", eta),)))
        return tuple(found)

    return hypotheses


def across(z: float, R: float, time: float = 0.8) -> Readings:
    """y measured at a time; x, which the plans share, as well."""
    return Readings((Reading(time, np.array([time, z]), R * np.eye(2)),))


def weights_of(scenario, source) -> dict[str, float]:
    belief = believe((), scenario.now, 0.03, 0.04, 1.5)
    return {h.label: np.exp(h.log_prior) for h in reweigh(scenario, source(scenario, belief))}


def test_19_operator_data_reweighs_fixed_plans():
    np.testing.assert_allclose(
        weigh([0.7, 0.3], [0.0, 1.0], 0.8, 0.25), [0.412727, 0.587273], atol=5e-7
    )
    # The same by the density: data on two plans without width, through scenario and planner.
    scenario = Scenario(Robot(np.zeros(2), np.array([1.0, 0.0])), data=(across(0.8, 0.25),))
    source = two_lines((0.7, 0.3), (0.0, 1.0))
    weighed = weights_of(scenario, source)
    assert weighed["y=0"] == pytest.approx(0.412727, abs=5e-7)
    assert weighed["y=1"] == pytest.approx(0.587273, abs=5e-7)
    planned = {c.label: np.exp(c.log_prior) for c in plan(scenario, hypotheses=source).components}
    assert planned == pytest.approx(weighed, abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_19_is_bayes_rule_for_any_number_of_plans_and_data(seed):
    rng = np.random.default_rng(seed)
    n, times = 4, np.array([0.3, 1.1, 2.6])
    w, ys = rng.dirichlet(np.ones(n)), rng.normal(size=n)
    zs, Rs = rng.normal(size=3), rng.uniform(0.1, 2, 3)
    scenario = Scenario(Robot(np.zeros(2)), data=tuple(map(across, zs, Rs, times)))
    found = weights_of(scenario, two_lines(w, ys))
    density = w * np.exp(-0.5 * np.sum((zs - ys[:, None]) ** 2 / Rs, axis=1))
    np.testing.assert_allclose(list(found.values()), density / density.sum(), atol=1e-12)


@pytest.mark.parametrize("sigma", [0.0, 0.5])
def test_20_a_vague_operator_leaves_the_autonomous_plan(sigma):
    paths = (
        GivenPlan("up", np.array([[0, 0], [8, 3.0]]), 0.6),
        GivenPlan("down", np.array([[0, 0], [8, -3.0]]), 0.4),
    )
    scenario = Scenario(
        Robot(np.zeros(2), np.array([0.8, 0.0])), plans=paths, count=0,
        levels=(Level(sigma=sigma),),
    )  # fmt: skip
    alone = plan(scenario)
    vague = plan(scenario.replace(data=(across(-3.0, 1e9),)))
    for a, b in zip(alone.components, vague.components, strict=True):
        assert a.label == b.label
        assert a.log_prior == pytest.approx(b.log_prior, abs=1e-6)
        np.testing.assert_allclose(a.robot.states, b.robot.states, atol=1e-6)


def test_20_a_certain_operator_has_the_nearest_plan():
    np.testing.assert_allclose(weigh([0.999, 0.001], [0.0, 1.0], 0.51, 1e-6), [0, 1], atol=1e-12)
    scenario = Scenario(Robot(np.zeros(2)), data=(across(0.51, 1e-6),))
    weighed = weights_of(scenario, two_lines((0.999, 0.001), (0.0, 1.0)))
    assert weighed["y=1"] == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("solver", SOLVERS, ids=["second order", "gtsam"])
@pytest.mark.parametrize(
    ("K", "S", "h", "expected"), [(1, 1, 0, 0.5), (1, 1, 1, 1 / 3), (0.4, 2.0, 0.3, 0.4 / 2.7)]
)
def test_21_linear_blending_comes_out_of_the_joint_density(solver, K, S, h, expected):
    u_R, u_h = 0.2, 1.7
    autonomy = (gaussian(np.array([u_R]), np.array([[K]])), ("robot",))
    operator = position_measurement(np.array([u_h]), np.array([[S]]), dim=1)
    psi = (coupling(h, (1, 1), space=1), ("level 0", "robot")) if h else None
    if psi is None:  # η and f are one
        density = model([ROBOT], [autonomy, (operator, ("robot",))])
    else:
        density = model([plan_variable(0), ROBOT], [autonomy, (operator, ("level 0",)), psi])
    f = optimum(density, solver=solver).state[0, -1]
    assert (f - u_R) / (u_h - u_R) == pytest.approx(expected, abs=1e-8)
    assert blend(u_h, u_R, blend_gain(K, S, h))[0] == pytest.approx(f, abs=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_21_the_gains_of_both_sides_sum_to_one(seed):
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(2, 3, 3))
    K, S, h = A @ A.T + 0.1 * np.eye(3), B @ B.T + 0.1 * np.eye(3), 0.3
    u_R, u_h = rng.normal(size=(2, 3))
    total = K + S + h * np.eye(3)
    K_h, K_R = blend_gain(K, S, h), np.linalg.solve(total.T, (S + h * np.eye(3)).T).T
    np.testing.assert_allclose(K_h + K_R, np.eye(3), atol=1e-12)
    one = Modes(np.ones(1), u_R[None], K[None]), Modes(np.ones(1), u_h[None], S[None])
    f, _ = Arbitration(*one, h).solve()
    np.testing.assert_allclose(f, K_h @ u_h + K_R @ u_R, atol=1e-9)


def two_modes(rng, m):
    L = rng.normal(size=(2, m, m))
    covariances = 0.3 * L @ np.swapaxes(L, 1, 2) + 0.05 * np.eye(m)
    return Modes(rng.dirichlet([2, 2]), rng.normal(0, 2, (2, m)), covariances)


def test_21_linear_blending_is_never_more_probable_than_the_joint_choice():
    """1000 random pairs of two-mode beliefs; where the commands differ, it is less probable."""
    rng = np.random.default_rng(21)
    differ = 0
    for number in range(1000):
        m = int(rng.integers(1, 3))
        case = Arbitration(two_modes(rng, m), two_modes(rng, m), float(rng.uniform(0.02, 1)))
        f, score = case.solve()
        u = case.linear_blend()
        blended = case.log_probability(u)
        if number % 20 == 0:  # the solver's score is the density at its command
            assert case.log_probability(f) == pytest.approx(score, abs=1e-7)
        assert score >= blended - 1e-9
        if np.abs(f - u).max() > 1e-3:
            differ += 1
            assert score > blended
    assert differ > 300


def test_21_linear_blending_fails_between_two_modes():
    """Both sides would pass a thing at 0, autonomy rather on the left and the operator rather on
    the right, and either would take the other side: their mixture is where nobody wants to be."""
    covariance = np.full((2, 1, 1), 0.02)
    autonomy = Modes(np.array([0.6, 0.4]), np.array([[1.0], [-1.0]]), covariance)
    operator = Modes(np.array([0.3, 0.7]), np.array([[1.0], [-1.0]]), covariance)
    case = Arbitration(autonomy, operator, h=0.01)
    f, score = case.solve()
    u = case.linear_blend()
    assert f[0] == pytest.approx(-1, abs=1e-9)
    assert abs(u[0]) < 0.3
    assert score - case.log_probability(u) > 10


def test_22_data_enters_once():
    """Prior variance 1, R = 1: variance and gain are 1/2, and the evidence is N(z; 0, 2)."""
    z = 0.8
    eta = plan_variable(0)
    prior = gaussian(np.zeros(1), np.eye(1))
    datum = position_measurement(np.array([z]), np.eye(1), dim=1)
    assembly = together([model([eta], [(prior, ("level 0",)), (datum, ("level 0",))])])
    solution = SecondOrder().solve(assembly, assembly.reference, np.zeros(1, dtype=int))[0]
    assert solution.state[0, 0] == pytest.approx(0.5 * z, abs=1e-12)
    normal = at_mode(assembly, solution.state, 0)
    assert normal is not None
    assert normal.covariance[0, 0] == pytest.approx(0.5, abs=1e-12)
    evidence = -0.25 * z**2 - 0.5 * np.log(4 * np.pi)
    assert mode_evidence(assembly, solution, 0) == pytest.approx(evidence, abs=1e-12)


def test_22_data_is_in_the_weight_or_in_the_trajectory_and_never_in_both():
    """One datum, by the density of the whole planner: on a plan of width 1 the level's own
    variance is halved and the weight untouched; between two plans alike it weighs 1/2 each."""
    robot = Robot(np.zeros(2), np.array([1.0, 0.0]))
    source = two_lines((0.5, 0.5), (0.0, 1.6))
    told = Scenario(robot, data=(across(0.8, 1.0, 0.0),), levels=(Level(sigma=1.0, h=1e9),))
    belief = believe((), 0.0, 0.03, 0.04, 1.5)
    assert [h.log_prior for h in reweigh(told, source(told, belief))] == [np.log(0.5)] * 2
    mixture = plan(told, hypotheses=source)
    np.testing.assert_allclose(mixture.probability_mass, 0.5, atol=1e-9)
    np.testing.assert_allclose(mixture.probability_height, 0.5, atol=1e-9)
    component = next(c for c in mixture.components if c.label == "y=0")
    assert component.levels["mission"].positions[0, 1] == pytest.approx(0.4, abs=1e-6)
    fixed = told.replace(levels=(Level(),))
    assert weights_of(fixed, source) == pytest.approx({"y=0": 0.5, "y=1.6": 0.5}, abs=1e-12)


def interventions():
    """z^h over [−3, −2] and [−0.6, 0.4], nothing in between."""
    rng = np.random.default_rng(23)
    stamps = np.concatenate([np.arange(-3, -2, 0.1), np.arange(-0.6, 0.4, 0.1)])
    values = np.array([0.7, 0.3]) + 0.1 * rng.normal(size=(len(stamps), 2))
    return [
        Reading(float(t), value, 0.2 * np.eye(2), "velocity")
        for t, value in zip(stamps, values, strict=True)
    ]


@pytest.mark.parametrize("sigma", [0.0, 0.6])
def test_23_batch_is_sequential_is_any_order(sigma):
    paths = (
        GivenPlan("up", np.array([[0, 0], [8, 3.0]])),
        GivenPlan("on", np.array([[0, 0], [8, 0.0]])),
    )
    scenario = Scenario(
        Robot(np.zeros(2), np.array([0.8, 0.0])), plans=paths, count=0,
        levels=(Level(sigma=sigma),),
    )  # fmt: skip
    readings = interventions()
    rng = np.random.default_rng(1)

    def planned(data):
        return plan(scenario.replace(data=data))

    batch = planned((Readings(tuple(readings)),))
    for order in (np.arange(len(readings)), rng.permutation(len(readings))):
        one_by_one = planned(tuple(Readings((readings[j],)) for j in order))
        for a, b in zip(batch.components, one_by_one.components, strict=True):
            np.testing.assert_allclose(a.robot.states, b.robot.states, atol=1e-10)
            assert a.log_prior == pytest.approx(b.log_prior, abs=1e-10)
    stamps = rng.permutation([reading.time for reading in readings])
    wrong = tuple(
        Reading(t, r.value, r.covariance, r.quantity) for t, r in zip(stamps, readings, strict=True)
    )
    shuffled = planned((Readings(wrong),))
    change = abs(shuffled.components[0].log_prior - batch.components[0].log_prior)
    bent = np.abs(shuffled.trajectory.states - batch.trajectory.states).max()
    assert change > 1e-6 if sigma == 0 else bent > 1e-4


def test_23_sequential_weights_are_those_of_the_batch():
    """The weights after one datum are those before the next."""
    rng = np.random.default_rng(5)
    w, ys, zs = rng.dirichlet(np.ones(3)), rng.normal(size=3), rng.normal(size=6)
    sequential = w
    for z in zs:
        sequential = weigh(sequential, ys, z, 0.4)
    batch = weigh(w, np.tile(ys[:, None], 6), zs, 0.4 * np.eye(6))
    np.testing.assert_allclose(sequential, batch, atol=1e-12)
    backwards = w
    for z in zs[::-1]:
        backwards = weigh(backwards, ys, z, 0.4)
    np.testing.assert_allclose(backwards, batch, atol=1e-10)


@pytest.mark.parametrize("sigma", [0.0, 0.6])
def test_24_nobody_intervenes(sigma):
    """Bit-identical to the plan without an operator, and so with a stick that was let go."""
    grid = OccupancyGrid.from_polygons(
        [np.array([[3, -1], [4, -1], [4, 1], [3, 1.0]])], (-2, -6, 10, 6), 0.1
    )
    person = Track("p", np.array([-0.4, 0.0]), np.array([[5.0, 0.3], [4.6, 0.3]]))
    scenario = Scenario(
        Robot(np.zeros(2), np.array([0.8, 0.0])), goal=np.array([8.0, 0.0]), grid=grid,
        tracks=(person,), levels=(Level(sigma=sigma),),
    )  # fmt: skip
    belief = believe(scenario.tracks, 0.0, 0.029, 0.043, 1.5)
    alone, quiet = plan(scenario, hypotheses=hypothesise), plan(scenario.replace(data=()))
    empty = plan(scenario.replace(data=(Readings(()),)), hypotheses=hypothesise)
    for other in (quiet, empty):
        for a, b in zip(alone.components, other.components, strict=True):
            np.testing.assert_array_equal(a.robot.states, b.robot.states)
            assert a.energy == b.energy
            assert a.log_prior == b.log_prior
    assert len(hypothesise(scenario, belief)) == len(quiet.components)


def test_25_candidate_goals_are_weighed_by_a_first_step():
    goals = np.array([[10.0, 5.0], [10.0, 0.0], [10.0, -5.0]])
    times = np.arange(11.0)
    plans = [Trajectory(times, np.outer(times / 10, g), np.tile(g / 10, (11, 1))) for g in goals]
    step = Reading(1.0, np.array([1.0, 0.5]), 0.25 * np.eye(2))
    expected = [0.5741, 0.3482, 0.0777]
    np.testing.assert_allclose(
        weigh(np.ones(3) / 3, [p.at(1.0)[:2] for p in plans], step.value, 0.25 * np.eye(2)),
        expected, atol=5e-5,
    )  # fmt: skip
    likelihood = np.exp([log_likelihood((step,), p) for p in plans])
    np.testing.assert_allclose(likelihood / likelihood.sum(), expected, atol=5e-5)

    def source(scenario, belief):
        etas = [p.resampled(scenario.density.times) for p in plans]
        return tuple(
            Hypothesis(f"{g}", -np.log(3), eta, 0.0, (Start("plan", eta),))
            for g, eta in zip(goals, etas, strict=True)
        )

    scenario = Scenario(
        Robot(np.zeros(2)), data=(Readings((step,)),), density=Density(dt=0.5, horizon=5.0)
    )
    np.testing.assert_allclose(list(weights_of(scenario, source).values()), expected, atol=5e-5)


def test_25_without_a_goal_the_stick_tells_candidates_apart():
    candidates = [
        Candidate("left", np.array([10.0, 5.0])), Candidate("ahead", np.array([10.0, 0.0])),
        Candidate("right", np.array([10.0, -5.0])),
    ]  # fmt: skip
    robot = Robot(np.zeros(2), np.array([0.8, 0.0]))
    stick = Joystick(0.0, np.array([0.8, -0.4]), 0.04 * np.eye(2))
    quiet = plan(Scenario(robot), hypotheses=toward(candidates))
    np.testing.assert_allclose([c.log_prior for c in quiet.components], np.log(1 / 3), atol=1e-12)
    told = plan(Scenario(robot, data=(stick,)), hypotheses=toward(candidates))
    assert told.components[0].label == "right"
    weights = {c.label: c.log_prior for c in told.components}
    assert weights["right"] > weights["ahead"] > weights["left"]
