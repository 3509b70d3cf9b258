"""A density pair by pair is the density: its steps are those of its factorised Hessian."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fgplan import GivenPlan, Scenario, keys, sparse
from fgplan.assembly import Assembly
from fgplan.backend import Numpy
from fgplan.hypotheses import hypothesise
from fgplan.model import build
from fgplan.solver import SecondOrder, Stop
from fgplan.sparse import Layout, Sparse
from fgplan.wheeled import DifferentialDrive
from tests.fgplan.test_compiled import wheeled
from tests.scenes import (
    CORRIDOR,
    STACK,
    assembled,
    believed,
    forked,
    initial,
    jittered,
    random_scene,
    short,
    track,
)

pytest.importorskip("numba")

SCENES: dict[str, Scenario] = {
    "many": random_scene(1, 14, density=short()),
    "some held": random_scene(1, 20, density=short(reach=2.0)),
    "robot pairs": random_scene(2, 13, pairs="robot", density=short()),
    "obstacles": random_scene(4, 16, grid=True, density=short(dt=0.5)),
    "random level": random_scene(6, 14, levels=(CORRIDOR,), density=short()),
    "two levels": random_scene(7, 14, levels=STACK, density=short(t_ref=None)),
    "no contact": random_scene(8, 12, density=short(contact_sigma=np.inf)),
}
SCENES["wheels"] = wheeled(SCENES["many"], DifferentialDrive())
TIGHT = 1e-9, 2000


def expanded(assembly: Assembly, X, which):
    """The expansion that lays out its Hessians, and the one that does not."""
    layout = Layout.of(assembly)
    assert layout is not None
    return assembly.expand(X, which), Sparse(assembly, layout, X, which)


def tight(q: Sparse):
    return q._solved(q.gradient, q.which, *TIGHT)


def states(assembly: Assembly, seed: int):
    which = np.arange(len(assembly.models))
    return np.stack([jittered(assembly, seed * len(which) + i) for i in which]), which


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES.keys())
@pytest.mark.parametrize("seed", range(4))
def test_expansions_and_steps_agree(scene, seed):
    assembly, _ = assembled(scene)
    X, which = states(assembly, seed)
    whole, pairs = expanded(assembly, X, which)
    np.testing.assert_allclose(pairs.energy, whole.energy, rtol=1e-12)
    np.testing.assert_allclose(pairs.gradient, whole.gradient, rtol=1e-9, atol=1e-9)
    step, definite, _ = tight(pairs)
    expected, also, _ = whole.newton()
    assert np.all(definite | ~also)
    np.testing.assert_allclose(step[also], expected[also], rtol=1e-4, atol=1e-5)
    # What is seen from a gradient alone may miss a direction; a drawn one does not.
    np.testing.assert_array_equal(definite & pairs.confirmed(which), also)


@pytest.mark.parametrize("seed", range(6))
def test_steps_of_any_accuracy_lead_down(seed):
    assembly, _ = assembled(SCENES["many"])
    X, which = states(assembly, seed)
    _, q = expanded(assembly, X, which)
    for step, _, useful in (q.newton(), (*q.flattened(which), np.ones(len(X), dtype=bool))):
        assert useful.all()
        assert np.all(np.einsum("bsd,bsd->b", q.gradient, step) < 0)
        assert np.all(step[:, ~assembly.free] == 0)


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 9), st.integers(0, 10_000))
def test_steps_agree_for_any_crowd(people, seed):
    before = sparse.FEWEST
    try:
        sparse.FEWEST = 1
        assembly, _ = assembled(random_scene(seed, people, density=short()))
        assume(Layout.of(assembly) is not None)  # nobody may be near enough to react
        X, which = states(assembly, seed % 100)
        whole, pairs = expanded(assembly, X, which)
    finally:
        sparse.FEWEST = before
    expected, also, _ = whole.newton()
    step, definite, _ = tight(pairs)
    assert np.all(definite | ~also)
    np.testing.assert_allclose(step[also], expected[also], rtol=1e-4, atol=1e-5)


def test_rows_are_taken_and_put():
    assembly, _ = assembled(SCENES["many"])
    X, which = states(assembly, 0)
    Y, _ = states(assembly, 1)
    _, mine = expanded(assembly, X, which)
    _, other = expanded(assembly, Y, which)
    rows = np.array([1, 0])
    np.testing.assert_array_equal(mine.take(rows).newton()[0], mine.newton()[0][rows])
    mine.put(which, other)
    np.testing.assert_array_equal(mine.newton()[0], other.newton()[0])


@pytest.mark.parametrize("scene", ["many", "two levels", "obstacles", "wheels"])
def test_optima_are_optima_of_the_whole(scene):
    assembly, hypotheses = assembled(SCENES[scene])
    X, which = initial(assembly, hypotheses)
    found = SecondOrder(meeting=0.0, patience=np.inf).solve(assembly, X, which)
    ended = [b for b, solution in enumerate(found) if solution.converged]
    assert len(ended) > len(found) / 2
    there = np.stack([found[b].state for b in ended])
    step, definite, _ = (q := assembly.expand(there, which[ended])).newton()
    assert definite.all()
    assert np.all(-0.5 * np.einsum("bsd,bsd->b", q.gradient, step) < 1e-6)
    np.testing.assert_allclose(q.energy, [found[b].energy for b in ended], rtol=1e-12)


def test_a_stationary_start_is_an_optimum_already():
    """A robot at rest without a goal, and people who stand far apart: there is nothing to do."""
    people = tuple(track(f"p{i}", 8.0 * (i + 1), 0.0) for i in range(14))
    scenario = forked(*people, plans=(), density=short(reach=1000.0))
    scenario = scenario.replace(robot=replace(scenario.robot, velocity=np.zeros(2)))
    assembly, hypotheses = assembled(scenario)
    assert Layout.of(assembly) is not None
    X, which = initial(assembly, hypotheses)
    rest = SecondOrder(meeting=0.0, patience=np.inf).solve(assembly, X[:1], which[:1])[0]
    assert rest.stop is Stop.CONVERGED
    assert np.abs(rest.state - X[0]).max() < 1e-6


@pytest.mark.parametrize("scene", ["many", "robot pairs"])
def test_it_ends_as_low_as_the_factorised(scene):
    """In every hypothesis the lowest optimum of one is the lowest of the other."""
    scenario = SCENES[scene]
    belief = believed(scenario)
    hypotheses = hypothesise(scenario, belief)
    models = build(scenario, belief, hypotheses)
    own, reference = Assembly(models), Assembly(models, Numpy())
    assert Layout.of(own) is not None
    assert Layout.of(reference) is None
    X, which = initial(own, hypotheses)
    solver = SecondOrder(meeting=0.0, patience=np.inf)
    mine, theirs = (solver.solve(a, X, which) for a in (own, reference))
    for i in set(which.tolist()):
        lowest, other = (
            min(s.energy for s, k in zip(run, which, strict=True) if k == i)
            for run in (mine, theirs)
        )
        assert lowest == pytest.approx(other, abs=1e-6)


def test_a_saddle_is_seen_across_a_symmetry():
    """One person right ahead, the others mirrored: nothing pulls to a side, and no step looks."""
    aside = [(2.0 + 0.8 * k, 1.5 + 0.2 * k) for k in range(6)]
    people = [track(f"l{k}", x, y) for k, (x, y) in enumerate(aside)]
    people += [track(f"r{k}", x, -y) for k, (x, y) in enumerate(aside)]
    straight = (GivenPlan("straight", np.array([[0.0, 0.0], [8.0, 0.0]])),)
    assembly, hypotheses = assembled(forked(track("a", 3.0, 0.0), *people, plans=straight))
    X, which = initial(assembly, hypotheses)
    reference = Assembly(assembly.models, Numpy())
    found = SecondOrder(meeting=0.0, patience=np.inf).solve(reference, X, which)
    saddles = np.stack([s.state for s in found if s.stop is Stop.SADDLE])
    minima = np.stack([s.state for s in found if s.stop is Stop.CONVERGED])
    for ends, minimum in ((saddles, False), (minima, True)):
        _, q = expanded(assembly, ends, np.zeros(len(ends), dtype=np.intp))
        assert np.all(q.confirmed(np.arange(len(ends))) == minimum)


def test_what_is_not_of_this_kind_is_factorised():
    few = random_scene(1, sparse.FEWEST - 1, density=short())
    others = [few, SCENES["many"].replace(crowd="predicted")]
    for scenario in others:
        assert Layout.of(assembled(scenario)[0]) is None
    noise = gtsam.noiseModel.Unit.Create(4)
    own = gtsam.PriorFactorVector(keys.robot(1), np.zeros(4), noise)
    assert Layout.of(assembled(SCENES["many"], [own])[0]) is None
