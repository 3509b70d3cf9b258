"""Robot models: limits, samples, stops, actions, and plans that a robot with wheels can drive."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from scipy import stats

from factors.unicycle import advance, slip
from fgplan import (
    CarLike,
    Density,
    DifferentialDrive,
    GivenPlan,
    GtsamLM,
    Holonomic,
    Robot,
    Scenario,
    ScenarioError,
    SecondOrder,
    Trajectory,
    plan,
)
from fgplan.robots import RobotModel, Twist
from fgplan.search import search
from fgplan.validation import find_mistakes
from tests.factor_testing import differences
from tests.scenes import CORRIDOR, STACK, assembled, fork, forked, jittered, random_scene, track

Array = NDArray[np.float64]

CAR = CarLike(min_turning_radius=0.8, max_reverse_speed=0.4)
WHEELED = [DifferentialDrive(), CarLike(), CAR]
MODELS: list[RobotModel] = [Holonomic(), *WHEELED]
DENSITY = Density()


def by_name(model: object) -> str:
    return f"{type(model).__name__}{getattr(model, 'max_reverse_speed', '')}"


models = pytest.mark.parametrize("model", MODELS, ids=by_name)
wheeled = pytest.mark.parametrize("model", WHEELED, ids=by_name)


def robot(model: RobotModel, speed: float = 0.8, heading: float = 0.0, **changes: Any) -> Robot:
    velocity = speed * np.array([np.cos(heading), np.sin(heading)])
    return Robot(np.zeros(2), velocity, heading, model=model, **changes)


def now(who: Robot) -> Array:
    return who.model.state(who, 0.0 if who.heading is None else who.heading)


def assert_within(who: Robot, states: Array, dt: float, allowance: float = 1e-3) -> None:
    """Limits from the fields themselves, not by `problems`; states (..., S, 5)."""
    model, v, w = who.model, states[..., 3], states[..., 4]
    assert v.max() <= who.max_speed + allowance
    assert v.min() >= -model.max_reverse_speed - allowance
    assert np.abs(np.diff(v)).max() / dt <= who.max_acceleration + allowance
    assert np.abs(np.diff(w)).max() / dt <= model.max_yaw_acceleration + allowance
    if isinstance(model, CarLike):
        assert np.max(model.min_turning_radius * np.abs(w) - np.abs(v)) <= allowance
    else:
        assert np.abs(w).max() <= model.max_yaw_rate + allowance


# Samples of the kinematic prior


@given(st.floats(-0.3, 1.2), st.floats(-1.0, 1.0), st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_samples_of_a_differential_drive_respect_its_limits(v: float, w: float, seed: int) -> None:
    who = robot(DifferentialDrive(), v, 0.4, yaw_rate=w)
    x = who.model.sample(who, DENSITY, now(who), 200, np.random.default_rng(seed))
    assert x.shape == (200, DENSITY.steps + 1, 5)
    assert_within(who, x, DENSITY.dt, 1e-9)
    assert max(slip(one, DENSITY.dt).max() for one in x) < 1e-12


@given(st.floats(-0.4, 1.2), st.floats(-1.0, 1.0), st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_samples_of_a_car_respect_its_limits(v: float, share: float, seed: int) -> None:
    who = robot(CAR, v, -1.0, yaw_rate=share * abs(v) / CAR.min_turning_radius)
    x = who.model.sample(who, DENSITY, now(who), 200, np.random.default_rng(seed))
    assert_within(who, x, DENSITY.dt, 1e-9)
    for one in x[:50]:
        assert CAR.problems(who, CAR.in_plane(DENSITY.times, one)) == []


@given(st.floats(0, 1.2), st.floats(-3, 3), st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_samples_of_a_holonomic_robot_respect_its_limits(v: float, th: float, seed: int) -> None:
    who = robot(Holonomic(), v, th)
    x = who.model.sample(who, DENSITY, now(who), 200, np.random.default_rng(seed))
    assert np.linalg.norm(x[..., 2:], axis=-1).max() <= who.max_speed + 1e-9
    change = np.linalg.norm(np.diff(x[..., 2:], axis=1), axis=-1) / DENSITY.dt
    assert change.max() <= who.max_acceleration + 1e-9


@models
def test_samples_begin_now_and_a_seed_repeats_them(model: RobotModel) -> None:
    who = robot(model)
    one, two = (model.sample(who, DENSITY, now(who), 5, np.random.default_rng(3)) for _ in range(2))
    assert_allclose(one, two, rtol=0, atol=0)
    assert_allclose(one[:, 0], np.broadcast_to(now(who), one[:, 0].shape))
    assert model.sample(who, DENSITY, now(who), 0, np.random.default_rng(3)).shape[0] == 0


def test_one_who_is_too_fast_only_gets_slower() -> None:
    for model in (Holonomic(), DifferentialDrive()):
        who = robot(model, 2.0)
        x = model.sample(who, DENSITY, now(who), 100, np.random.default_rng(0))
        speed = x[..., 3] if model.dim == 5 else np.linalg.norm(x[..., 2:], axis=-1)
        limit = np.maximum(who.max_speed, speed[:, :-1])
        assert np.all(speed[:, 1:] <= limit + 1e-9)


def test_samples_far_from_all_limits_have_the_law_of_the_prior() -> None:
    """Speed after a step is N(v, Qc dt), ω is N(ω, Qc_yaw dt): Kolmogorov–Smirnov."""
    free = {"max_speed": 50.0, "max_acceleration": 100.0}
    model = DifferentialDrive(50.0, 50.0, 100.0, Qc_yaw=0.7)
    who = robot(model, 0.5, yaw_rate=0.2, **free)
    x = model.sample(who, DENSITY, now(who), 4000, np.random.default_rng(1))
    scale = np.sqrt(DENSITY.dt * np.array([DENSITY.Qc_robot, 0.7]))
    for column, mean, spread in zip((3, 4), (0.5, 0.2), scale, strict=True):
        assert stats.kstest((x[:, 1, column] - mean) / spread, "norm").pvalue > 1e-3
    who = robot(Holonomic(), 0.5, **free)
    y = who.model.sample(who, DENSITY, now(who), 4000, np.random.default_rng(1))[:, 1] - [
        0.5 * DENSITY.dt, 0, 0.5, 0,
    ]  # fmt: skip
    dt, q = DENSITY.dt, DENSITY.Qc_robot
    blocks = q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    assert_allclose(np.cov(y[:, [0, 2]].T), blocks, rtol=0.1)
    assert_allclose(np.cov(y[:, [1, 3]].T), blocks, rtol=0.1)


# Plans


SCENES: dict[str, Any] = {
    "fork": lambda seed: forked(),
    "joint": lambda seed: random_scene(seed, 3),
    "predicted": lambda seed: random_scene(seed, 3, crowd="predicted"),
    "map": lambda seed: random_scene(seed, 2, grid=True),
    "random level": lambda seed: random_scene(seed, 2, levels=(CORRIDOR,)),
    "stack": lambda seed: random_scene(seed, 1, levels=STACK),
}


@wheeled
@pytest.mark.parametrize("scene", SCENES)
def test_plans_respect_the_limits_and_never_slide(model: Any, scene: str) -> None:
    for seed in range(2):
        scenario = SCENES[scene](seed).replace(robot=robot(model))
        mixture = plan(scenario)
        assert mixture.selected is not None
        for component in mixture.components:
            states = model.states(component.robot)
            assert_within(scenario.robot, states, scenario.density.dt)
            assert slip(states, scenario.density.dt).max() <= 1e-3
            assert model.problems(scenario.robot, component.robot) == []


@wheeled
def test_optima_themselves_hardly_slide(model: Any) -> None:
    """Before anything is driven exactly: the defect that an optimum has left is below 1 mm."""
    for seed in range(3):
        scenario = random_scene(seed, 3, grid=True).replace(robot=robot(model))
        assembly, hypotheses = assembled(scenario)
        column = assembly.models[0].columns["robot"]
        for found in search(assembly, hypotheses, SecondOrder()).found:
            if found.solution.converged:
                states = found.solution.state[:, column]
                assert slip(states, scenario.density.dt).max() < 1e-3
                driven = model.trajectory(scenario.density.times, states)
                assert_allclose(driven.positions, states[:, :2], atol=0.02)


@pytest.mark.parametrize("heading", [np.pi, 3.0, 2.5, -2.0])
def test_a_reversed_start_converges_well(heading: float) -> None:
    who = robot(DifferentialDrive(), 0.0, heading)
    scenario = forked().replace(robot=who)
    assembly, hypotheses = assembled(scenario)
    found = search(assembly, hypotheses, SecondOrder(meeting=0.0, patience=np.inf)).found
    first = [f.solution for f in found if f.label == "plan"]
    assert all(solution.converged for solution in first)
    assert max(solution.iterations for solution in first) <= 40
    assert np.median([solution.iterations for solution in first]) <= 30
    mixture = plan(scenario)
    assert mixture.best is not None
    assert mixture.best.robot.positions[-1, 0] > 2.5  # it did turn round and go


def test_without_limits_to_lean_on_wheels_cost_little() -> None:
    """A straight way: the robot with wheels does what the holonomic one does."""
    ways = (GivenPlan("on", np.array([[0.0, 0.0], [9.0, 0.0]])),)
    ends = []
    for model in MODELS:
        mixture = plan(Scenario(robot(model), plans=ways, count=0))
        ends.append(mixture.trajectory.positions)
    for end in ends[1:]:
        assert_allclose(end, ends[0], atol=0.02)


@wheeled
def test_both_solvers_find_one_optimum(model: Any) -> None:
    scenario = random_scene(3, 1).replace(robot=robot(model), plans=fork()[:1])
    assembly, hypotheses = assembled(scenario)
    start = assembly.models[0].initial(hypotheses[0].starts[0])[None]
    zero = np.zeros(1, dtype=np.intp)
    ours = SecondOrder().solve(assembly, start, zero)[0]
    reference = GtsamLM(max_iterations=500).solve(assembly, ours.state[None], zero)[0]
    assert ours.converged
    assert reference.energy == pytest.approx(ours.energy, abs=1e-6)
    assert_allclose(reference.state, ours.state, atol=1e-3)


@models
def test_gradient_and_graph_agree_with_the_energy(model: RobotModel) -> None:
    """Everything a model adds, in the assembly and in GTSAM's graph: one density."""
    scenario = random_scene(0, 2, grid=True, density=Density(horizon=0.8), levels=(CORRIDOR,))
    assembly, _ = assembled(scenario.replace(robot=robot(model)))
    X, zero = jittered(assembly, 1, 0.1), np.zeros(1, dtype=np.intp)
    graph = assembly.models[0].graph()
    energy = float(assembly.energy(X, zero[0]))
    assert graph.error(assembly.models[0].values(X)) == pytest.approx(energy, rel=1e-9)

    def flat(x: Array) -> Array:
        return assembly.energy(x.reshape(X.shape), zero[0])

    gradient = assembly.expand(X[None], zero).gradient[0]
    numeric = differences(flat, X.ravel()).reshape(X.shape)
    numeric[~assembly.free] = 0
    assert_allclose(gradient, numeric, atol=2e-6 * np.abs(numeric).max())


