"""Parsing, evaluation and progression of formulas, against each other and against flloat."""

from __future__ import annotations

import random
import warnings

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgplan.errors import MissionError
from fgplan.mission import satisfies
from fgplan.mission.automaton import compile_formula
from fgplan.mission.formula import Formula, Op
from fgplan.mission.parser import parse
from fgplan.mission.progression import describe, may_end, progress, required
from tests.fgplan.mission import formulas

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # it imports sre_parse and leaves its grammar's file open
    from flloat.parser.ltlf import LTLfParser

    ORACLE = LTLfParser()

FLLOAT = {Op.WEAK_NEXT: "WX", Op.NEXT: "X"}
"""What flloat spells differently: its X is the strong next."""


def in_flloat(f: Formula) -> str:
    if not f.args:
        return f.name or f.op.value
    parts = [f"({in_flloat(part)})" for part in f.args]
    op = FLLOAT.get(f.op, f.op.value)
    return f"{op} {parts[0]}" if len(parts) == 1 else f" {op} ".join(parts)


def after(f: Formula, trace: list[frozenset[str]]):
    state = required(f)
    for letter in trace:
        state = progress(state, letter)
    return state


def test_500_formulas_and_traces_agree_with_flloat():
    rng = random.Random(0)
    agreed = {True: 0, False: 0}
    for _ in range(500):
        f, trace = formulas.formula(rng, 4, formulas.BINARY), formulas.trace(rng)
        letters = [{name: name in letter for name in formulas.NAMES} for letter in trace]
        expected = ORACLE(in_flloat(f)).truth(letters, 0)
        assert satisfies(trace, f) == expected, (str(f), trace)
        assert may_end(after(f, trace)) == expected, (str(f), trace)
        agreed[expected] += 1
    assert min(agreed.values()) > 100  # it is not one answer for all


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 2**32))
def test_progression_accepts_what_the_definition_does(seed):
    rng = random.Random(seed)
    f, trace = formulas.formula(rng, 4), formulas.trace(rng)
    assert may_end(after(f, trace)) == satisfies(trace, f)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32))
def test_what_is_still_required_says_the_same_as_a_formula(seed):
    """The rest of a trace satisfies the described requirement when the whole satisfies it."""
    rng = random.Random(seed)
    f, first, rest = formulas.formula(rng, 3), formulas.trace(rng, 3), formulas.trace(rng, 4)
    said = parse(describe(after(f, first)))
    assert satisfies(rest, said) == satisfies(first + rest, f)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32))
def test_a_formula_is_read_back_from_what_it_prints(seed):
    f = formulas.formula(random.Random(seed), 4)
    assert parse(str(f)) == f


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32))
def test_the_automaton_accepts_what_the_definition_does(seed):
    rng = random.Random(seed)
    f = formulas.formula(rng, 3)
    try:
        automaton = compile_formula(f)
    except MissionError:
        assert not any(satisfies(formulas.trace(rng), f) for _ in range(50))
        return
    for _ in range(10):
        trace, state = formulas.trace(rng), 0
        for letter in trace:
            state = automaton.step(state, letter)
        assert (state in automaton.accepting) == satisfies(trace, f)
        if state not in automaton.live:
            assert not satisfies(trace + formulas.trace(rng), f)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("a & b | c", "(a & b) | c"),
        ("a -> b -> c", "a -> (b -> c)"),
        ("a U b & c", "(a U b) & c"),
        ("F a U b", "(F a) U b"),
        ("a U b U c", "a U (b U c)"),
        ("never c", "G !c"),
        ("eventually a and not b until c", "F a & (!b U c)"),
        ("a && b || ~c", "(a & b) | !c"),
        ("last", "X false"),
        ('F "Ward 3"', 'F("Ward 3")'),
    ],
)
def test_what_a_text_means(one, other):
    assert parse(one) == parse(other)


def test_the_nexts_differ_at_the_end():
    end, more = [frozenset()], [frozenset(), frozenset("a")]
    assert [satisfies(end, parse(text)) for text in ("X a", "X[!] a")] == [True, False]
    assert [satisfies(more, parse(text)) for text in ("X a", "X[!] a")] == [True, True]


def test_an_empty_trace_is_refused():
    with pytest.raises(ValueError, match="at least one letter"):
        satisfies([], parse("a"))


@pytest.mark.parametrize(
    ("text", "place", "says"),
    [
        ("F A & & B", (6, 7), "column 7: got '&'; expected a formula here"),
        ("F (A & B", (8, 8), r"column 9: got the end; expected '\)' for the '\(' in column 3"),
        ("A U B R C", (6, 7), "needs parentheses"),
        ("F A B", (4, 5), "expected an operator"),
        ("F 3A", (2, 4), "cannot read '3A'"),
        ("A & $", (4, 5), r"cannot read '\$'"),
        ("", (0, 0), "is empty"),
        ('F "A', (2, 3), "quoted name that does not end"),
        ("F A &\nG (B ->", (13, 13), "line 2, column 8"),
        ("!" * 80 + "A", (50, 51), "nested more than 50 deep"),
    ],
)
def test_a_mistake_shows_its_place(text, place, says):
    with pytest.raises(MissionError, match=says) as caught:
        parse(text)
    assert caught.value.place == place


def test_an_error_underlines_its_place():
    with pytest.raises(MissionError) as caught:
        parse("F A & ) | C")
    assert str(caught.value).splitlines()[1:] == ["  F A & ) | C", "        ^"]


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("F A & F B & G !A", (0, 16)),
        ("F B & G !A & F A & F C", (6, 16)),
        ("F C & X[!] false", (6, 16)),
        ("(A U B) & G !B & F C", (0, 14)),
    ],
)
def test_what_conflicts_is_underlined(text, place):
    with pytest.raises(MissionError, match="unsatisfiable") as caught:
        compile_formula(parse(text), text)
    assert caught.value.place == place


def test_seven_goals_make_128_states_and_3_to_the_7_transitions():
    """Exponential in the goals, which must be, but not in the letters as well."""
    automaton = compile_formula(parse(" & ".join(f"F {name}" for name in "abcdefg")))
    assert len(automaton.states) == 2**7
    assert sum(map(len, automaton._moves)) == 3**7
    assert max(len(state) for state in automaton.states) == 1


def test_a_formula_with_too_many_states_is_refused():
    text = " & ".join(f"F a{i}" for i in range(15))
    with pytest.raises(MissionError, match="over 20000 states"):
        compile_formula(parse(text), text)
