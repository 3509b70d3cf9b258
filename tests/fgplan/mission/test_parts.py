"""Independent parts of a mission."""

from __future__ import annotations

import pytest

from fgplan.mission.automaton import Automaton
from fgplan.mission.formula import Formula, Op
from fgplan.mission.parser import parse
from fgplan.mission.parts import parts
from fgplan.mission.progression import required


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("F A & F B", [{"A"}, {"B"}]),
        ("F (A & F B)", [{"A", "B"}]),
        ("F A & F B & G !C", [{"A"}, {"B"}, {"C"}]),
        ("F A & G (A -> F B) & G !C", [{"A", "B"}, {"C"}]),
        ("F A & F B & F C & G (A -> F C)", [{"A", "C"}, {"B"}]),
        ("(!B U A) & F B & (d -> F E)", [{"A", "B"}, {"d", "E"}]),
        ("F A & true", [{"A"}]),
        ("F A | F B", [{"A", "B"}]),
    ],
)
def test_parts_share_no_proposition(text, expected):
    assert [set(part.atoms) for part in parts(parse(text))] == expected


def test_what_the_rest_implies_couples_nothing():
    """F (A | B) is implied by F A: without it A and B have nothing to do with each other."""
    assert [set(p.atoms) for p in parts(parse("F A & F B & F (A | B)"))] == [{"A"}, {"B"}]


@pytest.mark.parametrize("text", ["F A & F B", "F A & G !C & (!B U D)", "F (A & F B) & F C"])
def test_the_automaton_of_independent_parts_is_the_product(text):
    """States that can still end well multiply; a mission fails when any part does."""

    def alive(formula: Formula) -> int:
        automaton = Automaton.build(required(formula))
        return len(automaton.live)

    whole = parse(text)
    product = 1
    for part in parts(whole):
        product *= alive(Formula(Op.AND, part.conjuncts))
    assert alive(whole) == product


def test_a_part_reads_as_a_formula():
    told = [str(part) for part in parts(parse("F A & (d -> F E) & G !C"))]
    assert told == ["F A", "(d -> F E)", "G !C"]
