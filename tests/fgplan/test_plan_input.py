"""What plan is given: what makes no sense is refused by name, and too little time is said."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from fgplan import (
    GtsamLM,
    NoPlan,
    OccupancyGrid,
    keys,
    plan,
    selection,
)
from fgplan.crowd import Belief
from tests.scenes import forked, short, track


def test_a_users_factor_that_excludes_everything_is_no_plan():
    def nowhere(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: object) -> np.ndarray:
        if jacobians is not None:
            jacobians[0] = np.zeros((1, 4), order="F")
        return np.array([np.inf])

    factor = gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(1), [keys.robot(2)], nowhere)
    with pytest.raises(NoPlan, match=r"left.*right") as caught:
        plan(forked(), factors=[factor])
    assert len(caught.value.evidence) >= 2


@pytest.mark.parametrize(
    "noise",
    [gtsam.noiseModel.Constrained.All(4), gtsam.noiseModel.Diagonal.Sigmas([1.0, 1.0, 0.0, 0.1])],
    ids=["all", "one"],
)
@pytest.mark.parametrize("solver", [None, GtsamLM()], ids=["second order", "gtsam"])
def test_a_hard_constraint_is_refused_by_name(noise, solver):
    factor = gtsam.PriorFactorVector(keys.robot(3), np.array([1.2, 0.5, 0.6, 0.2]), noise)
    with pytest.raises(ValueError, match=r"robot.*hard constraint.*small sigma"):
        plan(forked(), factors=[factor], **({} if solver is None else {"solver": solver}))


def test_a_rule_that_needs_evidence_is_refused_where_there_is_none():
    with pytest.raises(ValueError, match="no evidence to select by"):
        plan(forked(), inference="map", select=selection.mass)


def test_where_time_leaves_no_evidence_the_choice_is_by_height_and_says_so():
    mixture = plan(forked(density=short()), deadline=0.0, select=selection.mass)
    assert all(c.log_evidence is None for c in mixture.components)
    assert any("chosen by height" in warning for warning in mixture.warnings)
    assert mixture.best is mixture.components[int(np.argmax(mixture.probability_height))]


@pytest.mark.parametrize("crowd", ["joint", "predicted"])
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"covariance": np.zeros((2, 4, 4))}, "covariance of 'a' is not positive definite"),
        ({"mean": np.array([[4.0, 1.0, 0, 0], [np.nan, 0, 0, 0]])}, "mean of 'b' is .*nan"),
        ({"radii": np.array([0.3])}, r"radii of 2 people has shape \(1,\); give \(2,\)"),
    ],
    ids=["known exactly", "not a number", "shape"],
)
def test_a_belief_that_makes_no_sense_is_refused_by_name(crowd, changes, message):
    mean = np.array([[4.0, 1.0, 0.0, 0.0], [5.0, -1.0, 0.0, 0.0]])
    numbers = {
        "mean": mean, "covariance": np.tile(0.01 * np.eye(4), (2, 1, 1)),
        "radii": np.full(2, 0.3), **changes,
    }  # fmt: skip
    with pytest.raises(ValueError, match=message):
        plan(forked(crowd=crowd), belief=Belief(names=("a", "b"), Qc=0.1, **numbers))


def test_without_time_for_routes_there_is_one_and_the_plan_says_so():
    wall = OccupancyGrid.from_polygons([[(3, -1), (5, -1), (5, 1), (3, 1)]], (-1, -4, 9, 4), 0.1)
    scenario = forked(grid=wall, plans=(), count=2, goal=np.array([8.0, 0.0]))
    assert len(plan(scenario).components) == 2
    hasty = plan(scenario, deadline=1e-9)
    assert len(hasty.components) == 1
    assert "1 of 2 routes found in the time for it" in hasty.warnings


@pytest.mark.parametrize("deadline", [-0.1, np.nan])
def test_a_deadline_that_is_no_time_is_refused(deadline):
    with pytest.raises(ValueError, match=r"deadline must be .* got"):
        plan(forked(), deadline=deadline)


def test_who_is_touched_already_is_named():
    mixture = plan(forked(track("near", 0.3, 0.0), track("far", 3.0, 0.0)))
    contacts = [warning for warning in mixture.warnings if "in contact" in warning]
    assert contacts == ["in contact with near now, by 0.25 m"]


def test_no_hypotheses_at_all_is_no_plan():
    with pytest.raises(NoPlan, match="gave none"):
        plan(forked(), hypotheses=lambda scenario, belief: ())
