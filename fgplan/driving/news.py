"""What was said in observations that were not used: it waits for the next one that is.

A robot's pose may be wrong while its operator, its map and its mission say what they say once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

import numpy as np

from fgplan.driving.observation import Observation
from fgplan.measuring import Measurement
from fgplan.shared_control import Joystick

Key = tuple[str, str]
"""("goal", ""), ("grid", "") or ("facts", name)."""

TRIES = 3
"""What was said is left out after so many steps in a row that broke with it."""
MOST = 400
"""Sticks that wait, and operator data that is known again, are the newest so many."""


@dataclass(frozen=True, eq=False)
class News:
    """What waits to be used.

    Args:
        waiting: Goal, map and facts, each with its stamp if it came late, and inf if not [s].
        operator: Operator data, each item once.
        since: When what is used of goal, map and facts was said [s].
        heard: Operator data of the last observations that were used.
        broken: How many steps in a row broke that would have used it.
    """

    waiting: Mapping[Key, tuple[float, Any]] = field(default_factory=dict)
    operator: tuple[Measurement, ...] = ()
    since: Mapping[Key, float] = field(default_factory=dict)
    heard: tuple[Measurement, ...] = ()
    broken: int = 0

    def keep(self, new: Observation, stamp: float = np.inf) -> News:
        """With what an observation says that is not used.

        Args:
            new: The observation; what it says is sound.
            stamp: When it was said, if later ones were used already [s].
        """
        said = {key: (stamp, value) for key, value in _said(new)}
        operator = list(self.operator)
        for measurement in new.operator:  # an observation that comes twice says it once
            if not any(_same(measurement, known) for known in (*self.heard, *operator)):
                operator.append(measurement)
        sticks = [m for m in operator if isinstance(m, Joystick)]
        old = {id(m) for m in sticks[:-MOST]}
        kept = tuple(m for m in operator if id(m) not in old)
        return replace(self, waiting={**self.waiting, **said}, operator=kept)

    @property
    def is_tried(self) -> bool:
        """Whether what waits has been tried often enough."""
        return self.broken >= TRIES and bool(self.waiting or self.operator)

    def broke(self, new: Observation) -> News:
        """After a step that broke. What breaks step after step is not tried for ever."""
        known = replace(self, waiting={}, operator=(), broken=0) if self.is_tried else self
        return replace(known.keep(new), broken=known.broken + 1)

    def told(self, new: Observation) -> Observation:
        """An observation and all that waits; what it says itself, or was said since, stands."""
        known = {
            key: value
            for key, (stamp, value) in self.waiting.items()
            if stamp >= self.since.get(key, -np.inf)
        }
        facts = {name: value for (what, name), value in known.items() if what == "facts"}
        return replace(
            new,
            goal=known.get(("goal", "")) if new.goal is None else new.goal,
            grid=known.get(("grid", "")) if new.grid is None else new.grid,
            facts={**facts, **new.facts},
            operator=(*self.operator, *new.operator),
        )

    def used(self, new: Observation) -> News:
        """After an observation that was used, with all that waited."""
        since = {**self.since, **{key: new.time for key, _ in _said(new)}}
        return News(since=since, heard=(*self.heard, *new.operator)[-MOST:])

    def on_new_clock(self) -> News:
        """What was used was said before, whatever its stamps."""
        return replace(self, since={})


def _said(new: Observation) -> Iterable[tuple[Key, Any]]:
    if new.goal is not None:
        yield ("goal", ""), new.goal
    if new.grid is not None:
        yield ("grid", ""), new.grid
    for name, holds in new.facts.items():
        yield ("facts", name), holds


def _same(a: Any, b: Any) -> bool:
    """Whether two things say the same, as a message does that comes twice."""
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    if is_dataclass(a):
        return all(_same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    if isinstance(a, tuple):
        return len(a) == len(b) and all(_same(x, y) for x, y in zip(a, b, strict=True))
    return bool(np.array_equal(a, b))
