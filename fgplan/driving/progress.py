"""How far a mission is done: what the robot's way since the last look adds to its trace."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fgplan.mission import Mission
from fgplan.regions import word_along
from fgplan.scenario import Scenario


def progressed(
    scenario: Scenario, before: Any, facts: Mapping[str, bool]
) -> tuple[Mission | None, tuple[str, ...]]:
    """The mission after the robot moved, and which facts it does not know.

    Args:
        scenario: What is known now; its mission is as it was.
        before: Where the robot was, shape (2,) [m]; None: nobody knows, or it jumped.
        facts: New facts.
    """
    mission = scenario.mission
    if mission is None:
        unknown = [f"fact {name!r} without a mission: not used" for name in facts]
        return None, tuple(unknown)
    known = {fact.name: fact.holds for fact in mission.facts}
    unknown = [f"fact {name!r} is none of the mission's: not used" for name in facts.keys() - known]
    new = {name: bool(value) for name, value in facts.items() if known.get(name, value) != value}
    here = scenario.robot.position
    path = np.array([here if before is None else before, here], dtype=float)
    for letter in word_along(scenario.regions, path):
        mission = mission.advance(letter)
    if new:
        mission = mission.told(new).advance(letter)
    return mission, tuple(sorted(unknown))
