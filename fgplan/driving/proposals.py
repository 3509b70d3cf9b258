"""The hypotheses of one step: every route, and waiting on it, priced in one currency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgplan.crowd import Belief
from fgplan.driving.pricing import Blockage, Pricing, congestion, delay
from fgplan.driving.routing import Way
from fgplan.hypotheses import hypothesise
from fgplan.hypothesis import Hypothesis, Start
from fgplan.labels import JOINED, OF_LEVELS, WAITING
from fgplan.scenario import Scenario
from fgplan.starts import Starts, starts
from fgplan.timing import along, speed_along, timed, waiting_law

APART = 1.0
"""From the edge of a robot that waits to those who block the way [m]."""


@dataclass(frozen=True, eq=False)
class Price:
    """J of a route, by what it is made of [s].

    Args:
        way: Time at the preferred speed.
        blockage: What people who stand in the way are expected to cost.
        crowd: What people on the part beyond the horizon are expected to cost.
        blocked_at: How far along the first blockage is [m], inf where there is none.
    """

    way: float
    blockage: float
    crowd: float
    blocked_at: float

    @property
    def total(self) -> float:
        """J [s]."""
        return self.way + self.blockage + self.crowd


def price(
    way: Way,
    scenario: Scenario,
    belief: Belief,
    blockages: Sequence[Blockage],
    settings: Pricing,
) -> Price:
    """What a route costs from where the robot is."""
    blocked, at = delay(way, blockages, scenario, settings)
    crowd = congestion(way, scenario, belief, settings)
    return Price(way.to_go / scenario.robot.preferred_speed, blocked, crowd, at)


def propose(
    scenario: Scenario,
    belief: Belief,
    ways: Sequence[tuple[Way, Price]],
    followed: str | None,
    commitment: float,
    wait: float,
    others: Sequence[Hypothesis] = (),
    tries: Starts = starts,
) -> tuple[Hypothesis, ...]:
    """w_i = softmax(−β J_i + log of a stated weight − commitment, unless i is followed).

    Args:
        scenario: What is known now.
        belief: The people.
        ways: Routes with their prices.
        followed: Name of the hypothesis that was followed until now.
        commitment: [nats].
        wait: How long to wait for a blockage at least [s]; 0 proposes no waiting.
        others: Hypotheses from elsewhere; their `log_prior` stands beside −β (J_i − min J).
        tries: Where the optimiser starts from on a route.
    """
    if not ways and not others:
        return tuple(hypothesise(scenario.replace(goal=None, plans=()), belief))
    beta = scenario.density.beta
    least = min((cost.total for _, cost in ways), default=0.0)
    found: list[Hypothesis] = []
    for way, cost in ways:
        score = way.log_weight - beta * (cost.total - least)
        found.append(_pushing_on(scenario, belief, way, cost, score, tries))
        reach = scenario.robot.preferred_speed * scenario.density.horizon
        if wait > 0 and cost.blocked_at < reach:
            # Waiting for those who block the way is in J of the route already.
            found.append(_waiting(scenario, way, cost, score, max(cost.blockage, wait)))
    found += others
    scores = [
        h.log_prior - (commitment if followed is not None and route(h.label) != followed else 0.0)
        for h in found
    ]
    total = np.logaddexp.reduce(scores)
    return tuple(
        replace(h, log_prior=float(score - total)) for h, score in zip(found, scores, strict=True)
    )


def route(label: str) -> str:
    """The route a hypothesis is on: waiting on a route does not leave it, nor does what a level
    below does on it."""
    return label.partition(OF_LEVELS)[0].removesuffix(WAITING)


def route_of(label: str, followed: str | None) -> str:
    """The route of a component, whose label joins all hypotheses that ended in it."""
    routes = [route(part) for part in label.split(JOINED)]
    return followed if followed in routes else routes[0]


def _pushing_on(
    scenario: Scenario, belief: Belief, way: Way, cost: Price, score: float, tries: Starts
) -> Hypothesis:
    robot = scenario.robot
    plan = timed(
        way.path,
        speed=robot.preferred_speed,
        acceleration=robot.max_acceleration,
        velocity=robot.velocity,
        times=scenario.density.times,
        end_speed=scenario.goal_speed,
    )
    found = tries(scenario, belief, plan, way.path)
    return Hypothesis(way.label, score, plan, cost.total, found, way.path)


def _waiting(scenario: Scenario, way: Way, cost: Price, score: float, pause: float) -> Hypothesis:
    """The same route, with a stop before those who block it."""
    robot = scenario.robot
    place = max(cost.blocked_at - robot.radius - APART, 0.0)
    law = waiting_law(
        way.length,
        robot.preferred_speed,
        robot.max_acceleration,
        speed_along(way.path, robot.velocity),
        place / robot.preferred_speed + pause,
        scenario.goal_speed,
        place,
    )
    plan = along(way.path, scenario.density.times, law)
    label = way.label + WAITING
    return Hypothesis(label, score, plan, cost.total, (Start("plan", plan),), way.path)
