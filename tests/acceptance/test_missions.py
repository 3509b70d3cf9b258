"""Statements 30 to 34: missions, through the public functions alone.

The checker is written here: where the regions are, what a trace is, and what the formula says of
it share nothing with the library.
"""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest

from fgplan import GivenPlan, Mission, MissionError, OccupancyGrid, Region, Robot, Scenario, plan
from fgplan.driving import Observation, Outcome, Planner, Settings
from fgplan.errors import NoMissionRoute
from fgplan.hypotheses import itineraries_of
from fgplan.simulation.errand import Errand

CENTRES = {"A": (2.0, 2.0), "B": (8.5, 0.0), "C": (5.0, 2.2), "E": (5.0, -2.2)}
RADII = {"A": 0.6, "B": 0.6, "C": 0.7, "E": 0.6}
REGIONS = tuple(Region.disc(name, CENTRES[name], RADII[name]) for name in CENTRES)
BLOCK = [(4.0, -1.2), (6.0, -1.2), (6.0, 1.2), (4.0, 1.2)]


@pytest.fixture(scope="module")
def grid():
    return OccupancyGrid.from_polygons([BLOCK], (0, -3.4, 10, 3.4), 0.1, border=True)


def visits(path):
    """Names of the regions by the arc length at which a path enters them first."""
    path = np.asarray(path)
    points = np.vstack([a + np.linspace(0, 1, 400)[:, None] * (b - a) for a, b in pairwise(path)])
    found = {}
    for name, centre in CENTRES.items():
        inside = np.flatnonzero(np.hypot(*(points - centre).T) <= RADII[name])
        if len(inside):
            found[name] = (inside[0], inside[-1])
    return found


def side_of_block(path):
    """The angle that a path sweeps about the middle of the block [rad]."""
    points = np.vstack([a + np.linspace(0, 1, 50)[:, None] * (b - a) for a, b in pairwise(path)])
    angle = np.unwrap(np.arctan2(points[:, 1], points[:, 0] - 5.0))
    return angle[-1] - angle[0]


def asked(grid, formula="F (A & F B) & G !C", **changes):
    given = {"grid": grid, "regions": REGIONS, "mission": Mission(formula), "count": 3}
    return Scenario(Robot(np.array([1.0, -2.0])), **{**given, **changes})


def accepted(path):
    """A, later B, never C."""
    seen = visits(path)
    return "A" in seen and "B" in seen and seen["A"][0] < seen["B"][1] and "C" not in seen


def test_30_every_hypothesis_is_accepted(grid):
    mixture = plan(asked(grid))
    assert mixture.components
    for component in mixture.components:
        assert accepted(component.route)


def test_30_a_rejected_one_has_weight_zero(grid):
    through_c = np.array([[1.0, -2.0], [2.0, 2.0], [5.0, 2.2], [8.5, 0.0]])
    around = np.array([[1.0, -2.0], [2.0, 2.0], [2.5, -2.2], [7.5, -2.2], [8.5, 0.0]])
    assert (accepted(through_c), accepted(around)) == (False, True)
    given = (GivenPlan("through C", through_c, 100.0), GivenPlan("around", around, 1.0))
    mixture = plan(asked(grid, plans=given, count=0))
    assert [c.label for c in mixture.components] == ["around"]
    assert np.exp(mixture.components[0].log_prior) == pytest.approx(1.0)


def test_31_hypotheses_are_pairwise_non_homotopic(grid):
    """Both ways round the block are open: the hypotheses sweep other angles about it."""
    found = itineraries_of(asked(grid, "F A & F B"), 4)
    assert len(found) >= 3
    for one, other in combinations(found, 2):
        turns = abs(side_of_block(one.path) - side_of_block(other.path)) > np.pi
        assert turns or one.stops != other.stops


@pytest.mark.parametrize("formula", ["F A & G !A", "(A U B) & G !B", "G (A & !A)", "F (A & !A)"])
def test_33_an_unsatisfiable_mission_is_an_error_that_says_so(formula):
    with pytest.raises(MissionError, match="unsatisfiable"):
        Mission(formula)


def test_33_and_one_that_this_map_cannot_satisfy_as_well(grid):
    with pytest.raises(NoMissionRoute, match="cannot be done on this map"):
        plan(asked(grid, "F (A & C)"))


def test_34_a_goal_met_is_not_visited_again(grid):
    scenario = asked(grid, "F A & F B", count=2)
    planner, errand = Planner(scenario, Settings(period=0.2, deadline=None)), Errand(scenario)
    x, v = scenario.robot.position, np.zeros(2)
    path, headed = [x], []
    for k in range(150):
        decision = planner.step(Observation(0.2 * k, x, v))
        if decision.outcome is Outcome.GOAL_REACHED:
            break
        headed.append(decision.label.split()[0])
        new = x + 0.1 * (v + decision.action.velocity)
        errand.moved(x, new)
        x, v = new, decision.action.velocity
        path.append(x)
    assert decision.outcome is Outcome.GOAL_REACHED
    assert errand.done
    order = sorted(("A", "B"), key=lambda name: visits(path)[name][0])
    change = headed.index(order[1])
    assert set(headed[:change]) == {order[0]}
    assert set(headed[change:]) == {order[1]}
    inside = np.hypot(*(np.array(path) - CENTRES[order[0]]).T) <= RADII[order[0]]
    assert np.sum(np.diff(inside.astype(int)) == 1) == 1  # entered once
