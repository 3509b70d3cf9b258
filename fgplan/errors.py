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


class NoMissionRoute(NoRoute):
    """No route on this map does what the mission still requires; `regions` are those in the way
    of it: which cannot be reached, or are not on the map."""

    def __init__(self, message: str, regions: tuple[str, ...] = ()) -> None:
        self.regions = regions
        super().__init__("NO_VALID_PATH", message)


class MissionError(FgplanError, ValueError):
    """A mission that cannot be read, or that nothing can satisfy; `place` is where in its text:
    the first character and the one after the last."""

    def __init__(self, text: str, place: tuple[int, int], message: str) -> None:
        self.text = text
        self.place = place
        start, end = place
        line_start = text.rfind("\n", 0, start) + 1
        line = text[line_start:].partition("\n")[0]
        under = " " * (start - line_start) + "^" * max(1, min(end - start, len(line)))
        row = f"line {text.count(chr(10), 0, start) + 1}, " if "\n" in text else ""
        where = f"{row}column {start - line_start + 1}"
        super().__init__(f"mission, {where}: {message}\n  {line}\n  {under}")


class NoPlan(FgplanError):
    """No hypothesis has a finite posterior; `evidence` holds what each one ended with."""

    def __init__(self, message: str, evidence: tuple[object, ...] = ()) -> None:
        self.evidence = evidence
        super().__init__(message)
