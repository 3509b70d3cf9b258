"""Data of the levels: weights on fixed plans, factors on random ones, and never both."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from factors.markov import Matern
from fgplan import (
    Density,
    DifferentialDrive,
    GivenPlan,
    Level,
    Reading,
    Readings,
    Robot,
    Scenario,
    Track,
    plan,
)
from fgplan.assembly import Assembly
from fgplan.conditioning import heard, infer, log_likelihood, nearest, on_level, reweigh
from fgplan.crowd import believe
from fgplan.hypotheses import hypothesise
from fgplan.hypothesis import Course, Hypothesis, Start
from fgplan.model import build
from fgplan.solver import GtsamLM, SecondOrder
from fgplan.trajectory import Trajectory
from tests.factors.test_markov import covariance

UP, DOWN = np.array([[0, 0], [8, 3.0]]), np.array([[0, 0], [8, -3.0]])
PLANS = (GivenPlan("up", UP, 1.0), GivenPlan("down", DOWN, 1.0))


PATH = Level()


def scenario(*readings, on=None, level=PATH, **changes):
    base = Scenario(
        Robot(np.zeros(2), np.array([0.8, 0.0])), plans=PLANS, count=0, levels=(level,),
        density=Density(dt=0.4, horizon=2.0), now=10.0,
    )  # fmt: skip
    data = (Readings(tuple(readings), on),) if readings else ()
    return base.replace(**{"data": data, **changes})


def hypotheses(s):
    return hypothesise(s, believe((), s.now, 0.03, 0.04, 1.5))


def models(s):
    belief = believe((), s.now, 0.03, 0.04, 1.5)
    weighed = reweigh(s, hypothesise(s, belief))
    return weighed, build(s, belief, weighed)


def reading(t, value, sigma=0.1, quantity="velocity"):
    return Reading(t, np.array(value, dtype=float), sigma**2 * np.eye(2), quantity)


@pytest.mark.parametrize("sigma", [0.0, 0.5])
@pytest.mark.parametrize("crowded", [False, True])
def test_no_data_is_the_same_plan_to_the_last_bit(sigma, crowded):
    tracks = (Track("p", np.array([9.6, 10.0]), np.array([[3.0, 0.1], [2.8, 0.1]])),)
    s = scenario(level=Level(sigma=sigma), tracks=tracks if crowded else ())
    without = plan(s)
    for nothing in ((), (Readings(()),), (Readings((), "robot"),)):
        other = plan(s.replace(data=nothing))
        for a, b in zip(without.components, other.components, strict=True):
            np.testing.assert_array_equal(a.robot.states, b.robot.states)
            assert (a.log_prior, a.energy, a.log_evidence) == (
                b.log_prior,
                b.energy,
                b.log_evidence,
            )


def test_data_on_a_plan_without_width_only_reweighs():
    quiet, told = plan(scenario()), plan(scenario(reading(10.4, (0.7, 0.25))))
    for c in told.components:
        same = next(q for q in quiet.components if q.label == c.label)
        np.testing.assert_allclose(c.robot.states, same.robot.states, atol=1e-9)
        assert c.energy == pytest.approx(same.energy, abs=1e-9)
    assert told.components[0].label == "up"
    assert told.components[0].log_prior > quiet.components[0].log_prior


def test_weights_of_fixed_plans_are_bayes_rule_at_the_datums_own_time():
    z, sigma = np.array([0.6, 0.1]), 0.3
    s = scenario(reading(10.7, z, sigma))
    weighed = {h.label: h for h in reweigh(s, hypotheses(s))}
    density = {
        label: 0.5 * np.exp(-0.5 * np.sum((z - h.along.at(0.7)[2:]) ** 2) / sigma**2)
        for label, h in weighed.items()
    }
    for label, h in weighed.items():
        assert np.exp(h.log_prior) == pytest.approx(
            density[label] / sum(density.values()), abs=1e-12
        )


def test_data_on_a_random_level_is_dense_regression():
    """Posterior of η_0 with readings before now, between the steps and beyond the horizon."""
    level = Level(sigma=0.6, length=2.0, h=1e9)  # so wide a coupling tells η_0 nothing
    readings = (
        reading(8.9, (0.2, 0.9)), reading(9.6, (0.3, 0.8)), reading(10.1, (0.5, 0.2)),
        reading(10.15, (0.6, 0.1)), reading(11.3, (1.0, 0.4), 0.2, "position"),
        reading(12.9, (2.0, 1.0), 0.3, "position"),
    )  # fmt: skip
    s = scenario(*readings, level=level)
    weighed, built = models(s)
    t = np.array([r.time - 10.0 for r in readings])
    steps = s.density.times
    every = np.concatenate([t, steps])
    order = np.argsort(every, kind="stable")
    process = Matern(0.6, 2.0)
    C = np.empty((4 * len(every),) * 2)
    rows = np.concatenate([np.arange(4 * i, 4 * i + 4) for i in order])
    C[np.ix_(rows, rows)] = covariance(process, every[order] - every.min(), process.stationary)
    n = len(readings)
    H = np.zeros((2 * n, 4 * len(every)))
    for j, r in enumerate(readings):
        H[2 * j : 2 * j + 2, 4 * j : 4 * j + 4] = np.eye(2, 4, k=2 * (r.quantity == "velocity"))
    S = H @ C @ H.T + np.diag(np.repeat([r.covariance[0, 0] for r in readings], 2))
    log_z = []
    for i, model in enumerate(built):
        mean = weighed[i].along.at(every).ravel()
        z = np.concatenate([r.value for r in readings]) - H @ mean
        posterior = mean + C @ H.T @ np.linalg.solve(S, z)
        log_z.append(-0.5 * z @ np.linalg.solve(S, z))
        start, which = model.initial(weighed[i].starts[0])[None], np.array([i])
        solution = SecondOrder().solve(Assembly(built), start, which)[0]
        found = solution.state[:, model.columns["level 0"]]
        np.testing.assert_allclose(found.ravel(), posterior[4 * n :], atol=1e-6)
        again = GtsamLM().solve(Assembly(built), start, which)[0]
        np.testing.assert_allclose(again.state, solution.state, atol=1e-5)
        # The robot, all but free of η_0, costs next to nothing: what is left is −log p(data | i).
        log_z[-1] += solution.energy - weighed[i].log_prior
    assert log_z[0] == pytest.approx(log_z[1], abs=1e-5)


def test_order_of_arrival_does_not_matter_but_time_stamps_do():
    rng = np.random.default_rng(2)
    times = rng.uniform(8.5, 12.5, 12)
    values = rng.normal([0.7, 0.2], 0.3, (12, 2))
    readings = [reading(t, v, 0.2) for t, v in zip(times, values, strict=True)]
    level = Level(sigma=0.5)

    def planned(data):
        return plan(scenario(level=level).replace(data=data))

    batch = planned((Readings(tuple(readings)),))
    one_by_one = planned(tuple(Readings((readings[j],)) for j in rng.permutation(12)))
    moved = rng.permutation(times)
    shuffled = planned(
        (Readings(tuple(reading(t, r.value, 0.2) for t, r in zip(moved, readings, strict=True))),)
    )
    for a, b in zip(batch.components, one_by_one.components, strict=True):
        np.testing.assert_allclose(a.robot.states, b.robot.states, atol=1e-10)
        assert a.log_prior == pytest.approx(b.log_prior, abs=1e-10)
        assert a.energy == pytest.approx(b.energy, abs=1e-9)
    assert (
        np.abs(batch.components[0].robot.states - shuffled.components[0].robot.states).max() > 1e-3
    )


def test_old_data_fades():
    """A push to the left bends the plan less the longer ago it was."""

    def bend(age):
        pushed = (reading(10 - age - k / 10, (0.8, 0.5)) for k in range(5))
        straight = (GivenPlan("on", np.array([[0, 0], [8, 0.0]])),)
        s = scenario(*pushed, level=Level(sigma=0.5, length=2.0), plans=straight)
        best = plan(s).components[0]
        return best.robot.positions[-1, 1]

    bends = [bend(age) for age in (0.05, 1.0, 2.0, 4.0, 30.0)]
    assert bends[0] > 0.1
    assert np.all(np.diff(bends) < 0)
    assert bends[-1] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("vehicle", [None, DifferentialDrive()])
def test_data_on_the_robot_bends_the_robot(vehicle):
    robot = Robot(np.zeros(2), np.array([0.8, 0.0]), heading=0.0)
    if vehicle is not None:
        robot = Robot(np.zeros(2), np.array([0.8, 0.0]), heading=0.0, model=vehicle)
    there = reading(11.5, (1.0, 0.3), 0.02, "position")
    s = scenario(there, on="robot", robot=robot)
    best = plan(s).components[0]
    np.testing.assert_allclose(best.robot.at(1.5)[:2], [1.0, 0.3], atol=0.05)
    past, none = (
        plan(scenario(*told, on="robot", robot=robot)).components[0].robot.states
        for told in ([reading(9.5, (0.0, 5.0))], [])
    )
    np.testing.assert_array_equal(past, none)


@pytest.mark.parametrize("sigma", [0.0, 0.5])
def test_a_position_without_a_time_is_where_each_plan_is_nearest(sigma):
    place = Reading(None, np.array([1.5, 0.56]), 0.01 * np.eye(2))
    s = scenario(place, level=Level(sigma=sigma))
    mixture = plan(s)
    assert mixture.components[0].label == "up"
    up = {h.label: h for h in hypotheses(s)}["up"]
    t = nearest(place, up.along)
    fine = np.linspace(0, 8, 80001)
    gap = np.linalg.norm(up.along.at(fine)[:, :2] - place.value, axis=1)
    assert t == pytest.approx(fine[np.argmin(gap)], abs=1e-3)


def test_log_likelihood_of_a_known_trajectory():
    positions, ahead = np.array([[0, 0], [1, 0.0]]), np.array([[1, 0], [1, 0.0]])
    line = Trajectory(np.array([0.0, 1.0]), positions, ahead)
    zs = (reading(0.5, (0.5, 0.2), 0.1, "position"), reading(3.0, (1.0, 0.3), 0.2))
    assert log_likelihood(zs, line) == pytest.approx(-0.5 * (4 + 2.25), abs=1e-12)


def held(name, y, x=0.0, v=0.8, ahead=2.0):
    """A plan along y, at x now, that is known from a second ago on and for `ahead` seconds."""

    def going(x, times):
        at = np.column_stack([x + v * times, np.full_like(times, y)])
        return Trajectory(times, at, np.tile([v, 0.0], (len(times), 1)))

    times = 0.4 * np.arange(6)
    on = going(x, 0.4 * np.arange(1 + round(ahead / 0.4)))
    course = Course(np.array([-1.0, 0.0]), (going(x - v, times), on))
    now = going(x, times)
    return Hypothesis(name, -np.log(2), now, 0.0, (Start("plan", now),), None, course)


@pytest.mark.parametrize("sigma", [0.05, 0.3, 1.0])
def test_a_place_weighs_the_same_just_ahead_and_just_passed(sigma):
    """Two plans at the same distance to a place: one has passed it, the other has it ahead. By
    Gaussian algebra log p(z | i) = log N(z; η_i, R + σ²), and both are of the state now."""
    level = Level(sigma=sigma, h=1e6)
    pair = (held("passed", 0.5, 0.01), held("ahead", -0.5, -0.01))
    told = scenario(Reading(None, np.zeros(2), 0.09 * np.eye(2)), level=level)
    mixture = plan(told, hypotheses=lambda *_: pair)
    mass = dict(zip((c.label for c in mixture.components), mixture.probability_mass, strict=True))
    assert mass["passed"] == pytest.approx(0.5, abs=0.01)
    height = dict(
        zip((c.label for c in mixture.components), mixture.probability_height, strict=True)
    )
    assert height["passed"] == pytest.approx(0.5, abs=0.01)


def test_a_place_that_is_kept_no_longer_weighs_as_a_density_on_every_plan():
    R, sigma = 0.09 * np.eye(2), 0.5
    place = Reading(None, np.array([0.4, 0.2]), R)
    pair = (held("passed", 0.4, 0.8), held("ahead", -0.3, -0.8))
    after = heard(scenario(place, level=Level(sigma=sigma)), pair)
    expected = [
        -np.log(2)
        + multivariate_normal(h.along.at(nearest(place, h.along))[:2], S).logpdf([0.4, 0.2])
        for h, S in ((h, R + sigma**2 * np.eye(2)) for h in pair)
    ]
    assert [h.log_prior for h in after] == pytest.approx(expected, abs=1e-9)


def dense(process, times):
    """Covariance of the positions of a stationary process at times, in any order."""
    order = np.argsort(times, kind="stable")
    ordered = np.asarray(times)[order]
    C = covariance(process, ordered - ordered[0], process.stationary)
    back = np.argsort(order)
    positions = (4 * back[:, None] + np.arange(2)).ravel()
    return C[np.ix_(positions, positions)]


def against_straight_plans(pair, places, process, R):
    """log p(z | i) of places, each when the plan is nearest to it, by dense Gaussian algebra."""
    found = []
    for h in pair:
        times = [nearest(place, h.along) for place in places]
        S = dense(process, times) + np.kron(np.eye(len(places)), R)
        off = np.concatenate([p.value for p in places]) - h.along.at(times)[:, :2].ravel()
        found.append(multivariate_normal(cov=S).logpdf(off))
    return np.array(found)


@pytest.mark.parametrize(
    "xs",
    [[8.0, 8.2, 8.4, 8.6, 8.8], [0.34, 0.4, 0.46, 0.52], [-0.6, -0.4, -0.3], [-0.5, -0.3, 0.35, 5]],
    ids=["beyond the horizon", "between two steps", "passed", "passed and ahead"],
)
def test_places_without_a_time_share_what_the_level_wanders(xs):
    """Jointly with each other, whatever they lie between, before now as after it."""
    R, process = 0.01 * np.eye(2), Matern(0.5, 4.0)
    places = [Reading(None, np.array([x, 0.0]), R) for x in xs]
    level = Level(sigma=0.5, length=4.0, h=1e6)
    pair = (held("up", 0.6, ahead=16.0), held("down", -0.3, ahead=16.0))
    mixture = plan(scenario(*places, level=level), hypotheses=lambda *_: pair)
    log_mass = {
        c.label: np.log(p)
        for c, p in zip(mixture.components, mixture.probability_mass, strict=True)
    }
    up, down = against_straight_plans(pair, places, process, R)
    assert log_mass["up"] - log_mass["down"] == pytest.approx(up - down, abs=0.01)


def test_a_place_without_a_time_is_one_at_the_time_it_is_found_for():
    """Among readings with times in the same interval and beyond the horizon."""
    level, pair = Level(sigma=0.5, length=4.0), (held("only", 0.3, ahead=16.0),)
    xs, R = [0.4, 8.0], 0.01 * np.eye(2)
    with_times = [reading(10.45, (0.36, 0.1), 0.1, "position"), reading(20.2, (0.7, 0.2))]
    free = [Reading(None, np.array([x, 0.0]), R) for x in xs]
    stated = [
        Reading(10.0 + nearest(place, pair[0].along), place.value, place.covariance)
        for place in free
    ]
    a, b = (
        on_level(scenario(*with_times, *some, level=level), 0, pair)[0] for some in (free, stated)
    )
    for one, other in zip(a.pieces, b.pieces, strict=True):
        assert one.first == other.first
        np.testing.assert_allclose(one.residual.b, other.residual.b, atol=1e-6)
        assert one.residual.log_normalizer == pytest.approx(other.residual.log_normalizer, abs=1e-6)


FREE = (
    Reading(None, np.array([1.4, 0.1]), 0.04 * np.eye(2)),
    Reading(None, np.array([8.0, 0.2]), 0.25 * np.eye(2)),
)
STAMPED = (
    reading(10.15, (0.9, 0.1), 0.4), reading(11.0, (1.0, 0.4), 0.2, "position"),
)  # fmt: skip


@pytest.mark.parametrize(
    "before",
    [
        (reading(9.1, (0.2, 0.3)), reading(9.6, (0.7, 0.4), 0.3)),
        (Reading(None, np.array([-0.3, 0.2]), 0.04 * np.eye(2)),),
    ],
    ids=["stamped", "passed"],
)
def test_where_nothing_is_planned_all_data_on_a_random_level_weighs_by_dense_regression(before):
    level, process = Level(sigma=0.6, length=2.0), Matern(0.6, 2.0)
    readings = (*before, *STAMPED, *FREE)
    pair = (held("up", 0.5, ahead=16.0), held("down", -0.2, ahead=16.0))
    found = infer(scenario(*readings, level=level), pair)
    log_z = []
    for h in pair:
        t = np.array([nearest(r, h.along) if r.time is None else r.time - 10.0 for r in readings])
        H = [np.eye(2, 4, k=2 * (r.quantity == "velocity")) for r in readings]
        order = np.argsort(t)
        C = covariance(process, t[order] - t.min(), process.stationary)
        rows = block_diag(*(H[j] for j in order))
        S = rows @ C @ rows.T + block_diag(*(readings[j].covariance for j in order))
        z = np.concatenate([readings[j].value - H[j] @ h.along.at(t[j]) for j in order])
        log_z.append(multivariate_normal(cov=S).logpdf(z))
    assert found[0].log_prior - found[1].log_prior == pytest.approx(log_z[0] - log_z[1], abs=1e-9)
    assert np.logaddexp(*(h.log_prior for h in found)) == pytest.approx(0, abs=1e-12)


def test_where_nothing_is_planned_a_level_without_a_plan_is_refused():
    levels = (Level(), Level("free", sigma=np.inf, Qc=0.5))
    with pytest.raises(ValueError, match=r"levels \['free'\] have sigma = inf"):
        infer(scenario(levels=levels), ())