@wheeled
def test_mirrored_scene_mirrors_the_plan(model: Any) -> None:
    people = (track("a", 3.0, 0.4, -0.2, 0.1), track("b", 5.0, -1.0, -0.5, 0.0))
    mirrored = tuple(
        track(t.identity, *(t.positions[-1] * [1, -1]), v, -w)
        for t, v, w in zip(people, (-0.2, -0.5), (0.1, 0.0), strict=True)
    )
    one = plan(forked(*people).replace(robot=robot(model)))
    two = plan(forked(*mirrored).replace(robot=robot(model)))
    assert two.components[0].energy == pytest.approx(one.components[0].energy, abs=1e-4)
    assert_allclose(
        two.components[0].robot.positions, one.components[0].robot.positions * [1, -1], atol=5e-3
    )


@wheeled
def test_an_uncertain_state_is_planned_from(model: Any) -> None:
    who = robot(model, covariance=np.diag([0.1, 0.1, 0.05, 0.05, 0.05]) ** 2)
    mixture = plan(forked().replace(robot=who))
    assert mixture.selected is not None


@wheeled
def test_a_warm_start_is_taken_with_its_headings(model: Any) -> None:
    scenario = random_scene(1, 2).replace(robot=robot(model))
    cold = plan(scenario)
    best = cold.best
    assert best is not None
    states = model.states(best.robot)
    after = Robot(
        states[1, :2], best.robot.velocities[1], states[1, 2], float(states[1, 4]), model=model
    )
    warm = plan(scenario.replace(robot=after, now=scenario.density.dt), warm=cold)
    assert warm.selected is not None
    assert model.problems(after, warm.trajectory) == []


