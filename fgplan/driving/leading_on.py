"""Whether a plan leads to where a way goes on.

A plan that touches nobody up to its horizon may end between people and a wall, and by the time its
own command is not clear there may be no way left. Among people who are held at their prediction a
plan is therefore driven as long as, a second along it, there is a way over the whole horizon of
`WayOut`. Where people are planned, too, they make way, which that search does not know.

Reference:
    Fraichard and Asama, Inevitable collision states: a step towards safer robots?, Advanced
    Robotics 18(10), 2004.
"""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numpy as np

from fgplan.driving.following import at_start_of, shifted
from fgplan.driving.guard import Judge
from fgplan.driving.way_out import WayOut
from fgplan.trajectory import Trajectory

AHEAD = 1.0
"""How far along the plan the way must begin [s]: to leave the plan takes time."""


def leads_on(
    search: WayOut, judge: Judge, plan: Trajectory, tolerance: float, until: float = np.inf
) -> bool:
    """Whether a plan that is clear can be driven on from; one that arrives can, as who stands is
    not at fault, and so can one for which there was no time to look.

    Args:
        search: How a way is looked for.
        judge: Map, robot and people now.
        plan: From now on.
        tolerance: The goal is reached this near to it [m].
        until: When to give up, as `perf_counter` counts [s].
    """
    scenario, belief = judge.scenario, judge.belief
    if scenario.crowd == "joint" or not belief.count:
        return True
    goal = scenario.goal
    if goal is not None and np.linalg.norm(plan.positions[-1] - goal) <= tolerance:
        return True
    ahead = shifted(plan, AHEAD, scenario.density.times)
    later = scenario.replace(robot=at_start_of(ahead, scenario.robot), now=scenario.now + AHEAD)
    people = replace(belief, mean=belief.expected(np.array([AHEAD]))[0])
    way = search.search(later, people, ahead, until)
    return search.whole(way) or perf_counter() > until
