"""Formulas of linear temporal logic on finite traces (LTLf), each with its place in the text.

De Giacomo and Vardi, IJCAI 2013, define them. A trace is a sequence of letters, a letter the set of
the propositions that hold; `docs/missions.md` says what a letter is when a robot drives.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum


class Op(StrEnum):
    """What a formula is made with, spelt as in a mission's text."""

    ATOM = "atom"
    TRUE = "true"
    FALSE = "false"
    NOT = "!"
    AND = "&"
    OR = "|"
    IMPLIES = "->"
    IFF = "<->"
    WEAK_NEXT = "X"
    NEXT = "X[!]"
    EVENTUALLY = "F"
    ALWAYS = "G"
    UNTIL = "U"
    WEAK_UNTIL = "W"
    RELEASE = "R"
    STRONG_RELEASE = "M"


@dataclass(frozen=True)
class Formula:
    """A node of a formula.

    Args:
        op: What it is.
        args: Its parts: none, one or two; & and | join any number.
        name: Of an atom.
        span: Where it stands in the text: the first character and the one after the last.
    """

    op: Op
    args: tuple[Formula, ...] = ()
    name: str = ""
    span: tuple[int, int] = field(default=(0, 0), compare=False)

    def atoms(self) -> frozenset[str]:
        """The propositions it speaks of."""
        return frozenset(node.name for node in self.nodes() if node.op is Op.ATOM)

    def nodes(self) -> Iterator[Formula]:
        """Itself and all its parts."""
        yield self
        for part in self.args:
            yield from part.nodes()

    def conjuncts(self) -> tuple[Formula, ...]:
        """The parts that must all hold: what is joined by & at the top."""
        if self.op is not Op.AND:
            return (self,)
        return tuple(c for part in self.args for c in part.conjuncts())

    def __str__(self) -> str:
        if self.op is Op.ATOM:
            return self.name if self.name.isidentifier() else f'"{self.name}"'
        if not self.args:
            return self.op.value
        parts = [f"({part})" if len(part.args) > 1 else str(part) for part in self.args]
        if len(parts) > 1:
            return f" {self.op.value} ".join(parts)
        space = "" if self.op is Op.NOT or parts[0].startswith("(") else " "
        return f"{self.op.value}{space}{parts[0]}"