@wheeled
def test_without_a_goal_it_goes_on_as_it_does(model: Any) -> None:
    """The prior's mean is the constant twist."""
    who = robot(model, 0.6, yaw_rate=0.3)
    mixture = plan(Scenario(who))
    states = model.states(mixture.trajectory)
    assert_allclose(states[:, 3], 0.6, atol=1e-6)
    assert_allclose(states[:, 4], 0.3, atol=1e-6)


# Stops, checks, actions


@given(st.floats(-0.3, 1.2), st.floats(-1, 1), st.sampled_from(WHEELED), st.floats(0.2, 1))
def test_a_stop_is_within_the_limits_and_stands(v: float, w: float, model: Any, s: float) -> None:
    v = v if model.max_reverse_speed else abs(v)
    w = w * min(1.0, abs(v) / model.min_turning_radius) if isinstance(model, CarLike) else w
    who = robot(model, v, 0.3, yaw_rate=w)
    times = np.arange(25) * 0.4
    stop = model.braking(who, now(who), times, s)
    assert model.problems(who, stop) == []
    assert_allclose(model.states(stop)[-1, 3:], 0.0, atol=1e-12)


def test_a_car_brakes_along_its_arc() -> None:
    who = robot(CAR, 1.0, yaw_rate=0.8)
    states = CAR.states(CAR.braking(who, now(who), np.arange(10) * 0.2, 1.0))
    radius = np.linalg.norm(states[:, :2] - [0.0, 1.25], axis=1)
    assert_allclose(radius, 1.25, atol=1e-4)


