"""The chosen plan flips where it should: against a brute-force evaluation of the density.

The oracle below shares no code with the library. It is the joint density as the paper and
docs/density.md state it, in plain numpy: dense Gaussian process priors over whole trajectories
instead of factors between neighbours, a Gaussian process regression of each track instead of a
Kalman filter, and scipy's L-BFGS from random starts instead of the library's solver.

With log(w_1/w_2) = E_1 − E_2 the two hypotheses are equally probable; a little below the second
must be selected, a little above the first.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.optimize import minimize

from fgplan import Density, GivenPlan, Robot, Scenario, Track, plan

DT, STEPS, QC_ROBOT, QC_PEOPLE = 0.4, 12, 2.0, 0.029
ALPHA, H_C, H = 0.99, 0.36, 1.0
RADIUS, PERSON, MARGIN, CONTACT_SIGMA = 0.25, 0.3, 0.2, 0.1
TOP_ACCELERATION, LIMIT_SIGMA, CRUISE = 1.5, 0.1, 1.0
LIMIT_SHARE = 0.95  # where the hinge of a limit begins
FAST, SLOW = 1.5, 1.05
"""Top speeds [m/s]: one that no plan here needs, and one that the optima lean on."""
TRACK_SIGMA, SPEED_SIGMA = 0.043, 1.5
T = DT * np.arange(STEPS + 1)
NOW = np.array([0.0, 0.0, 0.8, 0.0])
EDGE = 0.01
"""How far from the flip point the choice is tried [nats]."""

PATHS = {
    "left": np.array([[0.0, 0.0], [2.0, 1.5], [6.0, 1.5], [8.0, 0.0]]),
    "right": np.array([[0.0, 0.0], [1.5, -1.9], [6.5, -1.9], [8.0, 0.0]]),
}
STAMPS = np.linspace(-2.0, 0.0, 6)


def walked(x: float, y: float, vx: float, vy: float) -> np.ndarray:
    return np.column_stack([x + vx * STAMPS, y + vy * STAMPS])


CROWDS = {
    "nobody": [],
    "one": [walked(3.4, 1.2, -0.5, 0.0)],
    "two": [walked(3.4, 1.2, -0.5, 0.0), walked(3.6, -2.6, 0.0, 0.3)],
}


# The library


def scenario(crowd: str, mode: str, log_ratio: float, top: float = FAST) -> Scenario:
    density = Density(
        dt=DT, horizon=DT * STEPS, t_ref=0.4, Qc_robot=QC_ROBOT, Qc_people=QC_PEOPLE,
        sigma_track=TRACK_SIGMA, sigma_speed=SPEED_SIGMA, alpha=ALPHA, h_c=H_C,
        contact_sigma=CONTACT_SIGMA, contact_margin=MARGIN, limit_sigma=LIMIT_SIGMA,
    )  # fmt: skip
    weights = {"left": float(np.exp(log_ratio)), "right": 1.0}
    return Scenario(
        Robot(NOW[:2], NOW[2:], radius=RADIUS, preferred_speed=CRUISE, max_speed=top,
              max_acceleration=TOP_ACCELERATION),
        tracks=tuple(Track(f"p{i}", STAMPS, p, PERSON) for i, p in enumerate(CROWDS[crowd])),
        plans=tuple(GivenPlan(name, path, weights[name]) for name, path in PATHS.items()),
        count=0, crowd=mode, density=density,
    )  # fmt: skip


# The oracle


def process(t: float, q: float) -> tuple[np.ndarray, np.ndarray]:
    """Phi(t) and Q(t) of white noise on acceleration, one axis."""
    return np.array([[1, t], [0, 1.0]]), q * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])


def trajectory(mean: np.ndarray, covariance: np.ndarray, q: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean (S, 2) and a square root of the dense covariance (2S, 2S) of one axis from t_0 on:
    cov(x(s), x(t)) = C(s) Phi(t − s)ᵀ for s ≤ t, C(s) = Phi(s) P Phi(s)ᵀ + Q(s)."""
    S = len(T)
    K = np.zeros((S, 2, S, 2))
    for i, s in enumerate(T):
        Phi, Q = process(s, q)
        C = Phi @ covariance @ Phi.T + Q
        for j in range(i, S):
            K[i, :, j] = C @ process(T[j] - s, q)[0].T
            K[j, :, i] = K[i, :, j].T
    eigenvalues, vectors = np.linalg.eigh(K.reshape(2 * S, 2 * S))
    root = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    return np.stack([process(t, q)[0] @ mean for t in T]), root


