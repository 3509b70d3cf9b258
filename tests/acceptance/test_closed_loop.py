"""Statements 3, 15 and 16 of the acceptance list, in closed loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from factors.coupling import coupling_to
from factors.measurement import measurement
from fgplan import FieldOfView, GtsamLM
from fgplan.model import Model, Term
from fgplan.simulation.driver import Fgplan
from fgplan.simulation.episode import run
from fgplan.simulation.people import heedless
from fgplan.simulation.sensor import Quality, Sensors
from fgplan.simulation.walkers import Walker, Walkers
from fgplan.simulation.world import Rules
from fgplan.solver import SecondOrder
from tests.fgplan.simulation.worlds import world
from tests.scalar import ROBOT, optimum

STEPS = 60


@pytest.mark.parametrize("solver", [SecondOrder(), GtsamLM()], ids=["second order", "gtsam"])
@pytest.mark.parametrize(
    ("q", "h", "gain"),
    [(1, 0.1, 0.916080), (1, 1, 0.618034), (1, 10, 0.270156), (0.2, 3, None)],
)
def test_3_first_step_gain_of_a_receding_horizon(solver, q, h, gain):
    """The robot replans after each step; every step closes the same share of the way to η."""
    expected = (np.sqrt(q**2 + 4 * q * h) - q) / (2 * h)
    if gain is not None:
        assert expected == pytest.approx(gain, abs=1e-6)
    eta, x = 1.0, 0.0
    for _ in range(4):
        moved = _planned(x, eta, q, h, solver)[1]
        assert (moved - x) / (eta - x) == pytest.approx(expected, abs=1e-8)
        x = moved


def _planned(x, eta, q, h, solver):
    """Positions of a plan from x: a random walk of variance q a step that follows η."""
    walk = measurement((-np.eye(1), np.eye(1)), np.zeros(1), q * np.eye(1))
    follow = coupling_to(np.array([eta]), h, dim=1)
    terms = (
        Term("walk", walk, (("robot", 0), ("robot", 1)), range(STEPS)),
        Term("coupling", follow, (("robot", 0),), range(1, STEPS + 1)),
    )
    fixed = {("robot", 0): np.array([x])}
    start = np.full((STEPS + 1, 1), x)
    m = Model(np.arange(STEPS + 1.0), (ROBOT,), terms, (), fixed, start)
    return optimum(m, solver=solver).state[:, 0]


def driven(people, view=None, goal=(5.0, 0.0), seconds=4.0):
    """Rows (x, y, vx, vy) of the robot, a row a step."""
    made = world(
        people,
        goal=goal,
        sensor=Sensors(Quality(view=view, velocities=True), None, 0),
        people=Walkers(people, heedless),
        rules=Rules(period=0.25, substeps=1, time_limit=seconds),
    )
    made = replace(made, scenario=made.scenario.replace(field_of_view=view, crowd="joint"))
    return run(made, Fgplan()(made)).robot


def standing(x, y):
    place = np.array([x, y])
    return Walker(place, place[None], velocity=np.zeros(2))


def test_15_people_far_away_change_nothing():
    alone = driven([])
    far = driven([standing(2.0, 18.0), standing(-9.0, -14.0)])
    np.testing.assert_allclose(far, alone, atol=1e-8)


def test_15_the_order_of_people_does_not_matter():
    people = [standing(2.5, 0.3), standing(3.5, -0.9)]
    one, other = driven(people), driven(people[::-1])
    np.testing.assert_allclose(one, other, atol=1e-5)


def test_16_nobody_is_there_until_they_come_into_range():
    person, reach = standing(3.5, 0.3), 2.0
    alone = driven([])
    met = driven([person], FieldOfView(range=reach))
    apart = np.linalg.norm(alone[:, :2] - person.position, axis=1)
    first = int(np.argmax(apart <= reach))
    assert first > 2
    # The command of step `first` is the first that knows of the person.
    assert np.array_equal(met[: first + 1], alone[: first + 1])
    assert not np.array_equal(met[first + 1], alone[first + 1])


def test_16_who_is_beside_the_view_does_not_exist():
    person = standing(0.4, 0.9)
    bearing = np.arctan2(0.9, 0.4)
    alone = driven([])
    outside = FieldOfView(angle=2 * bearing - 1e-3)
    inside = FieldOfView(angle=2 * bearing + 1e-3)
    assert np.array_equal(driven([person], outside), alone)
    assert not np.array_equal(driven([person], inside), alone)
