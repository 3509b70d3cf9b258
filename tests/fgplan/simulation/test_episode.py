"""One run: what the numbers mean, in cases where they are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgplan.driving import Observation, Settings
from fgplan.driving.guard import Guard
from fgplan.occupancy import OccupancyGrid
from fgplan.robots import Twist
from fgplan.simulation.body import Limits
from fgplan.simulation.driver import Fgplan
from fgplan.simulation.episode import run
from fgplan.simulation.metrics import bootstrap, paired, row, summary, switches, wilson
from fgplan.simulation.peers import NoGoal, Straight
from fgplan.simulation.planners import named
from fgplan.simulation.policy import Command
from fgplan.simulation.world import Event, Rules
from tests.fgplan.simulation.worlds import Breaks, Stands, passer, world


class Commands:
    """A policy that commands one thing."""

    def __init__(self, velocity: tuple[float, float], twist: Twist | None = None) -> None:
        self.velocity, self.twist = np.array(velocity), twist

    def step(self, observation: Observation) -> Command:
        return Command(self.velocity, self.twist)


def test_straight_on_takes_the_length_over_the_speed() -> None:
    made = world()
    numbers = row(run(made, Straight(made)))
    assert numbers["success"]
    assert numbers["time"] == pytest.approx(4.8)  # 4.7 m is 0.3 m away, and not nearer
    assert numbers["path_ratio"] == pytest.approx(1.0)
    assert numbers["min_separation"] is None
    assert numbers["stopped_fraction"] == 0


def test_a_contact_between_two_steps_is_seen() -> None:
    """Two discs of 0.3 m pass through each other within one period: at its ends they are apart."""
    rules = Rules(period=1.0, substeps=1, time_limit=2.0)
    made = world([passer(0.5, 5.0, 0.0, -10.0)], rules=rules)
    episode = run(made, Straight(made))
    assert episode.gaps[0] < 0
    assert np.linalg.norm(episode.people[0, 0] - episode.robot[0, :2]) > 0.6
    assert np.linalg.norm(episode.people[1, 0] - episode.robot[1, :2]) > 0.6
    assert row(episode)["collisions"] == 1


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-2, 2), st.floats(-2, 2))
def test_the_gap_is_the_least_of_a_fine_sampling(x: float, y: float, vx: float, vy: float) -> None:
    made = world([passer(x, y, vx, vy)], rules=Rules(period=0.5, substeps=1, time_limit=0.5))
    gap = run(made, Straight(made)).gaps[0]
    t = np.linspace(0, 0.5, 2001)
    dx, dy = x + (vx - 1.0) * t, y + vy * t
    assert gap == pytest.approx(np.hypot(dx, dy).min() - 0.6, abs=2e-3)


def test_contact_ends_the_run_where_the_rules_say_so() -> None:
    made = world([passer(2.0, 0.0, 0.0, 0.001)], rules=Rules(contact_ends=True))
    episode = run(made, Straight(made))
    assert episode.end == "collision"
    assert episode.times[-1] == pytest.approx(1.4, abs=0.11)
    assert not row(episode)["success"]


@pytest.mark.parametrize(("clearance", "margin"), [(None, 0.25), (0.4, 0.4)])
def test_the_guard_asks_for_the_clearance_of_the_world(
    clearance: float | None, margin: float
) -> None:
    own = Settings(deadline=None, guard=Guard(margin=0.25))
    driver = Fgplan(settings=own)(world(rules=Rules(clearance=clearance)))
    assert driver.planner.settings.guard == replace(own.guard, margin=margin)


def test_who_stands_is_stopped_and_late() -> None:
    made = world(rules=Rules(time_limit=3.0))
    numbers = row(run(made, Stands()))
    assert numbers["end"] == "timeout"
    assert numbers["stopped_fraction"] == 1.0
    assert numbers["time"] is None


def test_an_error_of_the_policy_is_kept_and_ends_the_run() -> None:
    numbers = row(run(world(), Breaks()))
    assert numbers["end"] == "error"
    assert numbers["error"] == "RuntimeError: no idea"
    assert summary([{**numbers, "seed": 0}])["errors"] == 1


@pytest.mark.parametrize(
    ("policy", "commanded"),
    [
        (Commands((np.nan, 0.0)), "velocity [nan, 0.0]"),
        (Commands((0.0, np.inf)), "velocity [0.0, inf]"),
        (Commands((0.0, 0.0), Twist(0.0, 0.0, np.nan)), "angular_z=nan"),
    ],
)
def test_a_command_that_is_not_finite_is_an_error(policy: Commands, commanded: str) -> None:
    episode = run(world(), policy)
    assert episode.end == "error"
    assert commanded in episode.error
    assert np.isfinite(episode.robot).all()
    assert not row(episode)["success"]


def test_who_starts_at_the_goal_has_no_way_to_compare_with() -> None:
    made = world(goal=(0.0, 0.0))
    numbers = row(run(made, Straight(made)))
    assert numbers["success"]
    assert numbers["path_ratio"] is None


@pytest.mark.parametrize("planner", ["straight", "orca", "layered", "layered-global"])
def test_a_peer_in_a_world_without_a_goal_says_so(planner: str) -> None:
    made = world()
    made = replace(made, scenario=made.scenario.replace(goal=None))
    with pytest.raises(NoGoal, match=rf"planner {planner.removesuffix('-global')} needs a goal"):
        named(planner)(made)


def test_the_goal_jumps_when_its_time_has_come() -> None:
    made = world(events=(Event(2.0, np.array([2.0, 3.0])),))
    episode = run(made, Straight(made))
    assert episode.end == "goal"
    assert np.linalg.norm(episode.robot[-1, :2] - [2.0, 3.0]) < 0.3
    assert np.allclose(episode.robot[20, :2], [2.0, 0.0])


def test_a_wall_stops_the_robot_and_counts() -> None:
    box = [(2, -1), (3, -1), (3, 1), (2, 1)]
    grid = OccupancyGrid.from_polygons([box], (-1, -3, 8, 3), 0.05)
    made = world(grid=grid, rules=Rules(time_limit=5.0))
    episode = run(made, Straight(made))
    assert grid.clearance(episode.robot[:, :2], 0.3).min() > -0.011
    numbers = row(episode)
    assert numbers["wall_contacts"] == 1
    assert not numbers["success"]


@pytest.mark.parametrize("radius", [0.0, 0.02, 0.1])
@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_a_thin_wall_is_met_between_two_steps(radius: float, angle: float) -> None:
    """At both ends of a second of motion the robot is clear of the wall between them."""
    wall = [(0.62, -3), (0.63, -3), (0.63, 3), (0.62, 3)]
    grid = OccupancyGrid.from_polygons([wall], (-1, -3, 8, 3), 0.05)
    made = world(grid=grid, rules=Rules(period=1.0, substeps=1, time_limit=1.0))
    robot = replace(made.scenario.robot, radius=radius)
    made = replace(made, scenario=made.scenario.replace(robot=robot))
    episode = run(made, Commands((np.cos(angle), np.sin(angle))))
    assert row(episode)["wall_contacts"] == 1
    assert np.array_equal(episode.robot[-1], np.zeros(4))


def test_a_limited_base_takes_its_time() -> None:
    """From rest at 0.5 m/s²: 1 m/s after 2 s, when 1 m is driven."""
    made = world(limits=Limits(1.0, max_acceleration=0.5))
    episode = run(made, Straight(made))
    assert np.allclose(episode.robot[20], [1.0, 0.0, 1.0, 0.0])
    assert episode.robot[:, 2].max() <= 1.0 + 1e-12


def test_people_who_are_not_held_up_have_no_delay() -> None:
    made = world([passer(0.0, 3.0, 1.2, 0.0)])
    assert row(run(made, Straight(made)))["people_delay"] == pytest.approx(0.0, abs=1e-9)


def test_switches_count_changes_between_named_hypotheses() -> None:
    assert switches(["A", "A", None, "A", "B", None, "A"]) == 2
    assert switches([]) == 0


def test_wilson_matches_its_published_example() -> None:
    """Newcombe, Statistics in Medicine 17, 1998, table I: 81 of 263 gives 0.2553 to 0.3662."""
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    for count in (20, 60, 500):
        assert wilson(0, count)[0] == 0.0
        assert wilson(count, count)[1] == 1.0


def test_the_bootstrap_interval_is_that_of_the_normal_law_for_many_values() -> None:
    values = np.random.default_rng(1).normal(3.0, 2.0, 400)
    low, high = bootstrap(values.tolist())
    half = 1.96 * values.std() / 20
    assert low == pytest.approx(values.mean() - half, abs=0.03)
    assert high == pytest.approx(values.mean() + half, abs=0.03)


def test_paired_takes_the_seeds_that_both_have() -> None:
    ours = [{"seed": 1, "time": 3.0}, {"seed": 2, "time": 5.0}, {"seed": 3, "time": None}]
    theirs = [{"seed": 2, "time": 4.0}, {"seed": 1, "time": 2.0}, {"seed": 3, "time": 1.0}]
    assert paired(ours, theirs, lambda run: run["time"]) == [1.0, 1.0]
    assert paired(ours, theirs[:1], lambda run: run["time"]) == [1.0]
