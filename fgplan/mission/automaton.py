"""The automaton of a mission: what is required at each state, and what each letter makes of it.

Its states are requirements (`fgplan.mission.progression`), found from the first one by reading
letters. A letter is looked at only in what the state depends on, so that seven goals to visit need
3⁷ transitions and not 4⁷.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

from fgplan.errors import MissionError
from fgplan.mission.formula import Formula, Op
from fgplan.mission.progression import Letter, Required, atoms, may_end, progress, required

MOST_STATES = 20_000
"""Of an automaton: a mission beyond it is refused, not waited for."""


@dataclass(frozen=True, eq=False)
class Automaton:
    """A deterministic automaton over the letters that can occur.

    Args:
        states: What each state requires of the rest of the trace; state 0 is the first.
        letters: What can occur; None: every set of propositions.
    """

    states: tuple[Required, ...]
    letters: tuple[Letter, ...] | None
    _moves: tuple[dict[Letter, int], ...]

    @classmethod
    def build(cls, start: Required, letters: Iterable[Letter] | None = None) -> Automaton:
        """The automaton that starts with a requirement.

        Raises:
            ValueError: it has more than `MOST_STATES` states.
        """
        alphabet = None if letters is None else tuple(dict.fromkeys(letters))
        number = {start: 0}
        moves: list[dict[Letter, int]] = []
        states = [start]
        while len(moves) < len(states):
            state, row = states[len(moves)], {}
            for letter in _seen(state, alphabet):
                after = progress(state, letter)
                if after not in number:
                    if len(states) >= MOST_STATES:
                        raise ValueError(f"the mission's automaton has over {MOST_STATES} states")
                    number[after] = len(states)
                    states.append(after)
                row[letter] = number[after]
            moves.append(row)
        return cls(tuple(states), alphabet, tuple(moves))

    def step(self, state: int, letter: Letter) -> int:
        """The state after a letter."""
        return self._moves[state][letter & atoms(self.states[state])]

    @cached_property
    def accepting(self) -> frozenset[int]:
        """Where a trace may end."""
        return frozenset(i for i, state in enumerate(self.states) if may_end(state))

    @cached_property
    def live(self) -> frozenset[int]:
        """From where an accepting state can be reached; elsewhere the mission has failed."""
        before = defaultdict(list)
        for i, row in enumerate(self._moves):
            for after in row.values():
                before[after].append(i)
        found, queue = set(self.accepting), list(self.accepting)
        while queue:
            for i in before[queue.pop()]:
                if i not in found:
                    found.add(i)
                    queue.append(i)
        return frozenset(found)

    @cached_property
    def classes(self) -> tuple[int, ...]:
        """A number for each state: states of one number accept the same (Moore's algorithm).

        Two requirements may say the same in other words. Only over stated letters.
        """
        assert self.letters is not None
        number = [int(i in self.accepting) for i in range(len(self.states))]
        while True:
            kinds: dict[tuple[int, ...], int] = {}
            refined = []
            for i in range(len(self.states)):
                row = (number[i], *(number[self.step(i, letter)] for letter in self.letters))
                refined.append(kinds.setdefault(row, len(kinds)))
            if len(kinds) == len(set(number)):
                return tuple(refined)
            number = refined


def compile_formula(formula: Formula, text: str = "") -> Automaton:
    """The automaton of a formula over every set of its propositions.

    Args:
        formula: In LTLf.
        text: What it was read from, for errors.

    Raises:
        MissionError: no trace satisfies the formula, or its automaton is too large.
    """
    check_satisfiable(formula, text)
    return _automaton(formula, text)


def check_satisfiable(formula: Formula, text: str) -> None:
    """Refuse a formula that no trace satisfies; the error underlines the parts that conflict.

    Raises:
        MissionError: as said.
    """
    if is_satisfiable(required(formula)):
        return
    parts = list(formula.conjuncts())
    for part in tuple(parts):
        rest = [other for other in parts if other is not part]
        if rest and not is_satisfiable(required(Formula(Op.AND, tuple(rest)))):
            parts = rest
    place = (parts[0].span[0], parts[-1].span[1])
    texts = [text[slice(*part.span)] or str(part) for part in parts]
    if len(texts) == 1:
        message = f"is unsatisfiable: nothing can do {texts[0]!r}"
    else:
        message = f"is unsatisfiable: nothing can do both {' and '.join(map(repr, texts))}"
    raise MissionError(text, place, message)


def is_satisfiable(start: Required) -> bool:
    """Whether some trace of at least one letter satisfies a requirement."""
    found, queue = {start}, [start]
    while queue:
        state = queue.pop()
        for letter in _promising(state):
            after = progress(state, letter)
            if may_end(after):
                return True
            if after not in found:
                found.add(after)
                queue.append(after)
    return False


def _automaton(formula: Formula, text: str) -> Automaton:
    try:
        return Automaton.build(required(formula))
    except ValueError as error:
        raise MissionError(text, formula.span, str(error)) from None


def _seen(state: Required, alphabet: tuple[Letter, ...] | None) -> Iterator[Letter]:
    """Letters in what a state depends on."""
    names = atoms(state)
    if alphabet is not None:
        yield from dict.fromkeys(letter & names for letter in alphabet)
        return
    yield from _subsets(names)


def _promising(state: Required) -> Iterator[Letter]:
    """All letters, and first those that do what each clause asks for and no more."""
    for clause in state:
        wanted = {name for part in clause for name in _wanted(part.right)}
        wanted |= {p.name for p in clause if p.kind == "literal" and p.positive}
        yield frozenset(wanted)
    yield from _subsets(atoms(state))


def _wanted(state: Required) -> Iterator[str]:
    """Names of the literals that are positive in a requirement."""
    for clause in state:
        for part in clause:
            if part.kind == "literal" and part.positive:
                yield part.name
            else:
                yield from _wanted(part.right)


def _subsets(names: frozenset[str]) -> Iterator[Letter]:
    ordered = sorted(names)
    for size in range(len(ordered), -1, -1):
        for some in combinations(ordered, size):
            yield frozenset(some)
