"""Itineraries: accepted by an independent checker, pairwise in other classes, the best of all."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
import pytest

from fgplan import OccupancyGrid
from fgplan.errors import MissionError, NoMissionRoute
from fgplan.mission import Fact, Mission, itineraries, satisfies
from fgplan.regions import Region, word_along
from fgplan.routes import find_routes

RADIUS = 0.25


def box(xmin, ymin, xmax, ymax):
    return np.array([(xmin, ymin), (xmax, ymin), (xmax, ymax), (xmin, ymax)])


@pytest.fixture(scope="module")
def corridors():
    """Three corridors between a hall on the left and one on the right."""
    walls = [box(4, 1, 11, 2), box(4, -2, 11, -1)]
    return OccupancyGrid.from_polygons(walls, (0, -4, 14, 4), 0.1, border=True)


REGIONS = (
    Region.disc("A", (2.0, 0.0), 0.6),
    Region.disc("B", (12.5, 0.0), 0.7),
    Region.box("C", 6, -1, 8, 1),
    Region.disc("D", (12.5, 3.0), 0.6),
    Region.disc("E", (7.0, 3.0), 0.5),
)
START = np.array([1.0, -3.0])

MISSIONS = [
    "F B",
    "F B & G !C",
    "F(A & F B) & G !C",
    "F A & F B & F D & never C",
    "F A & F B & F C & F D & F E",
    "!B U E & F B",
    "F(D | E) & G(E -> F A)",
    "F(C & X[!] X[!] E)",
    "(F B | F D) & (C -> F E) & (!D W A)",
    "G(A -> F B) & F A",
]


def planned(text, grid, count=4, facts=(), start=START, **options):
    return itineraries(Mission(text, facts), grid, REGIONS, start, RADIUS, count, **options)


@pytest.mark.parametrize("text", MISSIONS)
def test_every_itinerary_is_accepted_by_the_definition(corridors, text):
    mission = Mission(text)
    found = planned(text, corridors)
    spoken = [r for r in REGIONS if r.name in mission.atoms]
    assert found
    for itinerary in found:
        assert satisfies(word_along(spoken, itinerary.path), mission.formula)
        assert itinerary.path[0] == pytest.approx(START)
        length = np.linalg.norm(np.diff(itinerary.path, axis=0), axis=1).sum()
        assert itinerary.length == pytest.approx(length)
        assert corridors.clearance(itinerary.path, RADIUS).min() > -1e-6
    assert sorted(i.length for i in found) == [i.length for i in found]


@pytest.mark.parametrize("text", MISSIONS)
def test_itineraries_are_pairwise_of_other_classes(corridors, text):
    """Other stops, or on some leg another winding about an obstacle, by the angle it sweeps."""
    found = planned(text, corridors)
    for one, other in combinations(found, 2):
        assert one.signature != other.signature
        assert one.label != other.label
        if one.stops == other.stops:
            legs = zip(_legs(one), _legs(other), one.signature, other.signature, strict=True)
            assert any(a[1] != b[1] or _winds_otherwise(p, q) for p, q, a, b in legs)


def _legs(itinerary):
    starts = (0, *itinerary.ends[:-1])
    return [itinerary.path[a : b + 1] for a, b in zip(starts, itinerary.ends, strict=True)]


def _winds_otherwise(one, other):
    """Whether two paths with one pair of ends enclose the middle of a wall, or of C."""
    return any(
        abs(_swept(one, point) - _swept(other, point)) > np.pi
        for point in ([7.5, 1.5], [7.5, -1.5], [7.0, 0.0])
    )


def _swept(path, point):
    away = path - np.array(point)
    return np.diff(np.unwrap(np.arctan2(away[:, 1], away[:, 0]))).sum()


@pytest.mark.parametrize("names", ["ABD", "ABDE"])
def test_the_best_order_of_visits_is_that_of_all_orders(corridors, names):
    """Brute force over all orders, with legs by the routes planner between the same anchors."""
    best = planned(" & ".join(f"F {name}" for name in names), corridors, 1)[0]
    anchors = {r.name: _anchor(corridors, r) for r in REGIONS}
    lengths = {}

    def leg(a, b):
        if (a, b) not in lengths:
            start = START if a == "" else anchors[a]
            lengths[a, b] = find_routes(corridors, start, anchors[b], RADIUS, 1)[0].length
        return lengths[a, b]

    def length(order):
        return sum(leg(a, b) for a, b in zip(("", *order), order, strict=False))

    shortest = min(permutations(names), key=length)
    assert best.length == pytest.approx(length(shortest), rel=0.01)
    assert [min(stop) for stop in best.stops] == list(shortest)


def _anchor(grid, region):
    (stop,) = planned(f"F {region.name}", grid, 1)[0].path[-1:]
    return stop


def test_the_second_best_is_second(corridors):
    """Asking for more itineraries does not change those that were found before."""
    few, many = (planned("F A & F B & F D", corridors, count) for count in (2, 6))
    assert [i.length for i in few] == pytest.approx([i.length for i in many[:2]])


def test_a_closed_door_replans_by_the_other_way(corridors):
    facts = (Fact("closed", holds=False, closes="C"),)
    text = "F B & (closed -> (!B U E))"
    open_way = planned(text, corridors, 1, facts)[0]
    assert frozenset("E") not in open_way.stops
    mission = Mission(text, facts).told({"closed": True})
    (by_e, *_) = itineraries(mission, corridors, REGIONS, START, RADIUS, 1)
    assert [min(stop - {"closed"}) for stop in by_e.stops] == ["E", "B"]
    c = next(r for r in REGIONS if r.name == "C")
    assert not c.contains(by_e.path).any()


def test_what_was_visited_is_not_visited_again(corridors):
    mission = Mission("F A & F B").advance(["A"])
    (best,) = itineraries(mission, corridors, REGIONS, np.array([2.0, 0.0]), RADIUS, 1)
    assert best.stops == (frozenset("B"),)


def test_a_mission_that_is_done_stays(corridors):
    mission = Mission("F A").advance(["A"])
    (only,) = itineraries(mission, corridors, REGIONS, np.array([2.0, 0.0]), RADIUS, 3)
    assert (only.label, only.length, only.stops) == ("done", 0.0, ())
    np.testing.assert_array_equal(only.path, [[2.0, 0.0]] * 2)


def test_a_goal_is_gone_to_when_the_mission_is_done(corridors):
    for itinerary in planned("F A & G !C", corridors, 2, end=[13.0, -3.0]):
        assert itinerary.path[-1] == pytest.approx([13.0, -3.0])
        assert itinerary.stops == (frozenset("A"),)
        assert satisfies(itinerary.word, Mission("F A & G !C").formula)


def test_open_space_needs_no_map():
    found = planned("F A & F D & G !C", None, 2, start=np.array([0.0, 0.0]))
    assert found[0].stops == (frozenset("A"), frozenset("D"))
    words = [word_along(REGIONS, i.path) for i in found]
    assert not any("C" in letter for word in words for letter in word)


def test_keeping_in_regions_that_overlap(corridors):
    """G(left | C | right) leads through the regions, never out of them."""
    regions = (
        Region.box("left", 0, -1, 6.5, 1),
        Region.box("C", 6, -1, 9, 1),
        Region.box("right", 8.5, -1, 14, 1),
        Region.disc("B", (12.5, 0.0), 0.5),
    )
    text = "F B & G(left | C | right)"
    (only, *more) = itineraries(Mission(text), corridors, regions, np.array([1.0, 0.0]), RADIUS, 3)
    assert satisfies(word_along(regions, only.path), Mission(text).formula)
    assert more == []


@pytest.mark.parametrize(
    ("text", "facts", "regions", "says"),
    [
        ("F B", (Fact("shut", True, "B"),), ("B",), "B is closed"),
        ("F A & F island", (), ("island",), "fits nowhere on the map in island"),
        ("F A & F cell", (), ("cell",), "nothing leads to cell"),
        ("F wall & F A", (), ("wall",), "fits nowhere on the map in wall"),
        ("F D & G !ring", (), ("D",), "D cannot be reached without entering what is forbidden"),
        ("F(A & B)", (), (), "at once that do not overlap"),
    ],
)
def test_what_cannot_be_done_on_this_map_is_named(text, facts, regions, says):
    island = [
        box(9, 3.2, 10, 3.3),
        box(9, 3.2, 9.1, 4.1),
        box(9.9, 3.2, 10, 4.1),
        box(9, 4, 10, 4.1),
    ]
    island += [box(0, 3.8, 4, 3.9), box(4, 3.8, 4.1, 5)]
    walls = [box(4, 1, 11, 2), box(4, -2, 11, -1), *island]
    grid = OccupancyGrid.from_polygons(walls, (0, -4, 14, 5), 0.1, border=True)
    more = (
        Region.disc("island", (9.5, 3.6), 0.1),
        Region.disc("cell", (1.0, 4.5), 0.2),
        Region.box("wall", 5, 1.2, 6, 1.8),
        Region.box("ring", 11.5, -4, 12.0, 5),
    )
    with pytest.raises(NoMissionRoute, match=says) as caught:
        itineraries(Mission(text, facts), grid, REGIONS + more, START, RADIUS, 2)
    assert caught.value.regions == regions


def test_a_failed_mission_says_so(corridors):
    mission = Mission("F B & G !C").advance(["C"])
    assert mission.failed
    with pytest.raises(NoMissionRoute, match="has failed"):
        itineraries(mission, corridors, REGIONS, START, RADIUS, 1)


def test_a_misspelt_region_shows_its_place(corridors):
    regions = (Region.disc("kitchen", (2.0, 0.0), 0.5),)
    with pytest.raises(MissionError, match="did you mean 'kitchen'") as caught:
        itineraries(Mission("F kichen"), corridors, regions, START, RADIUS, 1)
    assert caught.value.place == (2, 8)


def test_a_count_below_one_is_refused(corridors):
    with pytest.raises(ValueError, match="count must be at least 1, got 0"):
        planned("F A", corridors, 0)