BROKEN: list[tuple[Any, Any, str]] = [
    (DifferentialDrive(), lambda x: x + np.eye(5)[3] * 2, "speed 2.8"),
    (DifferentialDrive(), lambda x: x - np.eye(5)[3] * 2, "reverse speed 1.2"),
    (DifferentialDrive(), lambda x: x + np.eye(5)[4] * 2, "yaw rate 2.0"),
    (CarLike(), lambda x: x + np.eye(5)[4] * 0.9, "speed needed for its turn 0.9"),
    (CAR, lambda x: np.array([0, 0, 0, -0.3, 0.3]), "turn while changing direction 0.24"),
    (DifferentialDrive(), lambda x: x + np.eye(5)[3] * 0.2, "acceleration 2.0"),
    (DifferentialDrive(), lambda x: x + np.eye(5)[4] * 0.4, "yaw acceleration 4.0"),
]


@pytest.mark.parametrize(("model", "change", "problem"), BROKEN)
def test_every_broken_limit_is_named(model: Any, change: Any, problem: str) -> None:
    who = robot(model, 0.8)
    x = np.array([0.0, 0.0, 0.0, 0.8, 0.3 if "direction" in problem else 0.0])
    states = [x, x]
    target = change(x)
    states += [advance(x, (target - x)[3:], 0.1)]
    found = model.problems(who, model.in_plane(0.1 * np.arange(3), np.array(states)))
    assert any(problem in p for p in found), found


def test_sliding_sideways_is_named() -> None:
    who, model = robot(DifferentialDrive()), DifferentialDrive()
    states = model.states(plan(forked().replace(robot=who)).trajectory)
    states[3:, 1] += 0.0021
    found = model.problems(who, model.in_plane(DENSITY.times, states))
    assert found == ["slides sideways by 2.1 mm in a step"]


@models
def test_the_action_is_a_twist_in_the_base_frame(model: RobotModel) -> None:
    heading = 0.3
    who = robot(model, 0.8, heading)
    mixture = plan(forked().replace(robot=who))
    twist = mixture.action.twist
    if model.dim == 4:
        c, s = np.cos(heading), np.sin(heading)
        turned = np.array([[c, -s], [s, c]]) @ [twist.linear_x, twist.linear_y]
        assert_allclose(turned, mixture.action.velocity)
        assert twist.angular_z == 0
    else:
        assert twist.linear_y == 0
        assert abs(twist.linear_x) == pytest.approx(np.linalg.norm(mixture.action.velocity))
        turned_by = np.diff(mixture.trajectory.headings[:2])[0]  # type: ignore[index]
        assert np.sign(twist.angular_z) == np.sign(turned_by)
    assert mixture.to_dict()["action"]["twist"] == {
        "linear": {"x": twist.linear_x, "y": twist.linear_y},
        "angular": {"z": twist.angular_z},
    }
    columns = len(mixture.to_dict()["trajectory"][0])
    assert columns == (5 if model.dim == 4 else 6)


