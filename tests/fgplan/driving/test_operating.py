"""The operator in closed loop: commits, does not turn back, and nothing of it is invented."""

from __future__ import annotations

import numpy as np
import pytest

from fgplan import Density, Level, OccupancyGrid, Robot, Scenario
from fgplan.conditioning import log_likelihood, on_level, reweigh
from fgplan.crowd import believe
from fgplan.driving import CandidateGoals, Observation, Outcome, Planner, Settings
from fgplan.driving.operating import LATE, Operated
from fgplan.driving.recollection import Recollection
from fgplan.hypotheses import hypothesise
from fgplan.hypothesis import Course, Hypothesis, Start
from fgplan.shared_control import VIA, Candidate, Joystick, Waypoint
from fgplan.trajectory import Trajectory

PERIOD = 0.2
SETTINGS = Settings(period=PERIOD, deadline=None)
DENSITY = Density(dt=0.4, horizon=4.0)
TWINS = OccupancyGrid.from_polygons(
    [[(3.0, -1.0), (8.0, -1.0), (8.0, 1.0), (3.0, 1.0)]], (-1, -2.5, 12, 2.5), 0.1, border=True
)


class Drive:
    """A holonomic robot that does what it is told, and an operator."""

    def __init__(self, planner, say=lambda t, position: ()):
        self.planner, self.say = planner, say
        self.position, self.velocity, self.time = np.zeros(2), np.zeros(2), 0.0
        self.decisions, self.positions = [], []

    def run(self, duration):
        while self.time < duration - 1e-9:
            said = self.say(self.time, self.position)
            observation = Observation(
                self.time, self.position.copy(), self.velocity.copy(), operator=said
            )
            decision = self.planner.step(observation)
            self.velocity = decision.action.velocity
            self.position = self.position + PERIOD * self.velocity
            self.time = round(self.time + PERIOD, 6)
            self.decisions.append(decision)
            self.positions.append(self.position)
        return self

    @property
    def labels(self):
        return [decision.label for decision in self.decisions]


def planner(sources=(), **changes):
    fields = {"goal": np.array([11.0, 0.0]), "grid": TWINS, "density": DENSITY, **changes}
    robot = Robot(np.zeros(2), max_speed=1.0, max_acceleration=1.0)
    return Planner(Scenario(robot, crowd="predicted", **fields), SETTINGS, sources)


def test_on_a_new_clock_what_was_said_of_a_time_is_over_and_a_place_is_not():
    place, timed = (Waypoint(np.array([5.0, 2.0]), 0.1 * np.eye(2), time) for time in (None, 9.0))
    operated = Operated((place, timed)).on_new_clock()
    assert operated.data == (place,)
    assert operated.past.until == -np.inf


def stick(degrees, t, sigma=0.2, speed=0.9):
    a = np.deg2rad(degrees)
    return Joystick(t, speed * np.array([np.cos(a), np.sin(a)]), sigma**2 * np.eye(2))


def held(degrees, first, last, **how):
    return lambda t, position: (stick(degrees, t, **how),) if first <= t < last else ()


def side(label, decision):
    """+1 where a route passes above the block."""
    route = next(c.route for c in decision.mixture.components if c.label == label)
    return np.sign(route[np.argmin(np.abs(route[:, 0] - 5.5)), 1])


def test_the_robot_commits_to_the_operators_corridor_and_does_not_turn_back():
    alone = Drive(planner()).run(1.0)
    first = alone.labels[-1]
    other = -side(first, alone.decisions[-1])
    steered = Drive(planner(), held(30 * other, 1.0, 2.4)).run(6.0)
    assert steered.labels[4] == first
    committed = [label != first for label in steered.labels[5:]]
    assert committed.index(True) <= 1.0 / PERIOD
    assert all(committed[committed.index(True) :])
    assert other * steered.position[1] > 1.0
    switches = [d for d in steered.decisions if d.outcome is Outcome.SWITCHING]
    assert len(switches) == 1


