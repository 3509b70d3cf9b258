"""What couplings are for: the formal answer, and the divergence in cases where it is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from factors.coupling import coupling
from factors.gp_prior import gaussian
from fgplan import Density, GivenPlan, Level, Mission, Region, Robot, Scenario
from fgplan.factorisation import divergence, factorise
from fgplan.model import Model
from fgplan.tactical import KeepOut
from tests.dense import Stack
from tests.scalar import ROBOT, model, optimum, plan_variable
from tests.scenes import assembled

DATA = Path(__file__).parents[2] / "data" / "scenarios"
FREE = Density(limit_sigma=np.inf, obstacle_sigma=np.inf)


def renamed(m: Model, *names: str) -> Model:
    own = tuple(replace(term, name=name) for term, name in zip(m.own, names, strict=True))
    return replace(m, own=own)


def test_divergence_of_two_scalars_by_hand():
    """η0 ~ N(1, 1), f ~ N(0, 1), h = 1: ½ (tr + Δ² − n − ln det) with tr 4/3, Δ² 2/9, det 1/3."""
    shared = [(gaussian(np.zeros(1), np.eye(1)), ("robot",))]
    own = [
        (gaussian(np.ones(1), np.eye(1)), ("level 0",)),
        (coupling(1.0, (1, 1), 1), ("level 0", "robot")),
    ]
    made = renamed(model([plan_variable(0), ROBOT], shared, own), "prior", "psi")
    whole, robot = divergence(made, optimum(made).state, "psi")
    assert whole == pytest.approx(0.5 * (4 / 3 + 2 / 9 - 2 + np.log(3)), abs=1e-12)
    # Of the robot: N(1/3, 2/3) from N(0, 1).
    assert robot == pytest.approx(0.5 * (2 / 3 + 1 / 9 - 1 - np.log(2 / 3)), abs=1e-12)
    nothing = divergence(made, optimum(made).state, "no such term")
    assert nothing == pytest.approx((0.0, 0.0), abs=1e-12)


def test_a_level_that_nothing_else_holds_costs_infinitely_much_and_the_robot_nothing():
    shared = [(gaussian(np.zeros(1), np.eye(1)), ("robot",))]
    own = [(coupling(1.0, (1, 1), 1), ("level 0", "robot"))]
    made = renamed(model([plan_variable(0), ROBOT], shared, own), "psi")
    assert divergence(made, optimum(made).state, "psi") == (np.inf, 0.0)


def stacked(levels, **changes):
    robot = Robot(np.zeros(2), np.array([0.7, 0.2]))
    path = (GivenPlan("the plan", np.array([[0.0, 0.0], [2.0, 1.0], [6.0, 0.5]])),)
    return Scenario(robot, plans=path, count=0, levels=levels, density=FREE, **changes)


CHAIN = (
    Level("mission", sigma=0.6, h=0.5),
    Level("tactics", sigma=1.1, h=0.3),
    Level("guide", sigma=0.4, h=0.2),
)


@pytest.mark.parametrize("index", range(3))
def test_divergence_of_the_positions_agrees_with_dense_linear_algebra(index):
    """Velocities given positions do not change, so that positions alone have the divergence."""
    scenario = stacked(CHAIN)
    report = factorise(scenario)
    _, (hypothesis,) = assembled(scenario)
    levels = list(CHAIN)
    means = [hypothesis.plan.positions] * 3
    whole = Stack(levels, means, scenario.robot, FREE)
    levels[index] = replace(levels[index], h=1e14)
    without = Stack(levels, means, scenario.robot, FREE)
    moved = np.linalg.solve(without.P, without.b) - np.linalg.solve(whole.P, whole.b)
    product = without.P @ np.linalg.inv(whole.P)
    square = np.sum(moved * (without.P @ moved))
    expected = 0.5 * (2 * np.trace(product) - 2 * len(product) + square)
    expected -= np.linalg.slogdet(product)[1]
    assert report.couplings[index].divergence == pytest.approx(expected, rel=1e-6)


REGIONS = (
    Region.disc("A", (3.0, 0.0), 0.4),
    Region.disc("B", (5.0, 0.0), 0.4),
    Region.disc("C", (3.0, 1.5), 0.4),
)
LEVELS = (Level("mission", sigma=0.5), Level("tactics", sigma=np.inf, h=0.2))


def asked(formula: str, **changes) -> Scenario:
    robot = Robot(np.zeros(2))
    given = {"regions": REGIONS, "mission": Mission(formula), "levels": LEVELS, "count": 1}
    return Scenario(robot, density=FREE, **{**given, **changes})


def test_independent_parts_do_not_couple_the_levels_that_hold_them():
    report = factorise(asked("F A & G !C"))
    assert [(held.text, held.levels) for held in report.held] == [
        ("F A", {"mission"}),
        ("G !C", {"tactics"}),
    ]
    first, second = report.couplings
    assert (first.carries, first.joins) == (("F A",), ())
    assert (second.carries, second.joins) == (("F A", "G !C"), ())


def test_coupled_parts_do():
    """The same regions, but C only after A: one part, held by both levels."""
    report = factorise(asked("F A & (!C W A)"))
    (held,) = report.held
    assert held.levels == {"mission", "tactics"}
    first, second = report.couplings
    assert first.joins == first.carries == (held.text,)
    assert second.joins == ()


def test_a_branch_that_nobody_asks_anything_of_is_not_needed():
    levels = (
        Level("mission", sigma=0.5),
        Level("tactics", sigma=np.inf, h=0.2),
        Level("spare", sigma=np.inf, h=0.2, follows="mission"),
    )
    zone = KeepOut(REGIONS[2], on="tactics")
    report = factorise(asked("F A", levels=levels, data=(zone,)))
    needed = {(c.above, c.below): c.needed for c in report.couplings}
    assert needed == {
        ("mission", "tactics"): True,
        ("mission", "spare"): True,  # the mission comes down through it as well
        ("tactics", "robot"): True,
        ("spare", "robot"): True,
    }
    nothing = factorise(asked("true", levels=LEVELS))
    assert not any(c.needed for c in nothing.couplings)


def test_a_rule_that_is_an_obstacle_is_held_by_the_robot():
    report = factorise(Scenario.load(DATA / "delivery.toml"))
    assert [(held.text, held.levels) for held in report.held] == [
        ("F(shelf & F desk)", {"mission"}),
        ("G !wet_floor", {"robot"}),
        ("the goal", {"mission"}),
    ]


def test_a_hypothesis_that_does_not_exist_is_refused():
    with pytest.raises(KeyError, match="hypothesis 'Z' is none of the plan"):
        factorise(stacked(CHAIN), "Z")
