"""Data on the levels and the robot → factors, and weights of the hypotheses: p(η, i | data).

Each datum enters once. On a level that is random it is a factor of that level: it bends the
trajectory, and reweights the hypotheses through energy and evidence. On a level without width,
which is the hypothesis's plan itself, it can only reweight: its density, evaluated on the plan at
the datum's own time, goes into the hypothesis's weight.

Time stamps, for a level that is random:

- none: the time at which the hypothesis's plan comes nearest to the position, and from there on as
  if it had been stated; if that is before now, it is of the state now, and given that state it is
  taken as independent of other data before now;
- between two steps: exactly, by the level's own process between its states;
- beyond the horizon: by the process from the last state on;
- before now: by the process from then to now, as a density of the state now, so that old data
  fades as the process forgets and by nothing else. What the past says against the whole hypothesis
  is part of the hypothesis's weight.

The robot's own past is known, so data about it before now says nothing more.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from factors.markov import (
    Matern,
    Memory,
    Process,
    Seen,
    WhiteAcceleration,
    behind,
    between,
    beyond,
    remembered,
)
from factors.measurement import position_measurement
from factors.residual import Linear, log_gaussian_normalizer, whitener
from fgplan.hypothesis import Course, Heard, Hypothesis
from fgplan.measuring import ROBOT, Measurement, Reading
from fgplan.robots import Piece
from fgplan.scenario import Density, Level, Scenario
from fgplan.trajectory import Trajectory

Array = NDArray[np.float64]
Stamped = tuple[float, Reading]
"""A reading and its time from now [s]."""

FORGOTTEN = 30.0
"""Correlation times after which a level has forgotten its state: what is left of it,
(1 + λt) e^(−λt) with λ = √3 / length, is 2e-21 and below rounding."""
LOOK = 0.1
"""How finely the nearest time to a position is looked for at first [s]."""


def reweigh(scenario: Scenario, hypotheses: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """Hypotheses with log p(i | data) for log w_i, as far as data does not bend their levels.

    That is: all data on levels without width, and what data before now says against a level that
    is random. Without data the hypotheses are returned as they are.
    """
    hypotheses = tuple(hypotheses)
    if not scenario.data or any(h.plan is None for h in hypotheses):
        return hypotheses
    return _less(hypotheses, _against(scenario, hypotheses)[0])


def infer(scenario: Scenario, hypotheses: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """Hypotheses with log p(i | data) for log w_i, by all data: where nothing is planned that would
    weigh what is not in `reweigh`.

    Each level that is random is integrated out around its plan, by itself. Factors on steps, which
    are no readings, are taken on the plan itself.

    Raises:
        ValueError: a level has no plan that would tell hypotheses apart.
    """
    hypotheses = tuple(hypotheses)
    flat = [level.name for level in scenario.levels if not np.isfinite(level.sigma)]
    if flat:
        raise ValueError(
            f"levels {flat} have sigma = inf: without a plan of their own, data on them does not "
            "tell where it leads; leave them out, or give them a finite sigma"
        )
    if not scenario.data or any(h.plan is None for h in hypotheses):
        return hypotheses
    against, memories = _against(scenario, hypotheses)
    for level in scenario.levels:
        if level.sigma > 0:
            memory = memories.get(level.name)
            against += [
                _around_plan(scenario, level, h, memory, i) for i, h in enumerate(hypotheses)
            ]
    return _less(hypotheses, against)


def _less(hypotheses: Sequence[Hypothesis], against: Array) -> tuple[Hypothesis, ...]:
    """Hypotheses with what data says against them taken off their weights, normalised."""
    score = np.array([h.log_prior for h in hypotheses]) - against
    score -= np.logaddexp.reduce(score)
    return tuple(
        replace(h, log_prior=weight) for h, weight in zip(hypotheses, score.tolist(), strict=True)
    )


def heard(scenario: Scenario, hypotheses: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """Hypotheses that have heard the readings of a scenario, all of which are of before now: these
    need not be kept, the hypotheses say the same without them.

    What the readings say against a hypothesis is in its weight, which is not normalised; what they
    say of a random level's state now, in `Hypothesis.heard`. The plans must be those there were.
    """
    against, memories = _against(scenario, hypotheses)
    for level in scenario.levels:
        if level.sigma > 0:
            data = measuring(scenario, level.name)
            against += [_forgotten(level, data, h) for h in hypotheses]
    found = []
    for i, hypothesis in enumerate(hypotheses):
        known = {
            name: Heard(scenario.now, memory.A, memory.b[:, i]) for name, memory in memories.items()
        }
        weight = hypothesis.log_prior - float(against[i])
        found.append(replace(hypothesis, log_prior=weight, heard={**hypothesis.heard, **known}))
    return tuple(found)


def _against(
    scenario: Scenario, hypotheses: Sequence[Hypothesis]
) -> tuple[Array, dict[str, Memory]]:
    """What data says against each hypothesis, shape (K,) [nats], and of random levels now."""
    against, memories = np.zeros(len(hypotheses)), {}
    for index, level in enumerate(scenario.levels):
        if level.sigma == 0:
            data = measuring(scenario, level.name)
            against += [_on_plan(scenario, level, data, h) for h in hypotheses]
            continue
        memory = _memory(scenario, index, hypotheses)
        if memory is not None:
            against += memory.energy
            memories[level.name] = memory
    return against, memories


def measuring(scenario: Scenario, name: str) -> tuple[Measurement, ...]:
    """The data on one level, or on the robot."""
    first = scenario.levels[0].name
    return tuple(m for m in scenario.data if (first if m.on is None else m.on) == name)


def log_likelihood(
    readings: Iterable[Reading],
    course: Course | Trajectory,
    now: float = 0.0,
) -> float:
    """log p(z | η) of readings of a known trajectory, up to a constant of the readings [nats].

    Args:
        readings: On the clock of `now`; one without a time is where the trajectory is nearest.
        course: Times from now; outside of them its first or last velocity is held.
        now: [s].
    """
    readings = tuple(readings)
    if not readings:
        return 0.0
    times = [nearest(r, course) if r.time is None else r.time - now for r in readings]
    if isinstance(course, Trajectory):
        states = course.at(np.array(times))
    else:
        said = [t if r.said is None else r.said - now for t, r in zip(times, readings, strict=True)]
        states = course.at(np.array(times), np.array(said))
    first = np.array([0 if r.quantity == "position" else 2 for r in readings])
    expected = np.take_along_axis(states, first[:, None] + np.arange(2), axis=1)
    error = np.array([r.value for r in readings]) - expected
    R = np.array([r.covariance for r in readings])
    return -0.5 * float(np.sum(error * np.linalg.solve(R, error[..., None])[..., 0]))


def weigh(weights: Any, plans: Any, z: Any, covariance: Any) -> Array:
    """p(i | z) ∝ w_i N(z; η_i, R): the weights of plans that are known exactly, shape (n,).

    Args:
        weights: w_i > 0, shape (n,).
        plans: What each plan has where the data is, shape (n, m), or (n,) for one number each.
        z: The data, shape (m,), or a number.
        covariance: R, shape (m, m), or a number.

    Raises:
        ValueError: the covariance is not symmetric positive definite, or the shapes do not fit.
    """
    R = np.atleast_2d(np.asarray(covariance, dtype=float))
    at = np.asarray(plans, dtype=float).reshape(len(weights), len(R))
    datum = position_measurement(np.atleast_1d(np.asarray(z, dtype=float)), R, dim=len(R))
    score = np.log(np.asarray(weights, dtype=float)) - datum.energy(at)
    return np.asarray(np.exp(score - np.logaddexp.reduce(score)))


def nearest(reading: Reading, course: Course | Trajectory) -> float:
    """When a trajectory is nearest to a position, in units of its noise; the first time, if it is
    so more than once."""
    W = whitener(reading.covariance)

    def distance(t: Any) -> Array:
        return np.asarray(np.sum(((course.at(t)[..., :2] - reading.value) @ W.T) ** 2, axis=-1))

    first, last = float(course.times[0]), float(course.times[-1])
    times = np.linspace(first, last, 1 + max(1, int(np.ceil((last - first) / LOOK))))
    for _ in range(3):  # each round looks closer around the best of the one before
        best = int(np.argmin(np.round(distance(times), 9)))
        low, high = times[max(best - 1, 0)], times[min(best + 1, len(times) - 1)]
        found, times = float(times[best]), np.linspace(low, high, 41)
    return found


def robot_pieces(scenario: Scenario) -> Iterable[Piece]:
    """Data on f^R, on states (x, y, vx, vy)."""
    d, now = scenario.density, scenario.now
    data = measuring(scenario, ROBOT)
    if not data:
        return
    process = WhiteAcceleration(d.Qc_robot)
    timed = [(r.time - now, r) for r in _readings(data) if r.time is not None]
    for k, seen, group in _grouped(process, timed, d):
        z = np.concatenate([reading.value for _, reading in group])
        yield _piece("robot data", k, seen, z)
    for measurement in data:
        yield from measurement.pieces(now, d.times)


@dataclass(frozen=True, eq=False)
class LevelData:
    """Data on one random level under one hypothesis.

    Args:
        now: Density of the level's state now, given the data before now: instead of the level's
            own prior of that state. None where there is no such data.
        pieces: Data from now on.
    """

    now: Linear | None = None
    pieces: tuple[Piece, ...] = ()


def on_level(
    scenario: Scenario, index: int, hypotheses: Sequence[Hypothesis]
) -> tuple[LevelData, ...]:
    """Data on a random level, for each hypothesis."""
    d, now, level = scenario.density, scenario.now, scenario.levels[index]
    data = measuring(scenario, level.name)
    memory = _memory(scenario, index, hypotheses)
    if not data and memory is None:
        return (LevelData(),) * len(hypotheses)
    process = _process(level, d)
    stamped = [(r.time - now, r) for r in _readings(data) if r.time is not None]
    groups = list(_grouped(process, stamped, d))
    extra = [p for m in data for p in m.pieces(now, d.times) if isinstance(p.residual, Linear)]
    found = []
    for i, hypothesis in enumerate(hypotheses):
        mean = _mean(level, hypothesis)
        free = _free(data, hypothesis.along_of(level.name))
        mine = [*_passed(process, free), *_grouped(process, stamped + free, d)] if free else groups
        pieces = []
        for k, seen, group in mine:
            z = np.concatenate([_deviation(reading, mean, t) for t, reading in group])
            if mean is not None:
                states = mean.at(d.times[k : k + len(seen.weights)])
                z = z + sum(w @ x for w, x in zip(seen.weights, states, strict=True))
            pieces.append(_piece(f"{level.name} data", k, seen, z))
        state_now = None if memory is None else _state_now(memory, i, mean)
        found.append(LevelData(state_now, (*pieces, *extra)))
    return tuple(found)


def curved_pieces(scenario: Scenario, index: int) -> Iterable[Piece]:
    """Data on a random level that is not linear, such as a region to keep out of."""
    for measurement in measuring(scenario, scenario.levels[index].name):
        for piece in measurement.pieces(scenario.now, scenario.density.times):
            if not isinstance(piece.residual, Linear):
                yield piece


def _on_plan(
    scenario: Scenario, level: Level, data: Sequence[Measurement], hypothesis: Hypothesis
) -> float:
    """−log p(data | η = the plan) [nats]."""
    known = log_likelihood(_readings(data), hypothesis.along_of(level.name), scenario.now)
    return _pieces_on_plan(scenario, level, data, hypothesis) - known


def _pieces_on_plan(
    scenario: Scenario, level: Level, data: Sequence[Measurement], hypothesis: Hypothesis
) -> float:
    """Energy of factors on steps, η = the plan [nats]."""
    plan = hypothesis.plan_of(level.name)
    assert plan is not None
    times, states, energy = scenario.density.times, plan.states, 0.0
    for measurement in data:
        for piece in measurement.pieces(scenario.now, times):
            steps = piece.steps(len(times) - 1)
            x = [states[steps.start + o : steps.stop + o] for o in piece.offsets]
            energy += float(np.sum(piece.residual.energy(*x)))
    return energy


def _forgotten(level: Level, data: Sequence[Measurement], hypothesis: Hypothesis) -> float:
    """−log p of positions without a time on a random level, around the plan.

    A density of all of them, with its normaliser, since each plan has them at times of its own. A
    level without a plan of its own is as wide as its coupling to one.
    """
    mean = hypothesis.along_of(level.name)
    free = _free(data, mean)
    if not free:
        return 0.0
    width = level.sigma if np.isfinite(level.sigma) else np.sqrt(level.h)
    process, first = Matern(width, level.length), min(t for t, _ in free)
    seen = beyond(process, [t - first for t, _ in free], *_measured(free))
    z = np.concatenate([_deviation(reading, mean, t) for t, reading in free])
    return _surprise([(seen, z)], np.zeros(4), process.stationary)


def _around_plan(
    scenario: Scenario, level: Level, hypothesis: Hypothesis, memory: Memory | None, i: int
) -> float:
    """−log p of data that is not remembered, of a level of finite width [nats]."""
    mean, data = hypothesis.along_of(level.name), measuring(scenario, level.name)
    process = Matern(level.sigma, level.length)
    free = _free(data, mean)
    stamped = [(r.time - scenario.now, r) for r in _readings(data) if r.time is not None]
    ahead = [one for one in (*stamped, *free) if one[0] >= 0]
    groups = list(_passed(process, free))
    if ahead:
        groups.append((0, beyond(process, [t for t, _ in ahead], *_measured(ahead)), ahead))
    said = [
        (seen, np.concatenate([_deviation(reading, mean, t) for t, reading in group]))
        for _, seen, group in groups
    ]
    x, P = np.zeros(4), process.stationary
    if memory is not None:
        root = np.linalg.inv(memory.A)
        x, P = root @ memory.b[:, i], root @ root.T
    return _pieces_on_plan(scenario, level, data, hypothesis) + _surprise(said, x, P)


def _surprise(said: Sequence[tuple[Seen, Array]], x: Array, P: Array) -> float:
    """−log p of readings z, each part seen of one state that is N(x, P)."""
    if not said:
        return 0.0
    W = np.vstack([seen.weights[0] for seen, _ in said])
    S = W @ P @ W.T + block_diag(*(seen.covariance for seen, _ in said))
    e = np.concatenate([z for _, z in said]) - W @ x
    return 0.5 * float(e @ np.linalg.solve(S, e) + np.linalg.slogdet(2 * np.pi * S)[1])


def _memory(scenario: Scenario, index: int, hypotheses: Sequence[Hypothesis]) -> Memory | None:
    """What data before now says about the deviation of a random level from its mean now."""
    level, now = scenario.levels[index], scenario.now
    readings = _readings(measuring(scenario, level.name))
    past = [(r.time - now, r) for r in readings if r.time is not None and r.time < now]
    known, since = _known(level, hypotheses, now)
    if not past and known is None:
        return None
    means = [_mean(level, h) for h in hypotheses]
    z = np.array([_deviations(past, mean, now) for mean in means])
    H, R = _measured(past)
    return remembered(
        _process(level, scenario.density),
        [-t for t, _ in past],
        H,
        z.reshape(len(hypotheses), -1).T,
        R,
        known,
        since,
    )


def _known(
    level: Level, hypotheses: Sequence[Hypothesis], now: float
) -> tuple[Memory | None, float]:
    """What is left of data that is kept no longer, and how old it is [s]. Who has heard nothing
    deviates from its plan by nothing."""
    told = [h.heard.get(level.name) for h in hypotheses]
    first = next((one for one in told if one is not None), None)
    if first is None or (np.isfinite(level.sigma) and now - first.time > FORGOTTEN * level.length):
        return None, 0.0
    b = [np.zeros(len(first.A)) if one is None else one.b for one in told]
    return Memory(first.A, np.stack(b, axis=1), np.zeros(len(told))), now - first.time


def _state_now(memory: Memory, i: int, mean: Course | None) -> Linear:
    """A level's state now given the past; a density where the past fixes all of it."""
    b = memory.b[:, i]
    if mean is not None:
        b = b + memory.A @ mean.at(0.0)
    rows, size = memory.A.shape
    normalizer = log_gaussian_normalizer(memory.A) if rows == size else 0.0
    return Linear((memory.A,), b, normalizer)


