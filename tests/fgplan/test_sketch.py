"""Starts bent around people held at their prediction, before they are solved among all."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from fgplan import keys, plan
from fgplan.assembly import Assembly
from fgplan.hypotheses import hypothesise
from fgplan.hypothesis import Hypothesis
from fgplan.model import build
from fgplan.search import search
from fgplan.sketch import ALIKE, MOST, sketched
from fgplan.solver import SecondOrder
from tests.fgplan.test_search import fork
from tests.scenes import believed


def crowded() -> tuple[Assembly, Assembly, tuple[Hypothesis, ...]]:
    """Two hypotheses among three people who react, and the same with the people held."""
    scenario = fork("abc")
    belief = believed(scenario)
    hypotheses = tuple(hypothesise(scenario, belief))
    assembly = Assembly(build(scenario, belief, hypotheses))
    held = Assembly(build(scenario.replace(crowd="predicted"), belief, hypotheses))
    return assembly, held, hypotheses


def test_sketches_are_distinct_and_leave_people_where_they_are_expected():
    assembly, held, hypotheses = crowded()
    for i, ends in enumerate(sketched(assembly, held, hypotheses)):
        assert 1 <= len(ends) <= MOST
        model = assembly.models[i]
        people, robot = model.columns["crowd"], model.columns["robot"]
        for n, end in enumerate(ends):
            np.testing.assert_array_equal(end.state[:, people], model.reference[:, people])
            assert end.label in {start.label for start in hypotheses[i].starts}
            for other in ends[:n]:
                assert np.abs(end.state - other.state)[:, robot].max() > ALIKE


def test_what_starts_from_sketches_is_as_good_and_takes_fewer_iterations():
    assembly, held, hypotheses = crowded()
    every = search(assembly, hypotheses, SecondOrder()).found
    some = search(assembly, hypotheses, SecondOrder(), held=held).found
    for i in range(len(hypotheses)):
        lowest, reached = (
            min(f.solution.energy for f in found if f.which == i) for found in (every, some)
        )
        assert reached == pytest.approx(lowest, abs=1e-6)
    spent, less = (sum(f.solution.iterations for f in found) for found in (every, some))
    assert less < spent


def test_starts_are_solved_among_all_where_no_sketch_is_of_use():
    assembly, held, hypotheses = crowded()
    found = search(
        assembly, hypotheses, SecondOrder(), usable=lambda which, solution: False, held=held
    ).found
    for i, hypothesis in enumerate(hypotheses):
        own = {f.rank for f in found if f.which == i}
        first = 1 + len(hypothesis.starts)
        assert own >= set(range(first, first + len(hypothesis.starts)))


def test_no_time_for_sketches_still_gives_starts():
    assembly, held, hypotheses = crowded()
    for i, ends in enumerate(sketched(assembly, held, hypotheses, until=0.0)):
        assert ends
        assert np.isfinite(assembly.energy(ends[0].state, np.array(i)))


def test_a_factor_of_the_users_on_the_people_is_never_left_out():
    scenario = fork("a")
    noise = gtsam.noiseModel.Isotropic.Sigma(4, 0.01)
    aside = np.array([3.0, 4.0, 0.0, 0.0])
    pulled = gtsam.PriorFactorVector(keys.crowd(20), aside, noise)
    best = plan(scenario, factors=[pulled]).components[0]
    np.testing.assert_allclose(best.crowd["a"].positions[20], aside[:2], atol=0.1)
