"""Whether a trace satisfies a formula, straight from the definition.

It shares no code with the automaton: it checks what the planner and the robot did.
"""

from __future__ import annotations

from collections.abc import Sequence, Set

from fgplan.mission.formula import Formula, Op


def satisfies(trace: Sequence[Set[str]], formula: Formula) -> bool:
    """Whether a trace satisfies a formula.

    Args:
        trace: Letters, at least one; each is the set of the propositions that hold.
        formula: In LTLf.

    Raises:
        ValueError: the trace is empty; LTLf speaks of traces with a first letter.
    """
    if not trace:
        raise ValueError("a trace needs at least one letter")
    return _values(trace, formula)[0]


def _values(trace: Sequence[Set[str]], f: Formula) -> list[bool]:
    """Whether the formula holds at each position of the trace."""
    n = len(trace)
    if f.op is Op.ATOM:
        return [f.name in letter for letter in trace]
    if f.op in (Op.TRUE, Op.FALSE):
        return [f.op is Op.TRUE] * n
    parts = [_values(trace, part) for part in f.args]
    a, b = parts[0], parts[-1]
    here = range(n)
    match f.op:
        case Op.NOT:
            return [not v for v in a]
        case Op.AND:
            return [all(part[i] for part in parts) for i in here]
        case Op.OR:
            return [any(part[i] for part in parts) for i in here]
        case Op.IMPLIES:
            return [not a[i] or b[i] for i in here]
        case Op.IFF:
            return [a[i] == b[i] for i in here]
        case Op.NEXT:
            return [i + 1 < n and a[i + 1] for i in here]
        case Op.WEAK_NEXT:
            return [i + 1 == n or a[i + 1] for i in here]
        case Op.EVENTUALLY:
            return [any(a[i:]) for i in here]
        case Op.ALWAYS:
            return [all(a[i:]) for i in here]
        case Op.UNTIL:
            return [_until(a, b, i) for i in here]
        case Op.WEAK_UNTIL:
            return [_until(a, b, i) or all(a[i:]) for i in here]
        case Op.RELEASE:
            return [_released(a, b, i) or all(b[i:]) for i in here]
        case Op.STRONG_RELEASE:
            return [_released(a, b, i) for i in here]
    raise AssertionError(f.op)


def _until(a: list[bool], b: list[bool], i: int) -> bool:
    """b at some j ≥ i, and a at all positions before it."""
    return any(b[j] and all(a[i:j]) for j in range(i, len(a)))


def _released(a: list[bool], b: list[bool], i: int) -> bool:
    """a at some j ≥ i, and b at all positions up to it."""
    return any(a[j] and all(b[i : j + 1]) for j in range(i, len(a)))