def test_holonomic_twist_sideways() -> None:
    straight = Trajectory(np.arange(2.0), np.zeros((2, 2)), np.array([[0, 1.0], [0, 1.0]]))
    assert Holonomic().twist(straight, 1, 0.0) == Twist(0.0, 1.0, 0.0)
    assert Holonomic().twist(straight, 1, np.pi / 2).linear_x == pytest.approx(1.0)


# States and mistakes


def test_only_the_velocity_along_the_heading_counts() -> None:
    who = Robot(np.array([1.0, 2.0]), np.array([1.0, 1.0]), 0.0, 0.5, model=DifferentialDrive())
    assert_allclose(now(who), [1, 2, 0, 1, 0.5])
    backward = robot(DifferentialDrive(), -0.4, 2.0)
    assert now(backward)[3] == pytest.approx(-0.4)


def test_a_guess_without_headings_is_driven_after() -> None:
    who = robot(DifferentialDrive(), 0.8)
    times = DENSITY.times
    guess = Trajectory(times, np.column_stack([0.8 * times, 0 * times]), np.tile([0.8, 0], (13, 1)))
    states = who.model.lift(who, now(who), guess)
    assert_within(who, states, DENSITY.dt)
    assert np.abs(states[:, :2] - guess.positions).max() < 0.3
    assert slip(states, DENSITY.dt).max() < 1e-12


def test_a_guess_with_headings_keeps_them_on_the_same_turn() -> None:
    who = robot(DifferentialDrive(), 0.8, 2 * np.pi)
    states = who.model.sample(who, DENSITY, now(who), 1, np.random.default_rng(0))[0]
    guess = DifferentialDrive().in_plane(DENSITY.times, states - 4 * np.pi * np.eye(5)[2])
    assert_allclose(who.model.lift(who, now(who), guess), states, atol=1e-9)


def test_a_trajectory_without_headings_has_no_wheels() -> None:
    straight = Trajectory(np.arange(2.0), np.zeros((2, 2)), np.zeros((2, 2)))
    with pytest.raises(ValueError, match="needs a trajectory with headings"):
        DifferentialDrive().states(straight)
    with pytest.raises(ValueError, match="together or not at all"):
        Trajectory(np.arange(2.0), np.zeros((2, 2)), np.zeros((2, 2)), np.zeros(2))


def test_resampled_headings_are_those_driven() -> None:
    model = DifferentialDrive()
    who = robot(model, 0.8, yaw_rate=0.5)
    states = model.sample(who, DENSITY, now(who), 1, np.random.default_rng(0))[0]
    curve = model.in_plane(DENSITY.times, states)
    half = curve.resampled(DENSITY.times[:-1] + 0.2)
    change = 0.5 * np.diff(states[:, 3:], axis=0)
    exact = advance(states[:-1], change, 0.2)
    assert half.headings is not None
    assert_allclose(half.headings, exact[:, 2], atol=1e-9)
    assert_allclose(half.positions, exact[:, :2], atol=2e-3)


@pytest.mark.parametrize(
    ("changes", "paths"),
    [
        ({"model": "car"}, ["robot.model"]),
        ({"model": CarLike}, ["robot.model"]),
        ({"model": CarLike(-1.0, np.nan)}, ["robot.max_reverse_speed", "robot.min_turning_radius"]),
        (
            {"model": DifferentialDrive(max_yaw_rate=0.0, Qc_yaw=np.inf), "yaw_rate": np.nan},
            ["robot.yaw_rate", "robot.max_yaw_rate", "robot.Qc_yaw"],
        ),
        ({"model": CarLike(), "covariance": np.eye(4)}, ["robot.covariance"]),
        ({"model": Holonomic(), "covariance": np.eye(5)}, ["robot.covariance"]),
    ],
)
def test_all_mistakes_of_a_model_are_named(changes: Any, paths: list[str]) -> None:
    scenario = Scenario(Robot(np.zeros(2), **changes))
    assert [m.path for m in find_mistakes(scenario)] == paths
    with pytest.raises(ScenarioError):
        plan(scenario)


def test_models_keep_the_protocol() -> None:
    for model in MODELS:
        assert isinstance(model, RobotModel)