def test_the_choice_is_the_closed_form():
    """log w_A − log w_B = −β (J_A − J_B) ± commitment + log p(z | A) − log p(z | B), each datum on
    the plans that A and B had at its time; the commitment as far as it has grown."""
    said, plans = [], {"A": {}, "B": {}}

    def say(t, position):
        for name, past in drive.planner.memory.operated.past.of.items():
            plans[name].update(past.plans)
        new = held(-30, 0.4, 1.2)(t, position)
        said.extend(new)
        return new

    drive = Drive(planner(), say)
    drive.run(2.4)
    decision = drive.decisions[-1]
    assert decision.mixture is not None
    a, b = (next(c for c in decision.mixture.components if c.label == n) for n in ("A", "B"))
    readings = [r for m in said for r in m.readings]
    likelihood = {}
    for label, own in plans.items():
        starts = np.array(sorted(own))
        which = starts[[np.searchsorted(starts, r.said + 1e-6, side="right") - 1 for r in readings]]
        likelihood[label] = sum(
            log_likelihood((r,), own[start], start)
            for r, start in zip(readings, which, strict=True)
        )
    assert likelihood["A"] != pytest.approx(likelihood["B"], abs=1)
    followed = drive.labels[-2]
    price = -DENSITY.beta * (a.cost - b.cost)
    since = max(d.time for d in drive.decisions if d.outcome is Outcome.SWITCHING)
    grown = 1 - np.exp(-(decision.time - since) / SETTINGS.deliberation)
    price += grown * SETTINGS.commitment * ((followed == "A") - (followed == "B"))
    expected = price + likelihood["A"] - likelihood["B"]
    assert a.log_prior - b.log_prior == pytest.approx(expected, abs=1e-6)


def test_a_large_gap_in_cost_outweighs_a_vague_operator():
    """The corridor the operator points at is closed far behind: what the data weighs is less."""
    walls = [
        [(3.0, -1.0), (8.0, -1.0), (8.0, 1.0), (3.0, 1.0)],
        [(6.0, -3.0), (6.5, -3.0), (6.5, -1.0), (6.0, -1.0)],
    ]
    dead_end = OccupancyGrid.from_polygons(walls, (-1, -2.5, 12, 2.5), 0.1, border=True)
    drive = Drive(planner(grid=dead_end), held(-30, 0.4, 1.2, sigma=2.0)).run(6.0)
    assert drive.position[1] > 1.0


def test_a_waypoint_is_passed_within_its_sigma_and_reported():
    place = np.array([1.5, -1.6])
    waypoint = Waypoint(place, 0.3**2 * np.eye(2), name="window")
    drive = Drive(planner(), lambda t, p: (waypoint,) if t == 0.4 else ()).run(9.0)
    gaps = np.linalg.norm(np.array(drive.positions) - place, axis=1)
    assert gaps.min() < 0.3
    reports = [repair for d in drive.decisions for repair in d.repairs]
    assert reports == ["window is reached"]
    assert drive.planner.memory.operated.met == ("window",)
    assert VIA in drive.labels
    assert drive.position[0] > 5.0  # and on to the goal


def test_an_impossible_waypoint_is_reported_by_name_and_the_goal_is_reached():
    inside = Waypoint(np.array([5.0, 0.0]), 0.3**2 * np.eye(2), name="pillar")
    drive = Drive(planner(), lambda t, p: (inside,) if t == 0.4 else ()).run(14.0)
    reports = [repair for d in drive.decisions for repair in d.repairs]
    assert len(reports) == 1
    assert "pillar" in reports[0]
    assert "inside an obstacle" in reports[0]
    assert drive.decisions[-1].outcome is Outcome.GOAL_REACHED


def test_bad_data_is_refused_and_the_plan_goes_on_as_without_it():
    bad = (
        Joystick(0.4, np.array([np.nan, 1.0]), np.eye(2)),
        Joystick(9.0, np.array([0.5, 0.0]), np.eye(2)),
        Waypoint(np.array([1.0, 1.0]), np.diag([1.0, -1.0])),
    )
    told = Drive(planner(), lambda t, p: bad if t == 0.4 else ()).run(2.0)
    alone = Drive(planner()).run(2.0)
    assert len(told.decisions[2].repairs) == 3
    assert all("refused" in repair for repair in told.decisions[2].repairs)
    np.testing.assert_array_equal(told.positions, alone.positions)


