"""Where an operator is going who drives by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from fgplan import Density, Level, Robot, Scenario
from fgplan.driving import GoalInference, Observation
from fgplan.shared_control import Candidate, Joystick, Waypoint
from fgplan.timing import timed

LEFT, RIGHT = np.array([6.0, 3.0]), np.array([6.0, -3.0])
CANDIDATES = (Candidate("left", LEFT), Candidate("right", RIGHT))


def listener(*levels):
    density = Density(dt=0.4, horizon=4.0)
    return GoalInference(Scenario(Robot(np.zeros(2)), density=density, levels=levels), CANDIDATES)


@pytest.mark.parametrize("sigma", [0.0, 0.3, 1.0])
def test_a_place_tells_goals_apart_by_bayes_rule_on_the_ways(sigma):
    """p(i | z) ∝ N(z; nearest point of way i, R + σ²)."""
    z, R = np.array([4.0, 0.3]), 0.25 * np.eye(2)
    heard = listener(Level(sigma=sigma)).step(
        Observation(0.0, np.zeros(2), operator=(Waypoint(z, R),))
    )
    robot, density = Robot(np.zeros(2)), []
    for goal in (LEFT, RIGHT):
        way = timed(
            np.array([[0.0, 0.0], goal]), np.linspace(0, 12, 12001),
            robot.preferred_speed, robot.max_acceleration,
        )  # fmt: skip
        off = way.positions - z
        gap = off[np.argmin(np.sum(off**2, axis=1))]
        density.append(multivariate_normal(cov=R + sigma**2 * np.eye(2)).pdf(gap))
    assert heard.probability["left"] == pytest.approx(density[0] / sum(density), abs=1e-4)
    assert heard.probability["left"] > 0.6


@pytest.mark.parametrize("sigma", [0.0, 0.3])
def test_a_stick_is_heard_from_the_first_word_on(sigma):
    ear, found = listener(Level(sigma=sigma)), []
    for k in range(6):
        said = Joystick(0.2 * k, np.array([0.7, 0.4]), 0.3**2 * np.eye(2))
        position = 0.1 * k * np.array([0.9, 0.45])
        heard = ear.step(Observation(0.2 * k, position, np.array([0.4, 0.2]), operator=(said,)))
        found.append(heard.probability["left"])
    assert found[0] > 0.6
    assert found[-1] > 0.9


def test_a_level_without_a_way_of_its_own_is_refused():
    with pytest.raises(ValueError, match="sigma = inf"):
        listener(Level(), Level("free", sigma=np.inf, Qc=0.5))
