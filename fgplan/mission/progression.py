"""Formula progression: what is still required after a letter.

A requirement is a monotone Boolean function of literals and temporal formulas in negation normal
form, written as its minimal sums of products: that form is unique, so equal requirements are equal
sets, and a mission has finitely many. Temporal formulas are hash-consed: one object for each.

Bacchus and Kabanza, Annals of Mathematics and AI 1998, on progression; Brzozowski 1964, on
derivatives.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

from fgplan.mission.formula import Formula, Op

Letter = frozenset[str]


@dataclass(frozen=True, eq=False)
class Part:
    """A literal or a temporal formula; there is one object for each, so identity is equality.

    Args:
        kind: "literal", "next", "weak next", "until" or "release".
        name: Of a literal.
        positive: Whether a literal is its atom or not.
        left, right: What an until or a release joins; a next has its body in `right`.
        atoms: The propositions it depends on.
    """

    kind: str
    name: str
    positive: bool
    left: Required
    right: Required
    atoms: frozenset[str]


Clause = frozenset[Part]
Required = frozenset[Clause]
"""A disjunction of conjunctions, none of which contains another."""

NOTHING: Required = frozenset([frozenset()])
"""True: nothing is required."""
IMPOSSIBLE: Required = frozenset()
"""False."""

_parts: dict[tuple[str, str, bool, Required, Required], Part] = {}


def required(formula: Formula) -> Required:
    """What a formula requires of a trace, before its first letter."""
    return _normal(formula, True)


def progress(state: Required, letter: Letter) -> Required:
    """What is required of the rest of a trace, after a letter."""
    return _progress(state, letter & atoms(state))


@lru_cache(maxsize=100_000)
def atoms(state: Required) -> frozenset[str]:
    """The propositions that a requirement depends on."""
    return frozenset(name for clause in state for part in clause for name in part.atoms)


def may_end(state: Required) -> bool:
    """Whether the trace may end here: the rest that satisfies the requirement may be empty."""
    return any(all(part.kind in ("release", "weak next") for part in c) for c in state)


def describe(state: Required) -> str:
    """A requirement as the text of a formula."""
    if state == NOTHING:
        return "true"
    if not state:
        return "false"
    clauses = sorted(" & ".join(sorted(map(_describe, clause))) for clause in state)
    return clauses[0] if len(clauses) == 1 else " | ".join(f"({c})" for c in clauses)


def _describe(part: Part) -> str:
    right = describe(part.right)
    if part.kind == "literal":
        name = part.name if part.name.isidentifier() else f'"{part.name}"'
        return name if part.positive else f"!{name}"
    if part.kind == "until" and part.left == NOTHING:
        return f"F({right})"
    if part.kind == "release" and part.left == IMPOSSIBLE:
        return f"G({right})"
    if part.kind == "until":
        return f"(({describe(part.left)}) U ({right}))"
    if part.kind == "release":
        return f"(({describe(part.left)}) R ({right}))"
    return f"{'X[!]' if part.kind == 'next' else 'X'}({right})"


@lru_cache(maxsize=100_000)
def _progress(state: Required, letter: Letter) -> Required:
    return _any(_all(_step(part, letter & part.atoms) for part in clause) for clause in state)


@lru_cache(maxsize=100_000)
def _step(part: Part, letter: Letter) -> Required:
    if part.kind == "literal":
        return NOTHING if (part.name in letter) == part.positive else IMPOSSIBLE
    if part.kind == "next":
        return _all([part.right, _MORE])
    if part.kind == "weak next":
        return _any([part.right, _ENDED])
    still: Required = frozenset([frozenset([part])])
    left, right = progress(part.left, letter), progress(part.right, letter)
    if part.kind == "until":
        return _any([right, _all([left, still])])
    return _all([right, _any([left, still])])


def _normal(f: Formula, positive: bool) -> Required:
    """The requirement of a formula, or of its negation."""
    op, args = f.op, f.args
    if op in (Op.TRUE, Op.FALSE):
        return NOTHING if (op is Op.TRUE) == positive else IMPOSSIBLE
    if op is Op.ATOM:
        return _part("literal", name=f.name, positive=positive)
    if op is Op.NOT:
        return _normal(args[0], not positive)
    if op in (Op.NEXT, Op.WEAK_NEXT):
        kind = "next" if (op is Op.NEXT) == positive else "weak next"
        return _part(kind, right=_normal(args[0], positive))
    if op in (Op.EVENTUALLY, Op.ALWAYS):
        body = _normal(args[0], positive)
        if (op is Op.EVENTUALLY) == positive:
            return _part("until", NOTHING, body)
        return _part("release", IMPOSSIBLE, body)
    if op is Op.IFF:
        same = [_all([_normal(args[0], s), _normal(args[1], s == positive)]) for s in (True, False)]
        return _any(same)
    if op is Op.IMPLIES:
        both = [_normal(args[0], not positive), _normal(args[1], positive)]
        return _any(both) if positive else _all(both)
    if op in (Op.AND, Op.OR):
        parts = [_normal(part, positive) for part in args]
        return _all(parts) if (op is Op.AND) == positive else _any(parts)
    a, b = _normal(args[0], positive), _normal(args[1], positive)
    # a W b = b R (a | b) and a M b = b U (a & b); a negation swaps U with R, and & with |.
    eventual = op in (Op.UNTIL, Op.STRONG_RELEASE)
    if op is Op.WEAK_UNTIL:
        a, b = b, _any([a, b]) if positive else _all([a, b])
    elif op is Op.STRONG_RELEASE:
        a, b = b, _all([a, b]) if positive else _any([a, b])
    return _part("until" if eventual == positive else "release", a, b)


def _part(
    kind: str,
    left: Required = IMPOSSIBLE,
    right: Required = IMPOSSIBLE,
    name: str = "",
    positive: bool = True,
) -> Required:
    key = (kind, name, positive, left, right)
    if key not in _parts:
        named = frozenset([name]) if kind == "literal" else atoms(left) | atoms(right)
        _parts[key] = Part(kind, name, positive, left, right, named)
    return frozenset([frozenset([_parts[key]])])


def _any(parts: Iterable[Required]) -> Required:
    return _shortest(clause for part in parts for clause in part)


def _all(parts: Iterable[Required]) -> Required:
    product = NOTHING
    for part in parts:
        if len(product) == len(part) == 1:
            (one,), (other,) = product, part
            product = frozenset([one | other])
        else:
            product = _shortest(one | other for one in product for other in part)
        if not product:
            break
    return product


def _shortest(clauses: Iterable[Clause]) -> Required:
    """Without the clauses that contain another."""
    kept: list[Clause] = []
    for clause in sorted(set(clauses), key=len):
        if not any(small <= clause for small in kept):
            kept.append(clause)
    return frozenset(kept)


_MORE = _part("until", NOTHING, NOTHING)
"""There is another letter."""
_ENDED = _part("release", IMPOSSIBLE, IMPOSSIBLE)
"""There is none."""
