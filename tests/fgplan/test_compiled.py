"""Compiled kernels against numpy, which is the definition: the same to rounding, for any scene."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from factors.contact import Contact
from factors.interaction import Interaction
from factors.kinematics import AccelerationLimit, SpeedLimit
from factors.pairwise import CrowdPairs, PredictedPairs, Together
from factors.residual import Expansion, Residual
from fgplan import Scenario, backend, plan
from fgplan.assembly import Assembly
from fgplan.backend import Numpy
from fgplan.block_tridiagonal import Chains
from fgplan.hypotheses import hypothesise
from fgplan.model import Term, build
from fgplan.solver import SecondOrder
from fgplan.wheeled import CarLike, DifferentialDrive
from tests.scenes import CORRIDOR, ONE, STACK, believed, dense, jittered, random_scene, short

pytest.importorskip("numba")
from numba import njit

from fgplan.compiled import Compiled
from fgplan.compiled.kernel import exact, result, room
from fgplan.compiled.tiles import PANEL, add, laid, shape, solve

STEPS = 4
seeds = st.integers(0, 2**32 - 1)
crowds = st.integers(1, 5)
pairs = st.sampled_from(["all", "robot", "some"])
alphas = st.one_of(st.floats(0, 1), st.sampled_from([0.0, 0.99, 1.0]))
lengths = st.floats(0.05, 3)
weights = st.floats(0.01, 2)
spreads = st.sampled_from([0.0, 0.3, 1.0, 30.0])
BATCHES = [(), (3,), (2, 3)]


def terms_of(*residuals: Residual) -> list[Term]:
    """Terms of the robot, and of the crowd, at all of the steps."""
    on = (("robot", 0), ("crowd", 0))
    return [Term("", r, on[: len(r.dims)], range(STEPS)) for r in residuals]


def total(residuals: list[Residual], method: str, x: tuple[Any, ...]) -> Expansion:
    """Energy, gradient and Hessian of a sum of residuals on the same support."""
    with np.errstate(all="ignore"):
        return Expansion(*map(sum, zip(*(getattr(r, method)(*x) for r in residuals), strict=True)))


def assert_agree(numpy: list[Residual], x: tuple[Any, ...]) -> None:
    """The compiled form of residuals on one support is their sum, to rounding."""
    compiled = [term.residual for term in Compiled().fused(terms_of(*numpy))]
    assert not {type(r) for r in compiled} & {type(r) for r in numpy}
    with np.errstate(all="ignore"):
        energy = sum(r.energy(*x) for r in numpy)
    assert_close(sum(r.energy(*x) for r in compiled), energy)
    for method in ("expand", "gauss_newton"):
        for mine, theirs in zip(total(compiled, method, x), total(numpy, method, x), strict=True):
            assert_close(mine, theirs)


def assert_close(mine: Any, theirs: Any) -> None:
    """To rounding of the largest number, with the same NaN and inf."""
    finite = np.abs(theirs[np.isfinite(theirs)])
    assert_allclose(mine, theirs, rtol=1e-9, atol=1e-12 * max(1.0, finite.max(initial=0.0)))


def states(rng: Any, batch: tuple[int, ...], dim: int, spread: float) -> Any:
    return spread * rng.normal(size=(*batch, STEPS, dim))


@settings(max_examples=100, deadline=None)
@given(crowds, pairs, alphas, lengths, weights, spreads, st.sampled_from(BATCHES), seeds)
def test_pairs_of_a_crowd(n, which, alpha, h_c, weight, spread, batch, seed):
    assume(spread > 0 or alpha < 1)  # all at one point: the next test
    rng = np.random.default_rng(seed)
    chosen = which
    if which == "some":
        every = np.column_stack(np.triu_indices(n + 1, k=1))
        chosen = every[rng.random(len(every)) < 0.6]
    interaction = Interaction(alpha, h_c, weight)
    contact = Contact(rng.uniform(0, 2, n), 0.1, weight)
    dim = int(rng.integers(4, 6))
    numpy = [CrowdPairs(interaction, n, chosen, dim), CrowdPairs(contact, n, "robot", dim)]
    assert_agree(numpy, (states(rng, batch, dim, spread), states(rng, batch, 4 * n, spread)))


def test_contact_of_two_bodies_is_as_impossible():
    numpy = CrowdPairs(Interaction(1.0, 0.4), 1)
    (term,) = Compiled().fused(terms_of(numpy))
    x = np.zeros((STEPS, 4)), np.zeros((STEPS, 4))
    assert_array_equal(term.residual.energy(*x), np.inf)
    for mine, theirs in zip(term.residual.expand(*x), numpy.expand(*x), strict=True):
        assert_close(mine, theirs)
    assert_close(term.residual.gauss_newton(*x).hessian, 0.0 * np.zeros((STEPS, 4, 4)))


@settings(max_examples=100, deadline=None)
@given(crowds, alphas, weights, spreads, st.sampled_from(BATCHES), st.booleans(), seeds)
def test_pairs_with_people_held(n, alpha, weight, spread, batch, per_step, seed):
    rng = np.random.default_rng(seed)
    shape = (STEPS, n) if per_step else (n,)
    people = spread * rng.normal(size=(*shape, 2))
    variance = rng.uniform(0.1, 1, shape if rng.random() < 0.5 else ())
    interaction = Interaction(alpha, 0.4, weight, variance)
    contact = Contact(rng.uniform(0, 2, n) if rng.random() < 0.5 else 1.0, 0.1, weight)
    numpy = [PredictedPairs(p, people) for p in (interaction, contact, Contact(0.5, np.inf))]
    robot = states(rng, batch, 4, max(spread, 0.1))
    assert_agree(numpy, (robot,))
    assert_agree([PredictedPairs(Together((contact, Together((interaction,)))), people)], (robot,))


@pytest.mark.parametrize("shape", [(3,), (5, 7), (2, 3, 4)])
def test_room_begins_where_a_register_does(shape):
    for place in (room(shape), njit(lambda: room(shape))()):
        assert place.shape == shape
        assert place.flags.c_contiguous
        assert place.ctypes.data % 64 == 0


def limited(limit: float, weight: float, dim: int = 4) -> list[Term]:
    """Limits on speed and acceleration, as a robot has them."""
    speed = SpeedLimit(limit, 0.1, weight, dim)
    acceleration = AccelerationLimit(limit, 0.1, 0.4, weight, dim)
    return [
        Term("speed", speed, (("robot", 0),), range(1, STEPS + 1)),
        Term("acceleration", acceleration, (("robot", 0), ("robot", 1)), range(STEPS)),
    ]


def two_limits(terms: list[Term], method: str, before: Any, after: Any) -> Expansion:
    """Both in numpy, on the velocities of two states."""
    speed, acceleration = (getattr(term.residual, method) for term in terms)
    energy, gradient, hessian = acceleration(before, after)
    first = speed(after)
    gradient[..., 2:] += first.gradient
    hessian[..., 2:, 2:] += first.hessian
    return Expansion(energy + first.energy, gradient, hessian)


@settings(max_examples=100, deadline=None)
@given(st.floats(0, 2), weights, spreads, st.sampled_from(BATCHES), seeds)
def test_limits_on_a_norm(limit, weight, spread, batch, seed):
    rng = np.random.default_rng(seed)
    x = states(rng, batch, 4, spread), states(rng, batch, 4, spread)
    numpy = limited(limit, weight)
    (term,) = Compiled().fused(numpy)
    assert term.residual.convex
    assert_array_equal(term.residual.support, numpy[1].residual.support)
    for method in ("expand", "gauss_newton"):
        expected = two_limits(numpy, method, *x)
        assert_close(term.residual.energy(*x), expected.energy)
        for mine, theirs in zip(getattr(term.residual, method)(*x), expected, strict=True):
            assert_close(mine, theirs)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("spread", [0.3, 30.0])
@pytest.mark.parametrize(
    "potentials",
    [[Interaction(0.9, 0.4), Contact(1.0, 0.1)], [Interaction(0.9, 0.4)], [Contact(1.0, 0.1)]],
    ids=["both", "interaction", "contact"],
)
def test_what_is_not_finite_spreads_alike(value, spread, potentials):
    rng = np.random.default_rng(0)
    robot, crowd = states(rng, (2,), 4, spread), states(rng, (2,), 8, spread)
    robot[0, 1, 0] = crowd[1, 2, 3] = robot[1, 0, 2] = value
    people = rng.normal(size=(STEPS, 2, 2))
    for numpy, x in (
        ([CrowdPairs(p, 2, "robot") for p in potentials], (robot, crowd)),
        ([PredictedPairs(p, people) for p in potentials], (robot,)),
    ):
        compiled = [term.residual for term in Compiled().fused(terms_of(*numpy))]
        for method in ("expand", "gauss_newton"):
            mine, theirs = total(compiled, method, x), total(numpy, method, x)
            assert_close(mine.energy, theirs.energy)
            # numpy sums over bodies in matrix products, where NaN reaches all bodies of a step.
            for one, other in zip(mine[1:], theirs[1:], strict=True):
                axes = tuple(range(2, one.ndim))
                assert_array_equal(np.isfinite(one).all(axes), np.isfinite(other).all(axes))
    terms, after = limited(0.5, 1.0), states(rng, (2,), 4, spread)
    (term,) = Compiled().fused(terms)
    with np.errstate(all="ignore"):
        for mine, theirs in zip(
            term.residual.expand(robot, after),
            two_limits(terms, "expand", robot, after),
            strict=True,
        ):
            assert_close(mine, theirs)


def test_what_has_no_compiled_form_stays_as_it_is():
    @dataclass(frozen=True)
    class Mine(Interaction):
        """An interaction with something else in it."""

    people = np.zeros((STEPS, 2, 3))
    odd = [
        CrowdPairs(Mine(), 2),
        CrowdPairs(Together((Interaction(), Mine())), 2),
        PredictedPairs(Interaction(), people, robot_dim=6),
        *(term.residual for term in limited(1.0, 1.0, dim=6)),
        SpeedLimit(1.0, 0.1),
    ]
    kept = [term.residual for term in Compiled().fused(terms_of(*odd))]
    assert len(kept) == len(odd)
    assert all(a is b for a, b in zip(kept, odd, strict=True))


def test_two_potentials_of_a_kind_are_both_counted():
    rng = np.random.default_rng(0)
    numpy = [CrowdPairs(Interaction(0.9, h_c), 2) for h_c in (0.3, 0.6, 0.9)]
    assert_agree(numpy, (states(rng, (2,), 4, 1.0), states(rng, (2,), 8, 1.0)))


def test_states_of_any_layout_are_read():
    rng = np.random.default_rng(0)
    residual = CrowdPairs(Interaction(0.9, 0.4), 2)
    (term,) = Compiled().fused(terms_of(residual))
    whole = np.asfortranarray(states(rng, (3,), 20, 1.0))
    whole.setflags(write=False)
    x = whole[..., 12:8:-1], whole[..., 2:18:2]
    assert_close(term.residual.energy(*x), residual.energy(*x))
    assert_close(term.residual.expand(*x).hessian, residual.expand(*x).hessian)


SCENES: dict[str, Scenario] = {
    "alone": random_scene(0, 0, density=short()),
    "joint": random_scene(1, 4, density=short()),
    "joint, some held": random_scene(1, 4, density=short(reach=1.5)),
    "robot pairs": random_scene(2, 3, pairs="robot", density=short()),
    "predicted": random_scene(3, 3, crowd="predicted", density=short()),
    "obstacles": random_scene(4, 2, grid=True, density=short(dt=0.5)),
    "random level": random_scene(6, 2, levels=(CORRIDOR,), density=short()),
    "two levels": random_scene(7, 2, levels=STACK, density=short(t_ref=None)),
}


def wheeled(scenario: Scenario, model: Any) -> Scenario:
    return scenario.replace(robot=replace(scenario.robot, model=model))


SCENES["wheels"] = wheeled(SCENES["joint"], DifferentialDrive())
SCENES["a car"] = wheeled(random_scene(4, 2, grid=True, density=short(dt=0.5)), CarLike())


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES.keys())
@pytest.mark.parametrize("seed", range(3))
def test_densities_agree(scene, seed):
    belief = believed(scene)
    models = build(scene, belief, hypothesise(scene, belief))
    numpy, compiled = Assembly(models, Numpy()), Assembly(models, Compiled())
    which = np.arange(len(models))
    X = np.stack([jittered(numpy, seed * len(models) + i) for i in which])
    assert_close(compiled.energy(X, which), numpy.energy(X, which))
    assert_close(compiled.times(X, which), numpy.times(X, which))
    for method in ("expand", "gauss_newton"):
        mine, theirs = (getattr(a, method)(X, which) for a in (compiled, numpy))
        for name in ("energy", "gradient", "diagonal", "upper"):
            assert_close(getattr(mine, name), getattr(theirs, name))
        for (step, definite), (expected, also) in (
            (mine.newton()[:2], theirs.newton()[:2]),
            (mine.flattened(which), theirs.flattened(which)),
        ):
            assert_array_equal(definite, also)
            assert_allclose(step, expected, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES.keys())
def test_optima_agree(scene):
    belief = believed(scene)
    models = build(scene, belief, hypothesise(scene, belief))
    which = np.arange(len(models))
    X = np.stack([model.reference for model in models])
    solver = SecondOrder()
    mine, theirs = (solver.solve(Assembly(models, one), X, which) for one in (Compiled(), Numpy()))
    for one, other in zip(mine, theirs, strict=True):
        assert one.stop is other.stop
        # Rounding may tell which of two steps is the last: both are within the tolerance.
        assert one.energy == pytest.approx(other.energy, abs=solver.tolerance)
        assert_allclose(one.state, other.state, atol=1e-4)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 5), st.integers(1, 26), st.integers(1, 4), seeds)
def test_steps_solve_the_dense_system(S, D, B, seed):
    rng = np.random.default_rng(seed)
    upper = rng.normal(size=(B, S - 1, D, D)) * (rng.random((D, D)) < 0.3)
    diagonal = rng.normal(size=(B, S, D, D))
    diagonal = diagonal @ np.swapaxes(diagonal, -1, -2) + 4 * D * np.eye(D)
    order = rng.permutation(D)
    linked = np.any(upper, axis=(0, 1))
    gradient, step = rng.normal(size=(B, S, D)), np.empty((B, S, D))
    bad = int(rng.integers(B))
    diagonal[bad] *= rng.choice([1.0, -1.0, np.nan, np.inf])
    definite = np.empty(B, dtype=bool)
    chains = Chains.of(diagonal, upper, order, linked)
    with np.errstate(invalid="ignore"):
        solve(laid(chains.data), gradient, order, step, definite)
        expected, also = chains.solve(-gradient)
    assert_array_equal(definite, also)
    assert_allclose(step, expected, rtol=1e-9, atol=1e-12)
    for b in np.flatnonzero(definite):
        H = dense(diagonal[b], upper[b])
        assert_allclose(H @ step[b].ravel(), -gradient[b].ravel(), rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("D", [3, 120])
def test_narrow_and_wide_bands_have_the_steps_of_numpy(D):
    rng = np.random.default_rng(D)
    diagonal = rng.normal(size=(2, 3, D, D))
    diagonal = diagonal @ np.swapaxes(diagonal, -1, -2) + 4 * D * np.eye(D)
    diagonal[1] *= -1
    chains = Chains.of(diagonal, rng.normal(size=(2, 2, D, D)))
    arguments = np.array([0, 1, 0]), (), rng.normal(size=(3, 3, D))
    step, definite = Compiled().systems(chains)(*arguments)
    expected, also = Numpy().systems(chains)(*arguments)
    assert_array_equal(definite, also)
    assert definite.tolist() == [True, False, True]
    assert_allclose(step, expected, rtol=1e-9, atol=1e-12)


def test_tiles_begin_where_a_register_is_loaded_at_once():
    for count, rows, width in ((1, 10, 5), (3, 17, 9)):
        tiles = room((count, *shape(rows, width)))
        assert tiles.shape == (count, *shape(rows, width))
        assert tiles.ctypes.data % 64 == 0
        assert tiles.flags.c_contiguous


def test_blocks_are_added_where_the_chain_has_them():
    rng = np.random.default_rng(0)
    S, D, order = 4, 3, np.array([2, 0, 1])
    part = rng.normal(size=(2, S - 1, 4, 4))
    part = part + np.swapaxes(part, -1, -2)
    tiles = np.zeros((2, *shape(S * D, 2 * D)))
    places = np.array([order[0], order[2], D + order[2], D + order[1]])
    add(tiles, part, 0, D, places)
    expected = np.zeros((2, S * D, S * D))
    for k in range(S - 1):
        rows = k * D + places
        expected[:, rows[:, None], rows] += part[:, k]
    for row in range(S * D):
        for column in range(max(0, row - 2 * D + 1), row + 1):
            p, q = divmod(column, PANEL)
            found = tiles[:, p, q, row - p * PANEL]
            assert_allclose(found, expected[:, row, column], atol=1e-14)


def test_without_numba_numpy_does_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "fgplan.compiled", None)  # importing it fails
    backend.fastest.cache_clear()
    try:
        assert isinstance(backend.fastest(), Numpy)
        mixture = plan(SCENES["joint"])
    finally:
        backend.fastest.cache_clear()
        monkeypatch.undo()
    assert isinstance(backend.fastest(), Compiled)
    again = plan(SCENES["joint"])
    assert [c.label for c in again.components] == [c.label for c in mixture.components]
    assert again.best.energy == pytest.approx(mixture.best.energy, rel=1e-9)


def test_where_nothing_can_be_kept_kernels_are_compiled_for_the_process(monkeypatch):
    def refuse(function: Any) -> Any:
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr("numba.core.dispatcher.FunctionCache", refuse)

    def double(x: Any) -> None:
        for i in range(len(x)):
            x[i] *= 2

    x = np.ones(3)
    exact(result(1))(double)(x)
    assert_array_equal(x, 2.0)


def test_a_second_process_does_not_compile_again():
    program = (
        "from tests.scenes import random_scene, short\n"
        "from fgplan import plan\n"
        "plan(random_scene(1, 3, density=short(reach=1.5)))\n"
        "from fgplan.compiled import limits, pairs, tiles\n"
        "kernels = [getattr(m, n) for m in (limits, pairs, tiles) for n in dir(m)]\n"
        "kernels = [k for k in kernels if hasattr(k, 'stats')]\n"
        "assert any(k.stats.cache_hits for k in kernels)\n"
        "print(sum(sum(k.stats.cache_misses.values()) for k in kernels))\n"
    )
    command = [sys.executable, "-c", program]
    for _ in range(2):
        done = subprocess.run(
            command, cwd=Path(__file__).parents[2], capture_output=True, text=True, check=True
        )
    assert done.stdout.strip() == "0", done.stderr


def test_one_start_is_solved_alike_alone_and_among_others():
    scene = SCENES["joint"]
    belief = believed(scene)
    models = build(scene, belief, hypothesise(scene, belief))
    assembly = Assembly(models, Compiled())
    X = np.stack([model.reference for model in models])
    together = SecondOrder().solve(assembly, X, np.arange(len(models)))
    alone = SecondOrder().solve(assembly, X[:1], ONE)
    assert_array_equal(alone[0].state, together[0].state)
