"""The text of a mission → its formula, by recursive descent; every error shows its place.

The grammar, loosest first: `<->`, `->` (both to the right), `|`, `&`, then `U W R M` (to the right,
no two kinds without parentheses), then `!`, `X`, `X[!]`, `F`, `G`, `never`. X is the weak next and
X[!] the strong one, as in pylogics. Words read as well: eventually, always, never, until, not, and,
or, implies; `last` is the end of the trace.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple

from fgplan.errors import MissionError
from fgplan.mission.formula import Formula, Op

_TOKEN = re.compile(
    r"\s*(?:(?P<op><->|<=>|->|=>|&&?|\|\|?|!|~|\(|\)|X\[!\])"
    r'|(?P<word>[^\W\d]\w*)|"(?P<quoted>[^"]+)"|(?P<bad>\d\w*|\S))'
)

_SPELLINGS = {
    "<=>": "<->", "=>": "->", "&&": "&", "||": "|", "~": "!", "not": "!", "and": "&", "or": "|",
    "implies": "->", "eventually": "F", "always": "G", "until": "U", "WX": "X", "tt": "true",
    "ff": "false",
}  # fmt: skip
_UNARY = {"!": Op.NOT, "X": Op.WEAK_NEXT, "X[!]": Op.NEXT, "F": Op.EVENTUALLY, "G": Op.ALWAYS}
_TEMPORAL = {"U": Op.UNTIL, "W": Op.WEAK_UNTIL, "R": Op.RELEASE, "M": Op.STRONG_RELEASE}
_JOINS = {"<->": Op.IFF, "->": Op.IMPLIES, "|": Op.OR, "&": Op.AND}
KEYWORDS = frozenset(
    {*_UNARY, *_TEMPORAL, "true", "false", "last", "never"}
    | {word for word in _SPELLINGS if word.isidentifier()}
)
"""Words that are no names."""

DEEPEST = 50
"""Nesting of a formula: more is no mission, and would exhaust Python's stack."""


class _Token(NamedTuple):
    """A symbol or a name; `symbol` is empty for a name, and "end" at the end."""

    symbol: str
    text: str
    start: int
    end: int


def parse(text: str) -> Formula:
    """The formula that a text spells.

    Raises:
        MissionError: it is not a formula; `place` says where.
    """
    return _Parser(text).formula()


def _tokens(text: str) -> list[_Token]:
    tokens, at = [], 0
    while found := _TOKEN.match(text, at):
        kind = str(found.lastgroup)
        start, at = found.start(kind), found.end()
        word = found[kind]
        if kind == "bad":
            what = "a quoted name that does not end" if word == '"' else f"{word!r}"
            raise MissionError(text, (start, at), f"cannot read {what}")
        spelt = _SPELLINGS.get(word, word)
        named = kind == "quoted" or (kind == "word" and word not in KEYWORDS)
        tokens.append(_Token("" if named else spelt, word, start, at))
    return [*tokens, _Token("end", "the end", len(text), len(text))]


class _Parser:
    def __init__(self, text: str) -> None:
        self._text = text
        self._tokens = _tokens(text)
        self._at = 0
        self._depth = 0

    def formula(self) -> Formula:
        if self._next.symbol == "end":
            raise MissionError(self._text, (0, 0), "is empty; give a formula such as 'F A'")
        result = self._iff()
        if self._next.symbol != "end":
            self._fail("expected an operator such as '&' before it")
        return result

    @property
    def _next(self) -> _Token:
        return self._tokens[self._at]

    def _take(self) -> _Token:
        self._at += 1
        return self._tokens[self._at - 1]

    def _fail(self, why: str) -> None:
        token = self._next
        got = token.text if token.symbol == "end" else repr(token.text)
        raise MissionError(self._text, (token.start, token.end), f"got {got}; {why}")

    def _iff(self) -> Formula:
        return self._to_the_right("<->", self._implies)

    def _implies(self) -> Formula:
        return self._to_the_right("->", self._or)

    def _or(self) -> Formula:
        return self._list("|", self._and)

    def _and(self) -> Formula:
        return self._list("&", self._temporal)

    def _list(self, symbol: str, part: Callable[[], Formula]) -> Formula:
        parts = [part()]
        while self._next.symbol == symbol:
            self._take()
            parts.append(part())
        return parts[0] if len(parts) == 1 else _joined(_JOINS[symbol], parts)

    def _to_the_right(self, symbol: str, part: Callable[[], Formula]) -> Formula:
        parts = [part()]
        while self._next.symbol == symbol:
            self._take()
            parts.append(part())
        return self._nested(_JOINS[symbol], parts)

    def _nested(self, op: Op, parts: list[Formula]) -> Formula:
        if len(parts) > DEEPEST:
            self._fail(f"more than {DEEPEST} in a row")
        right = parts.pop()
        while parts:
            right = _joined(op, [parts.pop(), right])
        return right

    def _temporal(self) -> Formula:
        parts, kind = [self._unary()], ""
        while self._next.symbol in _TEMPORAL:
            if kind and self._next.symbol != kind:
                self._fail(f"after {kind!r} it needs parentheses to say which comes first")
            kind = self._take().symbol
            parts.append(self._unary())
        return self._nested(_TEMPORAL[kind], parts) if kind else parts[0]

    def _unary(self) -> Formula:
        self._depth += 1
        if self._depth > DEEPEST:
            self._fail(f"nested more than {DEEPEST} deep")
        token = self._next
        if token.symbol in _UNARY or token.symbol == "never":
            self._take()
            body = self._unary()
            span = (token.start, body.span[1])
            if token.symbol == "never":
                result = Formula(Op.ALWAYS, (Formula(Op.NOT, (body,), span=span),), span=span)
            else:
                result = Formula(_UNARY[token.symbol], (body,), span=span)
        else:
            result = self._primary()
        self._depth -= 1
        return result

    def _primary(self) -> Formula:
        token = self._next
        span = (token.start, token.end)
        if token.symbol == "(":
            self._take()
            inside = self._iff()
            if self._next.symbol != ")":
                self._fail(f"expected ')' for the '(' in column {token.start + 1}")
            return _moved(inside, (token.start, self._take().end))
        if token.symbol == "":
            self._take()
            return Formula(Op.ATOM, name=token.text, span=span)
        if token.symbol in ("true", "false"):
            self._take()
            return Formula(Op(token.symbol), span=span)
        if token.symbol == "last":
            self._take()
            return Formula(Op.WEAK_NEXT, (Formula(Op.FALSE, span=span),), span=span)
        self._fail("expected a formula here: a name, '(', or one of ! X X[!] F G")
        raise AssertionError("unreachable")


def _joined(op: Op, parts: list[Formula]) -> Formula:
    return Formula(op, tuple(parts), span=(parts[0].span[0], parts[-1].span[1]))


def _moved(formula: Formula, span: tuple[int, int]) -> Formula:
    return Formula(formula.op, formula.args, formula.name, span)
