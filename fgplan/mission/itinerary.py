"""K best itineraries of a mission: best-first search over automaton × places.

A node is a state of the automaton and a place; an edge is one leg to a place whose letter changes
the state, in one homotopy class. An itinerary's class is therefore the sequence of places at which
the automaton moves, with the winding of each leg about the obstacles and about what it must not
enter: two itineraries are never two drawings of one.
"""

from __future__ import annotations

import heapq
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count as counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgplan.errors import NoMissionRoute
from fgplan.labels import AT_ONCE
from fgplan.mission.automaton import Automaton
from fgplan.mission.mission import Mission
from fgplan.mission.places import Leg, Places, places, room_for
from fgplan.mission.progression import Letter
from fgplan.occupancy import OccupancyGrid
from fgplan.regions import Region

Array = NDArray[np.float64]

MOST_POPS = 20_000
"""Of the search, so that a mission with very many ways ends with fewer."""


@dataclass(frozen=True, eq=False)
class Itinerary:
    """One way to do what a mission still requires.

    Args:
        label: The stops in their order, and a number where ways to them differ.
        path: Vertices from the robot on, shape (N, 2), N ≥ 2 [m].
        length: [m].
        stops: The regions at which the automaton moves, in order.
        ends: Index in `path` of the end of each leg.
        signature: For each leg: its stop, the regions it is led around, and its winding about
            each obstacle. Two itineraries are of one class when these are equal.
        word: The letters read along it, facts included, that of the start first.
    """

    label: str
    path: Array
    length: float
    stops: tuple[Letter, ...]
    ends: tuple[int, ...]
    signature: tuple[Any, ...]
    word: tuple[Letter, ...]

    @property
    def ahead(self) -> Array:
        """The path to the first stop, shape (N, 2), N ≥ 2 [m]."""
        return self.path[: self.ends[0] + 1] if self.ends else self.path


@dataclass(frozen=True, eq=False)
class _Walk:
    """Part of an itinerary: where it has come to, and its last leg."""

    state: int
    place: int
    length: float
    leg: Leg | None = None
    before: _Walk | None = None
    stop: Letter = frozenset()

    @property
    def legs(self) -> list[_Walk]:
        walk, found = self, []
        while walk.before is not None:
            found.append(walk)
            walk = walk.before
        return found[::-1]


def itineraries(
    mission: Mission,
    grid: OccupancyGrid | None,
    regions: tuple[Region, ...],
    start: Any,
    radius: float,
    count: int,
    end: Any = None,
    first: int | None = None,
) -> tuple[Itinerary, ...]:
    """At most `count` itineraries, the shortest first, each accepted by the mission's automaton.

    Args:
        mission: What is asked; what it has read before counts.
        grid: The map; None: open space.
        regions: All regions of the scenario.
        start: Where the robot is, shape (2,) [m].
        radius: Of the robot [m].
        count: How many, at least 1.
        end: Where to be when the mission is done, shape (2,) [m]; None: where it gets done.
        first: Classes of the first leg to look at, for each of its ends: while driving that leg
            alone is searched anew every time. None: as many as itineraries.

    Returns:
        A mission that is done and has no end to go to gives one itinerary that stays.

    Raises:
        MissionError: a name in it is neither region nor fact.
        NoMissionRoute: nothing on this map does what is required; it names what is in the way.
        ValueError: count is below 1.
    """
    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}")
    search = _Search(mission, grid, regions, np.asarray(start, dtype=float), radius, end)
    return search.best(count, count if first is None else first)


@dataclass(frozen=True)
class Rules:
    """What the automaton's state says about where the robot may be now.

    Args:
        forbidden: Regions of this map to be in which would fail the mission.
        held: Regions to leave which would.
    """

    forbidden: tuple[str, ...] = ()
    held: tuple[str, ...] = ()


def rules(
    mission: Mission,
    grid: OccupancyGrid | None,
    regions: tuple[Region, ...],
    position: Any,
    radius: float,
) -> Rules:
    """What a mission requires of every place from now on, until its state changes.

    Args:
        mission: What is asked, and what it has read.
        grid: The map; None: open space.
        regions: All regions of the scenario.
        position: Where the robot is, shape (2,) [m].
        radius: Of the robot [m].

    Raises:
        MissionError: a name in it is neither region nor fact.
    """
    here = np.asarray(position, dtype=float)
    return _Search(mission, grid, regions, here, radius, None).rules()


