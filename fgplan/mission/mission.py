"""A mission: what is asked, what is known, and how far the robot is with it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property

from fgplan.errors import MissionError
from fgplan.mission.automaton import check_satisfiable, is_satisfiable
from fgplan.mission.formula import Formula, Op
from fgplan.mission.parser import parse
from fgplan.mission.progression import Letter, Required, describe, may_end, progress, required


@dataclass(frozen=True)
class Fact:
    """A proposition about the world that is no region: "door_closed".

    Args:
        name: What the mission calls it.
        holds: Whether it is true now; it is taken to stay so until somebody says otherwise.
        closes: Name of a region that cannot be entered while it holds; None: of none.
    """

    name: str
    holds: bool = False
    closes: str | None = None


@dataclass(frozen=True)
class Mission:
    """A formula over regions and facts, and the letters read so far.

    A letter is the set of the formula's regions that the robot's centre is in, with the facts that
    hold; one is read whenever that set changes.

    Args:
        text: The formula; `fgplan.mission.parser` has the grammar.
        facts: Propositions that are no regions.
        trace: The letters read so far.

    Raises:
        MissionError: the text is no formula, or nothing can satisfy it; `place` says where.
    """

    text: str
    facts: tuple[Fact, ...] = ()
    trace: tuple[Letter, ...] = ()

    def __post_init__(self) -> None:
        if not self.trace:
            check_satisfiable(self.formula, self.text)

    @cached_property
    def formula(self) -> Formula:
        """What the text spells."""
        return parse(self.text)

    @cached_property
    def atoms(self) -> frozenset[str]:
        """The regions and facts that it speaks of."""
        return self.formula.atoms()

    @cached_property
    def remaining(self) -> Required:
        """What is required of the rest of the trace."""
        state = required(self.formula)
        for letter in self.trace:
            state = progress(state, letter)
        return state

    @property
    def done(self) -> bool:
        """Whether what was read satisfies the mission: the robot may stop here."""
        return bool(self.trace) and may_end(self.remaining)

    @cached_property
    def failed(self) -> bool:
        """Whether nothing can satisfy it any more."""
        return not self.done and not is_satisfiable(self.remaining)

    @property
    def requires(self) -> str:
        """What is still required, as a formula."""
        return describe(self.remaining)

    @cached_property
    def known(self) -> Letter:
        """The facts that hold, of those that the formula speaks of."""
        return frozenset(fact.name for fact in self.facts if fact.holds) & self.atoms

    @property
    def closed(self) -> frozenset[str]:
        """Names of the regions that cannot be entered now."""
        return frozenset(f.closes for f in self.facts if f.holds and f.closes is not None)

    def advance(self, inside: Iterable[str]) -> Mission:
        """The mission after the robot is in these regions (and no others); itself when nothing
        changes that it speaks of."""
        letter = (frozenset(inside) & self.atoms) | self.known
        if self.trace and letter == self.trace[-1]:
            return self
        return dataclasses.replace(self, trace=(*self.trace, letter))

    def told(self, facts: Mapping[str, bool]) -> Mission:
        """The mission with new facts; they are read with the next `advance`.

        Raises:
            ValueError: it does not know such a fact.
        """
        names = [fact.name for fact in self.facts]
        if unknown := [name for name in facts if name not in names]:
            raise ValueError(f"{unknown} are no facts of the mission; it has {names}")
        new = tuple(
            dataclasses.replace(f, holds=facts[f.name]) if f.name in facts else f
            for f in self.facts
        )
        return dataclasses.replace(self, facts=new)

    def check_names(self, regions: Iterable[str]) -> None:
        """Refuse a name that is neither a region nor a fact, or is both.

        Raises:
            MissionError: as said; `place` says where.
        """
        places, facts = set(regions), {fact.name for fact in self.facts}
        for node in self.formula.nodes():
            if node.op is not Op.ATOM:
                continue
            if node.name in places & facts:
                why = f"{node.name!r} is a region and a fact; give one of them another name"
                raise MissionError(self.text, node.span, why)
            if node.name not in places | facts:
                close = get_close_matches(node.name, sorted(places | facts), n=1)
                hint = f"did you mean {close[0]!r}?" if close else _known(places, facts)
                why = f"{node.name!r} is neither a region nor a fact; {hint}"
                raise MissionError(self.text, node.span, why)

    def place_of(self, name: str) -> tuple[int, int]:
        """Where the text first speaks of a region or fact."""
        spans = [n.span for n in self.formula.nodes() if n.op is Op.ATOM and n.name == name]
        return spans[0] if spans else self.formula.span


def _known(places: set[str], facts: set[str]) -> str:
    said = f"the regions are {', '.join(sorted(places)) or 'none'}"
    return said + (f", the facts {', '.join(sorted(facts))}" if facts else "")