def test_without_a_goal_the_operator_reveals_it():
    candidates = [
        Candidate("left", np.array([10.0, 2.0])), Candidate("right", np.array([10.0, -2.0])),
        Candidate("behind", np.array([-0.6, 2.0])),
    ]  # fmt: skip
    source = CandidateGoals(candidates)
    drive = Drive(planner((source,), goal=None), held(-35, 0.4, 2.0)).run(4.0)
    intents = [d.intent for d in drive.decisions if d.intent is not None]
    assert intents[-1].best == "right"
    assert intents[-1].probability["right"] > 0.9
    assert intents[-1].since is not None
    assert 0.4 <= intents[-1].since <= 1.6
    assert drive.position[1] < -0.5
    assert drive.decisions[0].intent is None


def test_of_a_stick_that_is_let_go_what_it_said_is_left_and_nothing_else():
    drive = Drive(planner(), held(-30, 0.0, 0.4)).run(1.0)
    operated, scenario = drive.planner.memory.operated, drive.planner.memory.scenario
    assert operated.data
    later, _ = operated.hear((), scenario.replace(now=60.0))
    assert later.data == ()
    proposed = hypothesise(scenario.replace(count=2), believe((), 0.0, 0.03, 0.04, 1.5))
    batch = reweigh(scenario, operated.recalled(proposed, scenario.now, "A"))
    for a, b in zip(batch, later.recalled(proposed, 60.0, "A"), strict=True):
        assert a.log_prior == pytest.approx(b.log_prior, abs=1e-9)
    noted = later.note(proposed, scenario.replace(now=60.0), "A")
    assert all(len(past.plans) <= 2 for past in noted.past.of.values())


def test_the_course_of_a_hypothesis_is_the_plan_of_each_time():
    times = np.array([0.0, 1.0, 2.0])

    def going(x, v):
        return Trajectory(
            times, np.column_stack([x + v * times, 0 * times]), np.tile([v, 0.0], (3, 1))
        )

    course = Course(np.array([-2.0, -0.5, 0.0]), (going(0, 1.0), going(5, 2.0), going(9, 3.0)))
    np.testing.assert_allclose(course.at(np.array([-3.0, -2.0, -1.0]))[:, 0], [-1, 0, 1])
    np.testing.assert_allclose(course.at(-0.5), [5, 0, 2, 0])
    np.testing.assert_allclose(course.at(np.array([[0.0, 1.5]]))[0, :, 2], 3.0)
    np.testing.assert_allclose(course.at(1.0, said=-0.2), [8, 0, 2, 0])
    np.testing.assert_allclose(course.times, [-2.0, -0.5, 0.0, 1.0, 2.0])


class Course3:
    """Three ways that change from step to step, and what a planner does with an operator's data,
    without planning."""

    names = ("A", "B", "C")

    def __init__(self, level, late=LATE):
        robot = Robot(np.zeros(2), np.array([0.8, 0.0]))
        self.scenario = Scenario(robot, levels=(level,), density=DENSITY)
        self.operated = Operated(past=Recollection(), late=late)

    def hypotheses(self, now):
        times = DENSITY.times
        found = []
        for i, name in enumerate(self.names):
            angle = 0.5 * (i - 1) + 0.2 * np.sin(0.3 * now + i)
            v = 0.8 * np.array([np.cos(angle), np.sin(angle)])
            plan = Trajectory(times, np.outer(times, v), np.tile(v, (len(times), 1)))
            found.append(Hypothesis(name, -np.log(3), plan, 0.0, (Start("plan", plan),)))
        return found

    def step(self, now, said=()):
        scenario = self.scenario.replace(now=now)
        self.operated, notes = self.operated.hear(said, scenario)
        scenario = scenario.replace(data=self.operated.data)
        proposed = self.hypotheses(now)
        recalled = self.operated.recalled(proposed, now, "B")
        weighed = reweigh(scenario, recalled)
        level = scenario.levels[0]
        states = ()
        if level.sigma > 0:
            states = [data.now for data in on_level(scenario, 0, recalled)]
        self.operated = self.operated.note(proposed, scenario, "B")
        return np.array([h.log_prior for h in weighed]), states, notes


