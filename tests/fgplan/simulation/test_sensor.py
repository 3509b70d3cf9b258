"""What sensors and faults make of the truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fgplan.driving import Detection, Observation
from fgplan.occupancy import OccupancyGrid
from fgplan.scenario import FieldOfView
from fgplan.simulation.body import Body, Limits
from fgplan.simulation.faults import Faults
from fgplan.simulation.people import heedless
from fgplan.simulation.sensor import Quality, Sensors, known_at_first
from fgplan.simulation.walkers import Walkers
from tests.fgplan.simulation.worlds import passer, world


def looks(quality: Quality, steps: int, grid: OccupancyGrid | None = None, seed: int = 0) -> Any:
    """What is seen in each of some steps, of two people who walk along x at 1 m/s."""
    people = Walkers([passer(1.0, 0.0, 1.0, 0.0), passer(1.0, 2.0, 1.0, 0.0)], heedless)
    sensors, body = Sensors(quality, grid, seed), Body(world().scenario, Limits(1.0))
    seen = []
    for step in range(steps):
        seen.append(sensors(0.1 * step, body, people))
        people.advance(0.1, None)
    return seen


def test_the_default_is_the_truth_without_velocities() -> None:
    (first,) = looks(Quality(), 1)
    assert [d.identity for d in first.detections] == ["p0", "p1"]
    assert np.array_equal([d.position for d in first.detections], [[1.0, 0.0], [1.0, 2.0]])
    assert first.detections[0].velocity is None
    assert first.grid is None


def test_noise_has_its_standard_deviation() -> None:
    truth = looks(Quality(), 1000)
    noisy = looks(Quality(noise=0.1), 1000)
    errors = [
        d.position - t.position
        for a, b in zip(noisy, truth, strict=True)
        for d, t in zip(a.detections, b.detections, strict=True)
    ]
    assert np.std(errors) == pytest.approx(0.1, rel=0.04)
    assert np.mean(errors) == pytest.approx(0.0, abs=0.01)


def test_dropouts_are_nothing_sensed_and_misses_are_nobody_there() -> None:
    lost = [s.detections is None for s in looks(Quality(dropout=0.3), 1000)]
    assert np.mean(lost) == pytest.approx(0.3, abs=0.05)
    counts = [len(s.detections) for s in looks(Quality(missed=0.3), 1000)]
    assert np.mean(counts) == pytest.approx(1.4, abs=0.07)


def test_latency_shows_the_past() -> None:
    seen = looks(Quality(latency=0.3), 10)
    assert all(s.detections is None for s in seen[:3])
    assert np.allclose(seen[7].detections[0].position, [1.4, 0.0])


def test_who_is_out_of_view_is_not_seen() -> None:
    seen = looks(Quality(view=FieldOfView(range=2.05)), 20)
    assert [len(s.detections) for s in seen][::5] == [1, 1, 1, 0]


def test_the_map_grows_and_is_given_when_there_is_more_of_it() -> None:
    box = [(4.0, -1.0), (4.3, -1.0), (4.3, 1.0), (4.0, 1.0)]
    grid = OccupancyGrid.from_polygons([box], (-1, -3, 8, 3), 0.1)
    body = Body(world().scenario, Limits(1.0))
    sensors = Sensors(Quality(map_range=3.0), grid, 0)
    people = Walkers([], heedless)
    given = []
    for step in range(30):
        body.position = np.array([0.1 * step, 0.0])
        given.append(sensors(0.1 * step, body, people).grid)
    assert given[0] is not None
    assert not given[0].occupied.any()
    last = [g for g in given if g is not None][-1]
    assert np.array_equal(last.occupied, grid.occupied)
    assert 1 < sum(g is not None for g in given) < 8
    known = known_at_first(grid, np.zeros(2), 3.0)
    assert known is not None
    assert np.array_equal(known.data, given[0].data)


def test_faults_spoil_their_share_each_in_every_way() -> None:
    faults, kinds = Faults(0.2, seed=3), []
    for step in range(2000):
        one = Detection(np.array([1.0, 2.0]), "p0")
        clean = Observation(0.1 * step, np.zeros(2), detections=(one,))
        spoilt = faults(clean)
        if spoilt is clean:
            continue
        kinds.append(_kind(clean, spoilt))
    assert len(kinds) == pytest.approx(400, abs=60)
    assert set(kinds) == {"dropped", "late", "duplicated", "not a number", "teleported"}


def test_no_faults_change_nothing() -> None:
    clean = Observation(0.0, np.zeros(2))
    assert Faults(0.0, seed=0)(clean) is clean


def _kind(clean: Observation, spoilt: Observation) -> str:
    if spoilt.time < clean.time:
        return "late"
    if spoilt.detections is None:
        return "dropped"
    if len(spoilt.detections) == 2:
        return "duplicated"
    if np.isnan(spoilt.detections[0].position).any():
        return "not a number"
    assert np.linalg.norm(spoilt.detections[0].position - [1.0, 2.0]) == pytest.approx(8.0)
    return "teleported"