def _process(level: Level, density: Density) -> Process:
    if np.isfinite(level.sigma):
        return Matern(level.sigma, level.length)
    return WhiteAcceleration(density.Qc_robot if level.Qc is None else level.Qc)


def _mean(level: Level, hypothesis: Hypothesis) -> Course | None:
    """Mean of a random level: the plan, at all times; None where it has no prior of its own."""
    return hypothesis.along_of(level.name) if np.isfinite(level.sigma) else None


def _readings(data: Iterable[Measurement]) -> list[Reading]:
    return [reading for measurement in data for reading in measurement.readings]


def _free(data: Iterable[Measurement], course: Course) -> list[Stamped]:
    """Positions without a time, at the times when a plan is nearest to them."""
    return [(nearest(r, course), r) for r in _readings(data) if r.time is None]


def _measured(stamped: Iterable[Stamped]) -> tuple[list[Array], list[Array]]:
    """H and R of readings."""
    readings = [reading for _, reading in stamped]
    return [_matrix(r) for r in readings], [np.asarray(r.covariance) for r in readings]


def _grouped(
    process: Process, stamped: Iterable[Stamped], density: Density
) -> Iterable[tuple[int, Seen, list[Stamped]]]:
    """Readings from now on by interval: its first step, what they say of its states, which."""
    T, dt = density.steps, density.dt
    groups: dict[int, list[Stamped]] = {}
    for t, reading in sorted(stamped, key=lambda one: one[0]):
        if t >= 0:
            groups.setdefault(min(T, int(t / dt)), []).append((t, reading))
    for k, group in groups.items():
        H, R = _measured(group)
        tau = [
            float(np.clip(t - density.times[k], 0.0, np.inf if k == T else dt)) for t, _ in group
        ]
        seen = beyond(process, tau, H, R) if k == T else between(process, dt, tau, H, R)
        yield k, seen, group


