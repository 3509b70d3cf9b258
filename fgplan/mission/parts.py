"""The independent parts of a mission: what can be done, and checked, without looking at the rest.

A mission is a conjunction; two conjuncts that speak of no proposition in common say nothing about
each other: their automata run side by side, and the mission's is the product. Conjuncts that the
rest implies are left out first.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from fgplan.mission.automaton import is_satisfiable
from fgplan.mission.formula import Formula, Op
from fgplan.mission.progression import required


@dataclass(frozen=True)
class Part:
    """Conjuncts that hang together.

    Args:
        atoms: The regions and facts that they speak of, and no other part does.
        conjuncts: In the order of the text.
    """

    atoms: frozenset[str]
    conjuncts: tuple[Formula, ...]

    def __str__(self) -> str:
        return " & ".join(
            f"({c})" if c.op in (Op.OR, Op.IMPLIES, Op.IFF) else str(c) for c in self.conjuncts
        )


def parts(formula: Formula) -> tuple[Part, ...]:
    """The finest parts of a formula that share no proposition, in the order of its text.

    Args:
        formula: In LTLf.
    """
    found: list[Part] = []
    for conjunct in _needed(formula.conjuncts()):
        atoms = conjunct.atoms()
        meets = [part for part in found if part.atoms & atoms]
        rest = [part for part in found if not part.atoms & atoms]
        joined = Part(
            atoms.union(*(part.atoms for part in meets)),
            (*(c for part in meets for c in part.conjuncts), conjunct),
        )
        found = [*rest, joined]
    return tuple(sorted(found, key=lambda part: part.conjuncts[0].span))


def _needed(conjuncts: Sequence[Formula]) -> Iterable[Formula]:
    """Without those that the others imply."""
    kept = list(conjuncts)
    for one in conjuncts:
        others = [c for c in kept if c is not one]
        near = [c for c in others if c.atoms() & one.atoms()]
        denied = Formula(Op.AND, (*near, Formula(Op.NOT, (one,))))
        if (near or not one.atoms()) and not is_satisfiable(required(denied)):
            kept = others
    return kept
