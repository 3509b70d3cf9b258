"""Planners by name: fgplan, fgplan with one feature removed, and its peers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from difflib import get_close_matches
from functools import partial

import numpy as np

from fgplan.driving import Settings
from fgplan.errors import FgplanError
from fgplan.simulation.arbitration import BlendingPlanner, TwistMuxPlanner
from fgplan.simulation.driver import Fgplan
from fgplan.simulation.layered import Layered
from fgplan.simulation.peers import OrcaRobot, Straight
from fgplan.simulation.policy import Policy
from fgplan.simulation.world import World
from fgplan.starts import only_plan

Maker = Callable[[World], Policy]
"""Makes a policy for one run; of a world it may know the scenario, the rules and the limits."""

WHOLE = Settings(deadline=None)

PLANNERS: dict[str, Maker] = {
    "fgplan": Fgplan(),
    "fgplan-in-time": Fgplan(settings=Settings()),
    "fgplan-one-hypothesis": Fgplan(count=1),
    "fgplan-one-start": Fgplan(settings=replace(WHOLE, starts=only_plan)),
    "fgplan-no-interaction": Fgplan(density={"alpha": 0.0}),
    "fgplan-no-contact": Fgplan(density={"contact_sigma": np.inf}),
    "fgplan-predicted": Fgplan(crowd="predicted"),
    "fgplan-joint": Fgplan(crowd="joint"),
    "fgplan-no-commitment": Fgplan(settings=replace(WHOLE, commitment=0.0)),
    "fgplan-no-wait": Fgplan(settings=replace(WHOLE, wait=0.0)),
    "fgplan-no-way-out": Fgplan(settings=replace(WHOLE, way_out=None)),
    "fgplan-blending": BlendingPlanner(),
    "fgplan-switching": TwistMuxPlanner(),
    "layered": Layered,
    "layered-global": partial(Layered, people_in="global"),
    "orca": OrcaRobot,
    "straight": Straight,
}


class UnknownPlanner(FgplanError, ValueError):
    """A name that no planner has."""


def named(name: str) -> Maker:
    """The planner of a name.

    Raises:
        UnknownPlanner: there is none.
    """
    if name not in PLANNERS:
        near = get_close_matches(name, PLANNERS, n=3) or sorted(PLANNERS)
        raise UnknownPlanner(f"planner: got {name!r}; give one of {', '.join(near)}")
    return PLANNERS[name]