def _passed(
    process: Process, free: Sequence[Stamped]
) -> Iterable[tuple[int, Seen, Sequence[Stamped]]]:
    """Positions that a plan was nearest to before now, as `_grouped`: on the state now."""
    passed = [one for one in free if one[0] < 0]
    if passed:
        yield 0, behind(process, [-t for t, _ in passed], *_measured(passed)), passed


def _piece(name: str, k: int, seen: Seen, z: Array) -> Piece:
    W = whitener(0.5 * (seen.covariance + seen.covariance.T))
    residual = Linear(tuple(W @ w for w in seen.weights), W @ z, log_gaussian_normalizer(W))
    return Piece(name, residual, tuple(range(len(seen.weights))), k, k)


def _matrix(reading: Reading) -> Array:
    """H, shape (2, 4)."""
    return np.eye(2, 4, k=0 if reading.quantity == "position" else 2)


def _deviation(reading: Reading, mean: Course | None, t: float) -> Array:
    """A reading less the mean at its time, shape (2,)."""
    if mean is None:
        return np.asarray(reading.value, dtype=float)
    return np.asarray(reading.value - _matrix(reading) @ mean.at(t))


def _deviations(past: Sequence[Stamped], mean: Course | None, now: float) -> Array:
    """Readings less the mean that there was when they were said, shape (n, 2)."""
    values = np.array([reading.value for _, reading in past], dtype=float).reshape(-1, 2)
    if mean is None or not past:
        return values
    times = np.array([t for t, _ in past])
    said = np.array([t if r.said is None else r.said - now for t, r in past])
    first = np.array([0 if r.quantity == "position" else 2 for _, r in past])
    states = mean.at(times, said)
    return np.asarray(values - np.take_along_axis(states, first[:, None] + np.arange(2), axis=1))
