"""Random formulas and traces, for oracles."""

from __future__ import annotations

import random

from fgplan.mission.formula import Formula, Op

NAMES = ("a", "b", "c")
UNARY = (Op.NOT, Op.WEAK_NEXT, Op.NEXT, Op.EVENTUALLY, Op.ALWAYS)
BINARY = (Op.AND, Op.OR, Op.IMPLIES, Op.IFF, Op.UNTIL, Op.RELEASE)
OURS = (Op.WEAK_UNTIL, Op.STRONG_RELEASE)
"""Which other programs do not have."""


def formula(rng: random.Random, depth: int, binary: tuple[Op, ...] = BINARY + OURS) -> Formula:
    """Any formula over `NAMES`, at most so deep."""
    if depth == 0 or rng.random() < 0.15:
        if rng.random() < 0.1:
            return Formula(rng.choice((Op.TRUE, Op.FALSE)))
        return Formula(Op.ATOM, name=rng.choice(NAMES))
    op = rng.choice(UNARY + binary)
    count = 1 if op in UNARY else 2
    return Formula(op, tuple(formula(rng, depth - 1, binary) for _ in range(count)))


def trace(rng: random.Random, longest: int = 7) -> list[frozenset[str]]:
    """One to `longest` letters."""
    length = rng.randint(1, longest)
    return [frozenset(n for n in NAMES if rng.random() < 0.5) for _ in range(length)]