@pytest.mark.parametrize(
    "level", [Level(), Level(sigma=0.5, length=1.5)], ids=["fixed plans", "random plans"]
)
def test_what_is_not_kept_any_more_counts_as_if_it_were(level):
    """Data that is heard and dropped gives the weights, and the density of the level's state, of
    all data at once; also when it comes late and out of order."""
    short, whole = Course3(level, late=0.4), Course3(level, late=np.inf)
    rng = np.random.default_rng(2)
    waiting = []
    for k in range(30):
        now = 0.1 * k
        if k < 12 or k > 20:
            waiting.append(stick(float(rng.normal(10, 15)), now, sigma=0.8))
        due = waiting if k % 2 or rng.random() < 0.5 else []
        rng.shuffle(due)
        if due:
            waiting = []
        (a, states_a, notes), (b, states_b, _) = (c.step(now, due) for c in (short, whole))
        assert not notes
        np.testing.assert_allclose(a, b, atol=1e-8)
        for x, y in zip(states_a, states_b, strict=True):
            assert (x is None) == (y is None)
            if x is not None:
                (A,), (B,) = x.A, y.A
                np.testing.assert_allclose(A.T @ A, B.T @ B, atol=1e-8)
                np.testing.assert_allclose(A.T @ x.b, B.T @ y.b, atol=1e-8)
    assert len(short.operated.data) < len(whole.operated.data)
    assert np.ptp(a) > 1


def test_a_stick_that_is_held_for_long_takes_no_more_room_and_counts_on():
    """Half a minute at 10 Hz; an hour is `python -m benchmarks.operator --hour`."""
    course = Course3(Level())
    sizes = []
    for k in range(300):
        weights, _, _ = course.step(0.1 * k, (stick(3.0, 0.1 * k, sigma=2.0),))
        if k % 50 == 49:
            past = course.operated.past
            sizes.append((len(course.operated.data), sum(len(p.plans) for p in past.of.values())))
    assert sizes == [sizes[0]] * 6
    assert weights[1] == pytest.approx(0, abs=0.05)  # B goes ahead, as the stick says
    assert max(weights[0], weights[2]) < -3


@pytest.mark.parametrize(("count", "lost"), [(100, 0), (150, 50)])
def test_of_more_than_can_be_kept_before_there_is_a_plan_the_newest_is(count, lost):
    scenario = Scenario(Robot(np.zeros(2)), goal=np.array([9.0, 0.0]), now=10.0)
    sticks = [
        Joystick(10 - 1.4 + 0.3 * k / count, np.array([0.5, 0.1]), 0.04 * np.eye(2))
        for k in range(count)
    ]
    operated, notes = Operated().hear(sticks, scenario)
    kept = [r.time for m in operated.data for r in m.readings]
    assert len(kept) == 3 * count - lost
    said = [r.time for m in sticks for r in m.readings]
    assert sorted(kept) == sorted(said)[lost:]
    assert len(notes) == bool(lost)
    assert all(f"{lost} readings" in note and "left out" in note for note in notes)


def test_what_is_older_than_it_may_be_is_refused_before_anything_was_heard():
    scenario = Scenario(Robot(np.zeros(2)), goal=np.array([9.0, 0.0]), now=100.6)
    operated, notes = Operated().hear((stick(10, 20.0),), scenario)
    assert operated.data == ()
    assert notes == ("operator data (joystick) came 80.27 s late: refused",)
    old = stick(10, 20.0)  # of a scenario, which says what it likes of its past
    operated, notes = Operated(waiting=(old,)).hear((), scenario)
    assert (operated.data, notes) == ((old,), ())


def test_what_comes_too_late_is_refused_by_name():
    course = Course3(Level())
    for k in range(50):
        course.step(0.1 * k, (stick(10, 0.1 * k),))
    late = stick(10, 0.5)
    _, _, notes = course.step(5.0, (late,))
    assert notes == ("operator data (joystick) came 4.17 s late: refused",)
    assert all(m is not late for m in course.operated.data)


def test_a_name_that_means_something_new_starts_from_what_was_followed():
    course = Course3(Level())
    for k in range(60):
        course.step(0.1 * k, (stick(-30, 0.1 * k),))
    past = course.operated.past
    assert past.of["B"].energy > past.of["A"].energy + 1
    followed = past.branched(["B"], "A")
    assert followed.of["B"] == past.of["A"]
    assert past.branched(["new"], "A") is past


def test_data_of_the_scenario_is_looked_at_like_any_other():
    inside = Waypoint(np.array([5.0, 0.0]), 0.3**2 * np.eye(2), name="pillar")
    told = planner(data=(inside,))
    decision = told.step(Observation(0.0, np.zeros(2)))
    assert any("pillar" in repair for repair in decision.repairs)
    assert told.step(Observation(PERIOD, np.zeros(2))).repairs == ()