def tracked(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (2, 2), axis by axis, and covariance (2, 2) of one axis of (p, v) at t = 0, by
    regression on the whole track: the first position is unknown, the first velocity N(0, s²)."""
    m = len(STAMPS)
    rows, right = [np.eye(1, 2 * m, 1) / SPEED_SIGMA], [np.zeros((1, 2))]
    for k, dt in enumerate(np.diff(STAMPS)):
        Phi, Q = process(dt, QC_PEOPLE)
        motion = np.zeros((2, 2 * m))
        motion[:, 2 * k : 2 * k + 4] = np.hstack([-Phi, np.eye(2)])
        rows.append(np.linalg.solve(np.linalg.cholesky(Q), motion))
        right.append(np.zeros((2, 2)))
    for k in range(m):
        rows.append(np.eye(1, 2 * m, 2 * k) / TRACK_SIGMA)
        right.append(positions[k : k + 1] / TRACK_SIGMA)
    A = np.vstack(rows)
    information = A.T @ A
    x = np.linalg.solve(information, A.T @ np.vstack(right))
    return x[-2:].T, np.linalg.inv(information)[-2:, -2:]


def followed(path: np.ndarray) -> np.ndarray:
    """The plan at the times T: from the speed along its first leg up to cruise, and on."""
    legs = np.diff(path, axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    speed = max(0.0, legs[0] @ NOW[2:] / lengths[0])
    rise = (CRUISE - speed) / TOP_ACCELERATION
    rising = np.minimum(T, rise)
    s = speed * rising + 0.5 * TOP_ACCELERATION * rising**2 + CRUISE * (T - rising)
    end = np.append(0, np.cumsum(lengths))
    assert s[-1] < end[-1] - CRUISE**2 / (2 * TOP_ACCELERATION)  # it does not brake yet
    return np.column_stack([np.interp(s, end, path[:, axis]) for axis in range(2)])


class Oracle:
    """−log density of one hypothesis, without what all hypotheses share, in coordinates z in
    which the Gaussian priors are N(0, I)."""

    def __init__(self, name: str, crowd: str, mode: str, top: float) -> None:
        self.plan = followed(PATHS[name])
        self.top = top
        self.people = [tracked(p) for p in CROWDS[crowd]]
        self.joint = mode == "joint"
        axes = [trajectory(NOW[[a, 2 + a]], np.zeros((2, 2)), QC_ROBOT) for a in range(2)]
        if self.joint:
            axes += [trajectory(mean[a], P, QC_PEOPLE) for mean, P in self.people for a in range(2)]
        self.mean = np.concatenate([mean.ravel() for mean, _ in axes])
        self.root = block_diag(*[root for _, root in axes])

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """Energies (B,) of points (B, dim)."""
        x = (self.mean + z @ self.root.T).reshape(len(z), -1, 2, len(T), 2)
        position, velocity = x[..., 0], x[..., 1]  # (B, body, axis, S)
        robot, w = position[:, 0], DT / 0.4
        energy = 0.5 * (z**2).sum(1)
        energy += w * ((robot - self.plan.T) ** 2).sum((1, 2)) / (2 * H)
        speed = np.linalg.norm(velocity[:, 0, :, 1:], axis=1)
        energy += (
            w
            * 0.5
            * (np.maximum(0, speed - LIMIT_SHARE * self.top) / LIMIT_SIGMA).__pow__(2).sum(1)
        )
        change = np.linalg.norm(np.diff(velocity[:, 0], axis=-1), axis=1) / DT
        excess = np.maximum(0, change - LIMIT_SHARE * TOP_ACCELERATION) / LIMIT_SIGMA
        energy += w * 0.5 * (excess**2).sum(1)
        for i, (mean, P) in enumerate(self.people):
            if self.joint:
                person, width = position[:, 1 + i], np.full(len(T), H_C**2)
            else:
                person = mean[:, :1] + mean[:, 1:] * T
                width = H_C**2 + np.array([self.spread(P, t) for t in T])
            d2 = ((robot - person) ** 2).sum(1)
            energy -= w * np.log1p(-ALPHA * np.exp(-d2 / (2 * width))).sum(1)
            inside = np.maximum(0, RADIUS + PERSON + MARGIN - np.sqrt(d2))
            energy += w * 0.5 * (inside**2).sum(1) / CONTACT_SIGMA**2
            for j in range(i) if self.joint else ():
                apart = ((person - position[:, 1 + j]) ** 2).sum(1)
                energy -= w * np.log1p(-ALPHA * np.exp(-apart / (2 * H_C**2))).sum(1)
        return energy

    @staticmethod
    def spread(P: np.ndarray, t: float) -> float:
        Phi, Q = process(t, QC_PEOPLE)
        return float((Phi @ P @ Phi.T + Q)[0, 0])

    def slope(self, z: np.ndarray) -> np.ndarray:
        step = 1e-5 * np.eye(len(z))
        both = self(np.vstack([z + step, z - step]))
        return (both[: len(z)] - both[len(z) :]) / 2e-5

    def search(self, z: np.ndarray) -> tuple[np.ndarray, float]:
        """A local minimum near z, and its energy."""
        result = minimize(
            lambda z: (float(self(z[None])[0]), self.slope(z)), z, jac=True, method="L-BFGS-B",
            options={"maxiter": 500, "ftol": 1e-12, "gtol": 1e-6},
        )  # fmt: skip
        return result.x, float(result.fun)

    def lowest(self, starts: int, seed: int) -> float:
        """The best of local searches: from the prior mean, and with the robot's first minimum
        pushed aside at random, by up to 2.5 m either way, and the people at their prediction."""
        rng = np.random.default_rng(seed)
        first, energy = self.search(np.zeros(len(self.mean)))
        found = [energy]
        first[4 * len(T) :] = 0
        aside = np.linspace(-2.5, 2.5, starts) + rng.uniform(-0.3, 0.3, starts)
        for shift, when in zip(aside, rng.uniform(2.0, 4.0, starts), strict=True):
            bump = shift * np.exp(-((T - when) ** 2)) * (T > 0)
            slope = -2 * (T - when) * bump
            y = np.zeros((len(self.mean) // (2 * len(T)), len(T), 2))
            y[1] = np.column_stack([bump, slope])  # the robot's second axis
            start = first + np.linalg.lstsq(self.root, y.ravel(), rcond=1e-8)[0]
            found.append(self.search(start)[1])
        return min(found)


@lru_cache
def energies(crowd: str, mode: str, top: float = FAST) -> dict[str, float]:
    starts = 0 if crowd == "nobody" else 6
    return {name: Oracle(name, crowd, mode, top).lowest(starts, seed=7) for name in PATHS}


def flip(crowd: str, mode: str) -> float:
    """log(w_left/w_right) at which both are equally probable, by brute force."""
    found = energies(crowd, mode)
    return found["left"] - found["right"]


CASES = [(crowd, mode) for crowd in CROWDS for mode in ("joint", "predicted")]
SLOW_CASES = [("one", "joint", SLOW), ("one", "predicted", SLOW)]


@pytest.mark.parametrize(("crowd", "mode", "top"), [*((*c, FAST) for c in CASES), *SLOW_CASES])
def test_energies_are_those_of_the_brute_force_evaluation(crowd, mode, top):
    # Seen to fail, at the low top speed, with the contact hinge left out of fgplan/model.py.
    found = {c.label: c.energy for c in plan(scenario(crowd, mode, 0.0, top)).components}
    assert found == pytest.approx(energies(crowd, mode, top), abs=2e-4)


def test_a_low_top_speed_costs_energy():
    """So that the limit is part of what is compared."""
    slow, fast = energies("one", "predicted", SLOW), energies("one", "predicted")
    assert slow["left"] > fast["left"] + EDGE


@pytest.mark.parametrize(("crowd", "mode"), CASES)
def test_the_choice_flips_at_the_brute_force_flip_point(crowd, mode):
    # Seen to fail with the interaction left out of fgplan/model.py, where there are people, and
    # everywhere with h = 1.1 m² in place of 1.
    point = flip(crowd, mode)
    for side, expected in ((-EDGE, "right"), (EDGE, "left")):
        mixture = plan(scenario(crowd, mode, point + side))
        assert all(component.feasible for component in mixture.components)
        assert mixture.best.label == expected
        height = dict(
            zip(
                [c.label for c in mixture.components], mixture.probability_height.tolist(),
                strict=True,
            )
        )  # fmt: skip
        assert np.log(height["left"] / height["right"]) == pytest.approx(side, abs=5e-4)


@pytest.mark.parametrize("mode", ["joint", "predicted"])
def test_the_people_move_the_flip_point(mode):
    """At weights between the two flip points the crowd alone changes which plan is chosen."""
    alone, among = flip("nobody", mode), flip("one", mode)
    assert among > alone + 10 * EDGE  # somebody on the left: the left needs a greater weight
    assert abs(flip("two", mode) - among) > EDGE
    middle = (alone + among) / 2
    assert plan(scenario("nobody", mode, middle)).best.label == "left"
    assert plan(scenario("one", mode, middle)).best.label == "right"


def test_a_sweep_of_the_weights_flips_once():
    point = flip("one", "joint")
    chosen = [
        plan(scenario("one", "joint", ratio)).best.label for ratio in point + np.linspace(-2, 2, 14)
    ]
    assert chosen == ["right"] * 7 + ["left"] * 7
