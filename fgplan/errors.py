"""What can go wrong, by name. Every error carries the evidence and says how to mend it."""

from __future__ import annotations

from dataclasses import dataclass


class FgplanError(Exception):
    """Root of everything that fgplan raises on purpose."""


@dataclass(frozen=True)
class Mistake:
    """One mistake in a scenario or map: where it is, what was found, how to mend it."""

    path: str
    value: object
    mend: str

    def __str__(self) -> str:
        return f"{self.path}: got {self.value!r}; {self.mend}"


class ScenarioError(FgplanError, ValueError):
    """A scenario that cannot be planned; `mistakes` lists all of them, not only the first."""

    def __init__(self, source: str, mistakes: tuple[Mistake, ...]) -> None:
        self.source = source
        self.mistakes = mistakes
        lines = "\n".join(f"  {mistake}" for mistake in mistakes)
        super().__init__(f"{source}: {len(mistakes)} mistake(s)\n{lines}")


class MapError(FgplanError, ValueError):
    """A map that cannot be read or does not make sense."""


class NoRoute(FgplanError):
    """No collision-free path leads from start to goal. `code` is Nav2's name for the outcome:
    START_OCCUPIED, GOAL_OCCUPIED, START_OUTSIDE_MAP, GOAL_OUTSIDE_MAP or NO_VALID_PATH."""

    def __init__(self, code: str, message: str) -> None:
        self.code = code
        super().__init__(f"{code}: {message}")


class NoPlan(FgplanError):
    """No hypothesis has a finite posterior; `evidence` holds what each one ended with."""

    def __init__(self, message: str, evidence: tuple[object, ...] = ()) -> None:
        self.evidence = evidence
        super().__init__(message)
