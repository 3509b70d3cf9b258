"""CrowdNav by its published rules and cases."""

from __future__ import annotations

import numpy as np
import pytest

from fgplan.simulation import crowdnav
from fgplan.simulation.crowdnav import CrowdNav
from fgplan.simulation.episode import run
from fgplan.simulation.peers import OrcaRobot, Straight
from tests.fgplan.simulation.worlds import Breaks

PUBLISHED_TEST = 1000


def test_the_orca_row_is_the_published_one() -> None:
    """Chen et al., ICRA 2019, 500 test cases, robot invisible: success .426, collision .568,
    10.86 s; three cases may end otherwise by rounding."""
    setup, rows = CrowdNav(), []
    for seed in range(PUBLISHED_TEST, PUBLISHED_TEST + 500):
        world = setup(seed)
        rows.append(crowdnav.measure(run(world, OrcaRobot(world))))
    line = crowdnav.summary(rows)
    assert line["success"] == pytest.approx(0.426, abs=0.006)
    assert line["collision"] == pytest.approx(0.568, abs=0.006)
    assert line["time"] == pytest.approx(10.86, abs=0.05)
    assert line["success"] + line["collision"] + line["timeout"] == pytest.approx(1.0)
    assert line["min_clearance"] < 0


def test_runs_that_end_before_a_step_have_no_clearance() -> None:
    setup = CrowdNav()
    broken = crowdnav.measure(run(setup(PUBLISHED_TEST), Breaks()))
    assert crowdnav.summary([broken])["min_clearance"] is None
    world = setup(PUBLISHED_TEST)
    whole = crowdnav.measure(run(world, Straight(world)))
    line = crowdnav.summary([broken, whole])
    assert line["errors"] == 1
    assert line["min_clearance"] == whole["min_clearance"]


def test_orca_is_safe_among_people_who_see_it() -> None:
    setup = CrowdNav(visible=True)
    for seed in range(PUBLISHED_TEST, PUBLISHED_TEST + 10):
        world = setup(seed)
        assert run(world, OrcaRobot(world)).end == "goal"


@pytest.mark.parametrize("layout", ["circle", "square"])
@pytest.mark.parametrize("varied", [False, True])
def test_cases_keep_the_published_distances(layout: str, varied: bool) -> None:
    for seed in range(20):
        world = CrowdNav(10, layout, varied=varied)(seed)  # type: ignore[arg-type]
        people = world.people
        assert len(people.names) == 10
        discs = np.vstack([world.scenario.robot.position, people.positions])
        radii = np.array([0.3, *people.radii])
        for i in range(len(discs)):
            for j in range(i):
                gap = np.linalg.norm(discs[i] - discs[j]) - radii[i] - radii[j]
                assert gap >= crowdnav.APART - 1e-12
        if varied:
            assert people.radii.min() >= 0.3
            assert people.radii.max() <= 0.5
        else:
            assert np.all(people.radii == 0.3)
        if layout == "circle":
            away = np.linalg.norm(people.positions, axis=1)
            assert np.all(np.abs(away - 4) < (0.75 if not varied else 1.1))


def test_a_seed_is_a_case() -> None:
    one, again, other = (CrowdNav()(seed).people.positions for seed in (7, 7, 8))
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)


def test_the_invisible_robot_changes_nobodys_way() -> None:
    """Paired seeds: what people do depends on who sees whom alone."""

    def ways(visible: bool) -> np.ndarray:
        world = CrowdNav(visible=visible)(3)
        return run(world, Straight(world)).people

    def alone() -> np.ndarray:
        people, track = CrowdNav()(3).people, []
        for _ in range(10):
            track.append(people.positions)
            people.advance(0.25, None)
        return np.array(track)

    assert np.array_equal(ways(False)[:10], alone())
    assert not np.array_equal(ways(True)[:10], alone())
