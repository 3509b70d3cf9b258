"""A route is left for one that is better, not for one that looks better for a moment."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from fgplan.driving.deliberation import Deliberation

COMMITMENT, OVER, PERIOD = 1.0, 0.5, 0.1


def plan(**scores):
    """Components named by their labels ("_" stands for "+") and their scores."""
    components = [
        SimpleNamespace(label=label.replace("_", "+"), feasible=np.isfinite(score))
        for label, score in scores.items()
    ]
    return components, np.array(list(scores.values()))


def drive(advantages, over=OVER):
    """The routes followed when B is better than A by so much at each step, from A on."""
    known, followed = Deliberation().following("A", -PERIOD), []
    for k, advantage in enumerate(advantages):
        paid = {"A": 0.0, "B": float(advantage)}
        paid = {n: s - (COMMITMENT if n != known.followed else 0.0) for n, s in paid.items()}
        components, scores = plan(**paid)
        known = known.heard(components, scores, k * PERIOD, COMMITMENT, over)
        steady = known.steadied(components, scores, COMMITMENT)
        followed.append(components[int(np.argmax(steady))].label)
        known = known.following(followed[-1], k * PERIOD)
    return followed


@pytest.mark.parametrize("advantage", [1.5, 2.0, 10.0])
def test_an_advantage_that_lasts_is_taken_after_the_time_of_the_closed_form(advantage):
    followed = drive([advantage] * 40)
    expected = -OVER * np.log(1 - COMMITMENT / advantage)
    assert followed.index("B") == max(int(np.ceil(expected / PERIOD)) - 1, 0)
    assert set(followed[followed.index("B") :]) == {"B"}


def test_the_advantage_of_a_moment_is_not():
    assert set(drive([0.7, 0.9, 0.6, 1.6, -0.7, -1.8, -1.5])) == {"A"}


def test_without_averaging_the_last_plan_decides():
    assert drive([0.7, 1.6, -0.7, -1.8], over=0.0) == ["A", "B", "B", "A"]


def test_noise_about_no_advantage_moves_nothing():
    noise = np.random.default_rng(0).normal(0.0, 0.8, 600)
    followed = drive(noise)
    assert sum(a != b for a, b in pairwise(followed)) == 0
    raw = drive(noise, over=0.0)
    assert sum(a != b for a, b in pairwise(raw)) > 20


def test_the_robot_is_not_committed_to_what_one_sample_said():
    known = Deliberation().following("A", 2.0)
    for elapsed in (0.0, 0.1, 0.5, 5.0):
        expected = COMMITMENT * (1 - np.exp(-elapsed / OVER))
        assert known.commitment(COMMITMENT, 2.0 + elapsed, OVER) == pytest.approx(expected)
    assert known.commitment(COMMITMENT, 2.0, 0.0) == COMMITMENT


def test_a_route_that_may_not_be_driven_at_first_is_taken_when_it_may_and_is_better():
    followed = drive([-np.inf, -np.inf, *[2.0] * 10])
    assert followed[:3] == ["A"] * 3
    assert followed[-1] == "B"


def test_what_is_not_finite_is_not_averaged():
    known = Deliberation("A", 0.0, {"B": 0.4}, 0.0)
    components, scores = plan(A=0.0, B=-np.inf, C=-np.inf)
    assert known.heard(components, scores, 0.1, COMMITMENT, OVER).of == {"B": 0.4}


def test_a_name_that_means_something_new_has_no_past():
    known = Deliberation("A", 0.0, {"B": 0.4, "C": 0.2}, 0.0).branched({"B", "D"})
    assert (known.followed, known.of) == ("A", {"C": 0.2})


def test_going_there_and_back_leaves_it_as_it_was():
    known = Deliberation("A", 0.0, {"B": 1.2, "C": -0.5}, 3.0)
    there = known.following("B", 3.0)
    assert there.of == pytest.approx({"A": -1.2, "C": -1.7})
    assert there.following("A", 3.0).of == pytest.approx(known.of)


def test_what_may_not_be_driven_is_not_compared():
    known = Deliberation("A", 0.0, {"B": 0.4}, 0.0)
    components, scores = plan(A=-np.inf, B=0.0)
    assert known.heard(components, scores, 0.1, COMMITMENT, OVER) == known
    np.testing.assert_array_equal(known.steadied(components, scores, COMMITMENT), scores)


def test_routes_that_ended_in_one_optimum_with_the_followed_one_are_that_one():
    known = Deliberation("A", 0.0, {"B": 0.4}, 0.0)
    components, scores = plan(A_B=-1.0)
    assert known.steadied(components, scores, COMMITMENT) == pytest.approx([-1.0])
