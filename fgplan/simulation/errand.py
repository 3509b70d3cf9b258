"""What a robot did of its mission, in truth: the letters of where it was, not those it reports."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

import numpy as np

from fgplan.errors import NoRoute
from fgplan.hypotheses import itineraries_of
from fgplan.mission import Mission, satisfies
from fgplan.regions import Letter, word_along
from fgplan.scenario import Scenario


class State(StrEnum):
    """How a mission stands."""

    NONE = ""
    OPEN = "open"
    SATISFIED = "satisfied"
    FAILED = "failed"


class Errand:
    """The mission of one run as it is executed.

    Args:
        scenario: At the start; without a mission there is nothing to do, and it is done.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._mission: Mission | None = scenario.mission
        if self._mission is not None:
            asked = self._mission.atoms
            self._regions = tuple(r for r in scenario.regions if r.name in asked)
            here = scenario.robot.position
            self.moved(here, here)

    def told(self, facts: Mapping[str, bool]) -> None:
        """New facts; they are read with the next motion."""
        if self._mission is not None and facts:
            self._mission = self._mission.told(facts)

    def moved(self, before: Any, now: Any) -> None:
        """The robot went straight from one point to another, each of shape (2,) [m]."""
        if self._mission is not None:
            for letter in word_along(self._regions, np.array([before, now], dtype=float)):
                self._mission = self._mission.advance(letter)

    @property
    def word(self) -> tuple[Letter, ...]:
        """The letters of where it was, with the facts."""
        return () if self._mission is None else self._mission.trace

    @property
    def state(self) -> State:
        """By the definition of satisfaction, not by the planner's automaton."""
        if self._mission is None:
            return State.NONE
        if satisfies(self.word, self._mission.formula):
            return State.SATISFIED
        return State.FAILED if self._mission.failed else State.OPEN

    @property
    def done(self) -> bool:
        """Whether a run may end."""
        return self.state in (State.NONE, State.SATISFIED)


def way_of(scenario: Scenario) -> float | None:
    """Length of the shortest way to do a mission [m]; None without one, or where there is none."""
    if scenario.mission is None:
        return None
    try:
        return itineraries_of(scenario, 1)[0].length
    except NoRoute:
        return None