class _Search:
    def __init__(
        self,
        mission: Mission,
        grid: OccupancyGrid | None,
        regions: tuple[Region, ...],
        start: Array,
        radius: float,
        end: Any,
    ) -> None:
        mission.check_names(region.name for region in regions)
        closed = mission.closed
        spoken = tuple(r for r in regions if r.name in mission.atoms | closed)
        self.end = None if end is None else np.asarray(end, dtype=float)
        points = [start] if self.end is None else [start, self.end]
        room = (0.0, 0.0, 0.0, 0.0) if grid is not None else room_for(points, spoken)
        self.map: Places = places(grid, spoken, closed, radius, room)
        self.start = start
        self.first = 1
        self.known = mission.known
        self.mission = mission.advance(self.map.at(start))
        self.automaton = Automaton.build(
            self.mission.remaining, [letter | self.known for letter in self._letters]
        )

    @cached_property
    def _letters(self) -> tuple[Letter, ...]:
        nothing: Letter = frozenset()
        return tuple(dict.fromkeys((nothing, self.map.at(self.start), *self.map.letters)))

    def best(self, count: int, first: int) -> tuple[Itinerary, ...]:
        self.first = first
        if 0 not in self.automaton.live:
            raise self._no_route()
        walks = []
        for walk in self._walks(count):
            walks.append(walk)
            if len(walks) == count:
                break
        if not walks:
            raise self._no_route()
        return _labelled([self._itinerary(walk) for walk in walks])

    def rules(self) -> Rules:
        """What every letter that does not fail the mission has in common."""
        step, live = self.automaton.step, self.automaton.live
        if 0 not in live:
            return Rules()
        here = self.map.at(self.start)
        good = [x for x in self._letters if x == here or step(0, x | self.known) in live]
        names = [region.name for region in self.map.regions]
        return Rules(
            tuple(name for name in names if not any(name in letter for letter in good)),
            tuple(name for name in names if all(name in letter for letter in good)),
        )

    # The search

    def _walks(self, count: int) -> Iterator[_Walk]:
        """Complete walks by length."""
        tie = counter()
        popped: Counter[tuple[int, int, bool]] = Counter()
        first = _Walk(0, -1, 0.0)
        queue: list[Any] = [(self._ahead(0, -1), next(tie), first, False)]
        for _ in range(MOST_POPS):
            if not queue:
                return
            bound, _, walk, complete = heapq.heappop(queue)
            node = (walk.state, walk.place, complete)
            popped[node] += 1
            if popped[node] > count or not np.isfinite(bound):
                continue  # the K best go through a node at most K times
            if complete:
                yield walk
                continue
            for after, finished in self._onwards(walk, count):
                bound = after.length + (0.0 if finished else self._ahead(after.state, after.place))
                heapq.heappush(queue, (bound, next(tie), after, finished))

    def _onwards(self, walk: _Walk, count: int) -> Iterator[tuple[_Walk, bool]]:
        """The walk with one more leg in each class, and the walk as a complete one."""
        if walk.state in self.automaton.accepting:
            if self.end is None:
                yield walk, True
            else:
                for leg in self._legs(walk, None, self._roam(walk.state), count):
                    if self._read(walk.state, leg) in self.automaton.accepting:
                        yield self._longer(walk, walk.state, -2, leg, frozenset()), True
        for target, place in enumerate(self.map.places):
            if target == walk.place or not np.isfinite(self._lower(walk.place, target)):
                continue
            for allowed in self._ways(walk.state, self._letter(walk.place), place.letter):
                for leg in self._legs(walk, target, allowed, count):
                    state = self._read(walk.state, leg)
                    if state in self.automaton.live and self._differs(state, walk.state):
                        yield self._longer(walk, state, target, leg, place.letter), False

    def _longer(self, walk: _Walk, state: int, place: int, leg: Leg, stop: Letter) -> _Walk:
        return _Walk(state, place, walk.length + leg.route.length, leg, walk, stop)

    def _ways(self, state: int, here: Letter, there: Letter) -> Iterator[frozenset[Letter]]:
        """Where a leg may lead, as letters: those that leave the state as it is, with its ends'.
        Where leaving everything moves the automaton by itself, it may do that first."""
        steps = [state]
        outside = self.automaton.step(state, self.known)
        if here and outside in self.automaton.live and self._differs(outside, state):
            steps.append(outside)
        for via in steps:
            after = self.automaton.step(via, there | self.known)
            if after in self.automaton.live and self._differs(after, via):
                middle: frozenset[Letter] = frozenset() if via == state else frozenset([_NOTHING])
                yield self._roam(via) | middle | {here, there}

    def _roam(self, state: int) -> frozenset[Letter]:
        """Letters that change nothing."""
        step = self.automaton.step
        return frozenset(
            letter
            for letter in self._letters
            if not self._differs(step(state, letter | self.known), state)
        )

    def _legs(
        self, walk: _Walk, target: int | None, allowed: frozenset[Letter], count: int
    ) -> tuple[Leg, ...]:
        if target is None:
            assert self.end is not None
            allowed = allowed | {self._letter(walk.place)}
            if walk.place < 0:
                return self.map.legs(self.start, self.end, allowed, min(count, self.first))
            return self.map.onwards(walk.place, self.end, allowed, count)
        if walk.place < 0:
            goal = self.map.places[target].anchor
            return self.map.legs(self.start, goal, allowed, min(count, self.first))
        return self.map.between(walk.place, target, allowed, count)

    def _read(self, state: int, leg: Leg) -> int:
        for letter in leg.word:
            state = self.automaton.step(state, letter | self.known)
        return state

    def _differs(self, a: int, b: int) -> bool:
        return self.automaton.classes[a] != self.automaton.classes[b]

    def _letter(self, place: int) -> Letter:
        return self.map.at(self.start) if place < 0 else self.map.places[place].letter

    # Bounds

    def _lower(self, place: int, target: int) -> float:
        """At most the length of a leg."""
        if place < 0:
            return float(self._from_start[target])
        return float(self._distances[place, target])

    @cached_property
    def _from_start(self) -> Array:
        every = range(len(self.map.places))
        return np.array([self.map.distance(i, self.start) for i in every], dtype=float)

    @cached_property
    def _distances(self) -> Array:
        every = range(len(self.map.places))
        points = [place.anchor for place in self.map.places]
        return np.array([[self.map.distance(i, p) for i in every] for p in points], dtype=float)

    def _ahead(self, state: int, place: int) -> float:
        """At most the length that is still to go."""
        if place < 0:
            to = [
                self._lower(-1, target) + self._to_go.get((after, target), np.inf)
                for after, target in self._moves(state, self._letter(-1))
            ]
            stays = state in self.automaton.accepting
            return min([*to, 0.0 if stays else np.inf])
        return self._to_go.get((state, place), np.inf)

    def _moves(self, state: int, here: Letter) -> Iterator[tuple[int, int]]:
        """States and places that one leg may lead to, whatever it passes on the way."""
        steps = {state, self.automaton.step(state, self.known)} & self.automaton.live
        for target, place in enumerate(self.map.places):
            for via in steps:
                after = self.automaton.step(via, place.letter | self.known)
                if after in self.automaton.live:
                    yield after, target

    @cached_property
    def _to_go(self) -> dict[tuple[int, int], float]:
        """Bound of what is to go from each state and place, by Dijkstra from the accepting ones."""
        before: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)
        for state in self.automaton.live:
            for after, target in self._moves(state, frozenset()):
                for place in range(len(self.map.places)):
                    before[after, target].append((state, place))
        done: dict[tuple[int, int], float] = {}
        queue = [
            (0.0, (state, place))
            for state in self.automaton.accepting
            for place in range(len(self.map.places))
        ]
        heapq.heapify(queue)
        while queue:
            length, node = heapq.heappop(queue)
            if node in done or not np.isfinite(length):
                continue
            done[node] = length
            for other in before[node]:
                if other not in done:
                    step = float(self._distances[other[1], node[1]])
                    heapq.heappush(queue, (length + step, other))
        return done

    # Results

    def _itinerary(self, walk: _Walk) -> Itinerary:
        parts, ends, signature = [self.start[None]], [], []
        for step in walk.legs:
            assert step.leg is not None
            parts.append(step.leg.route.path[1:])
            ends.append(sum(map(len, parts)) - 1)
            around = tuple(tuple(sorted(letter)) for letter in step.leg.round)
            signature.append((tuple(sorted(step.stop)), around, step.leg.route.signature))
        path = np.vstack(parts)
        if len(path) == 1:
            path = np.vstack([path, path])
        stops = tuple(step.stop for step in walk.legs if step.stop)
        word = [letter | self.known for letter in self.map.word(path)]
        label = ">".join(AT_ONCE.join(sorted(stop)) for stop in stops) or "goal"
        if not walk.legs:
            label = "done"
        return Itinerary(
            label, path, walk.length, stops, tuple(ends), tuple(signature), tuple(word)
        )

    def _no_route(self) -> NoMissionRoute:
        """Which of the regions that are asked for cannot be reached, or what else is in the way."""
        mission, text = self.mission, self.mission.text
        head = f"mission {text!r}: "
        if mission.failed:
            return NoMissionRoute(f"{head}has failed: nothing can satisfy {text!r} any more")
        head += f"what is required, {mission.requires}, cannot be done on this map: "
        shut = sorted(mission.closed & mission.atoms)
        if shut:
            are = "is" if len(shut) == 1 else "are"
            return NoMissionRoute(f"{head}{', '.join(shut)} {are} closed", tuple(shut))
        wanted = self._wanted()
        if wanted is None:
            return NoMissionRoute(f"{head}it asks to be in regions at once that do not overlap")
        missing = [n for n in wanted if not self._places_in(n)]
        far = [n for n in wanted if n not in missing and not self._leads_to(n)]
        guarded: list[str] = []
        if not missing and not far:
            guarded = [n for n in wanted if not self._reached(n)]
        for names, what in (
            (missing, "the robot fits nowhere on the map in {}"),
            (far, "nothing leads to {}"),
            (guarded, "{} cannot be reached without entering what is forbidden"),
        ):
            if names:
                return NoMissionRoute(head + what.format(", ".join(names)), tuple(names))
        return NoMissionRoute(head + "each region can be reached, but not in an order it allows")

    def _wanted(self) -> list[str] | None:
        """The regions without which it cannot be done, or, where no single one is needed, all;
        None where even with a place in each region it could not."""
        names = [region.name for region in self.map.regions]
        letters = (*self._letters, *(frozenset([name]) for name in names))
        automaton = Automaton.build(self.mission.remaining, [x | self.known for x in letters])
        if 0 not in automaton.live:
            return None
        return [name for name in names if not _without(automaton, name)] or names

    def _places_in(self, name: str) -> list[int]:
        return [i for i, place in enumerate(self.map.places) if name in place.letter]

    def _leads_to(self, name: str) -> bool:
        return any(np.isfinite(self._from_start[i]) for i in self._places_in(name))

    def _reached(self, name: str) -> bool:
        """Whether a leg leads from the start to a region without what fails the mission."""
        step = self.automaton.step
        dead = {x for x in self._letters if step(0, x | self.known) not in self.automaton.live}
        allowed = (frozenset(self._letters) - dead) | {self.map.at(self.start)}
        return any(
            self.map.legs(self.start, place.anchor, allowed, 1)
            for place in self.map.places
            if name in place.letter and place.letter in allowed
        )


_NOTHING: Letter = frozenset()


def _without(automaton: Automaton, name: str) -> bool:
    """Whether something is accepted that never is in a region."""
    assert automaton.letters is not None
    seen, queue = {0}, [0]
    while queue:
        state = queue.pop()
        if state in automaton.accepting:
            return True
        for letter in automaton.letters:
            after = automaton.step(state, letter)
            if name not in letter and after not in seen:
                seen.add(after)
                queue.append(after)
    return False


def _labelled(found: list[Itinerary]) -> tuple[Itinerary, ...]:
    """With a number after labels that are not unique."""
    often = Counter(one.label for one in found)
    nth: Counter[str] = Counter()
    result = []
    for one in found:
        nth[one.label] += 1
        more = f" #{nth[one.label]}" if often[one.label] > 1 else ""
        result.append(replace(one, label=one.label + more))
    return tuple(result)
