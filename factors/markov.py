"""Time-stamped readings of a Markov Gaussian process whose states are on a time grid.

A state is m positions, then m velocities. All that is needed of the process is its step,
x(t + dt) = A(dt) x(t) + noise of covariance Q(dt); from it follow, exactly and jointly, what any
number of readings between, beyond and before the states of the grid say about those states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from factors.gp_prior import kron, matern_step, transition, white_noise
from factors.residual import Array, whitener

SIMULTANEOUS = 1e-6
"""Readings of the past closer in time than this are of one state [s]."""


class Process(Protocol):
    """A linear Gaussian Markov process."""

    def step(self, dt: float) -> tuple[Array, Array]:
        """A(dt) and Q(dt), each (2m, 2m), for dt ≥ 0 [s]."""
        ...

    @property
    def stationary(self) -> Array | None:
        """Covariance at any time, shape (2m, 2m); None where nothing is known before data."""
        ...


@dataclass(frozen=True)
class WhiteAcceleration:
    """White noise on acceleration, `factors.gp_prior.GPPrior`.

    Args:
        Qc: Power spectral density [m²/s³].
        space: m.
    """

    Qc: float
    space: int = 2

    def step(self, dt: float) -> tuple[Array, Array]:
        eye = np.eye(self.space)
        return transition(dt, self.space), kron(white_noise(dt), self.Qc * eye)

    @property
    def stationary(self) -> Array | None:
        return None


@dataclass(frozen=True)
class Matern:
    """Matérn-3/2 deviation of width sigma [m] and correlation time `length` [s],
    `factors.gp_prior.matern_prior`."""

    sigma: float
    length: float
    space: int = 2

    def step(self, dt: float) -> tuple[Array, Array]:
        A, Q = matern_step(dt, self.sigma, self.length)
        return kron(A, np.eye(self.space)), kron(Q, np.eye(self.space))

    @property
    def stationary(self) -> Array:
        rate = np.sqrt(3) / self.length
        return np.diag(np.repeat([self.sigma, rate * self.sigma], self.space) ** 2)


class Seen(NamedTuple):
    """Readings as z = Σ_i weights[i] x_i + noise: one matrix (rows, 2m) per state, and the
    covariance (rows, rows) of the noise, the process between the states included."""

    weights: tuple[Array, ...]
    covariance: Array


def between(
    process: Process, dt: float, times: Sequence[float], H: Sequence[Array], R: Sequence[Array]
) -> Seen:
    r"""Readings H_j x(t_k + τ_j) + N(0, R_j) between two states, 0 ≤ τ_j ≤ dt, on these two.

    x(t_k + τ_j) = Λ_j x_k + Ψ_j x_{k+1} + noise, with Ψ_j = Q(τ_j) A(dt − τ_j)ᵀ Q(dt)⁻¹ and
    Λ_j = A(τ_j) − Ψ_j A(dt). The noise of two readings is correlated:
    Q(τ_i) A(τ_j − τ_i)ᵀ − Ψ_i Q(dt) Ψ_jᵀ for τ_i ≤ τ_j.

    Reference:
        Barfoot, Tong, Särkkä, RSS 2014, section III-D, there for one reading.
    """
    A, Q = process.step(dt)
    Psi = []
    for tau in times:
        rest = process.step(dt - tau)[0]
        Psi.append(np.linalg.solve(Q, rest @ process.step(tau)[1]).T)
    Lambda = [process.step(tau)[0] - psi @ A for tau, psi in zip(times, Psi, strict=True)]
    noise = _noise(process, times, H, R)
    pinned = np.vstack([h @ psi for h, psi in zip(H, Psi, strict=True)])
    return Seen(
        (np.vstack([h @ lam for h, lam in zip(H, Lambda, strict=True)]), pinned),
        noise - pinned @ Q @ pinned.T,
    )


def beyond(
    process: Process, times: Sequence[float], H: Sequence[Array], R: Sequence[Array]
) -> Seen:
    """Readings H_j x(t_k + τ_j) + N(0, R_j) after the last state, τ_j ≥ 0, on that state."""
    weights = np.vstack([h @ process.step(tau)[0] for tau, h in zip(times, H, strict=True)])
    return Seen((weights,), _noise(process, times, H, R))


def behind(process: Process, ages: Sequence[float], H: Sequence[Array], R: Sequence[Array]) -> Seen:
    """Readings H_j x(t_k − age_j) + N(0, R_j) before a state, age_j ≥ 0, on that state.

    Both processes, backwards in time, are themselves with their velocities turned round.
    """
    turn = np.repeat([1.0, -1.0], H[0].shape[1] // 2)
    seen = beyond(process, ages, [h * turn for h in H], R)
    return Seen((seen.weights[0] * turn,), seen.covariance)


def _noise(
    process: Process, times: Sequence[float], H: Sequence[Array], R: Sequence[Array]
) -> Array:
    """Covariance of readings given the state before all of them."""
    ends = np.cumsum([len(h) for h in H])
    rows = [slice(int(end) - len(h), int(end)) for end, h in zip(ends, H, strict=True)]
    S = np.zeros((ends[-1], ends[-1]))
    for i, ti in enumerate(times):
        S[rows[i], rows[i]] = R[i]
        Q = process.step(ti)[1]
        for j, tj in enumerate(times):
            if tj > ti or (tj == ti and j >= i):
                block = H[i] @ Q @ process.step(tj - ti)[0].T @ H[j].T
                S[rows[i], rows[j]] += block
                if i != j:
                    S[rows[j], rows[i]] += block.T
    return S


class Memory(NamedTuple):
    """What readings of the past say about the state now, x_0: exp(−½‖A x_0 − b‖² − energy).

    Args:
        A: Shape (r, 2m), r ≤ 2m.
        b: Shape (r, K): one column for each of K versions of the readings.
        energy: What they say against the version itself, shape (K,) [nats]; constants that all
            versions share are left out.
    """

    A: Array
    b: Array
    energy: Array


def remembered(
    process: Process,
    ages: Sequence[float],
    H: Sequence[Array],
    z: Array,
    R: Sequence[Array],
    known: Memory | None = None,
    since: float = 0.0,
) -> Memory:
    """Readings z_j = H_j x(−age_j) + N(0, R_j) before now, as a density of the state now.

    Their influence decays through the process alone. A square-root information filter, from the
    oldest on: exact, in any order of arrival, and also where nothing is known before data.

    Args:
        process: Of the deviation from a mean of zero.
        ages: Seconds before now, each ≥ 0.
        H: One matrix (rows_j, 2m) per reading.
        z: Shape (Σ rows_j, K), K versions of the data (one for each mean that was taken off).
        R: One covariance (rows_j, rows_j) per reading.
        known: What earlier readings said of the state `since` seconds before now, which none of
            these is older than; instead of what the process says by itself. So data may come in
            parts, and what is over need not be kept.
        since: [s].

    Reference:
        Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, chapter VI.
    """
    starts = np.cumsum([0, *(len(h) for h in H)])
    order = sorted(range(len(ages)), key=lambda j: -ages[j])
    if known is not None:
        (A, b, energy), clock = known, since
    else:
        A, b, energy = _before_data(process, H[0].shape[1], z.shape[1])
        clock = ages[order[0]]
    steps: dict[float, tuple[Array, Array]] = {}  # readings are often as far apart as others

    def later(dt: float) -> Memory:
        key = round(dt, 9)
        if key not in steps:
            Phi, Q = process.step(dt)
            W = whitener(Q)
            steps[key] = -W @ Phi, W
        return _propagate(*steps[key], A, b, energy)

    for j in order:
        if clock - ages[j] > SIMULTANEOUS:
            A, b, energy = later(clock - ages[j])
            clock = ages[j]
        W = whitener(R[j])
        seen = z[starts[j] : starts[j + 1]]
        A, b, energy = _compress(np.vstack([A, W @ H[j]]), np.vstack([b, W @ seen]), energy)
    if clock > SIMULTANEOUS:
        A, b, energy = later(clock)
    return Memory(A, b, energy)


def _before_data(process: Process, size: int, versions: int) -> Memory:
    A, b = np.zeros((0, size)), np.zeros((0, versions))
    if process.stationary is not None:
        A, b = whitener(process.stationary), np.zeros((size, versions))
    return Memory(A, b, np.zeros(versions))


def _propagate(before: Array, W: Array, A: Array, b: Array, energy: Array) -> Memory:
    """Rows on a state, as rows on a later state, W x' + before x ~ N(0, I): the state itself is
    integrated out."""
    rows, size = A.shape
    joint = np.zeros((size + rows, 2 * size))
    joint[:size, :size], joint[:size, size:], joint[size:, :size] = before, W, A
    rhs = np.zeros((size + rows, b.shape[1]))
    rhs[size:] = b
    basis, upper = np.linalg.qr(joint, mode="complete")
    turned = basis.T @ rhs
    # The first rows fix the earlier state whatever the later one is: `before` has full rank.
    return _compress(upper[size:, size:], turned[size:], energy)


def _compress(A: Array, b: Array, energy: Array) -> Memory:
    """The same quadratic in at most as many rows as columns, and what is left over."""
    size = A.shape[1]
    if len(A) <= size:
        return Memory(A, b, energy)
    basis, upper = np.linalg.qr(A, mode="complete")
    turned = basis.T @ b
    left = 0.5 * np.sum(turned[size:] ** 2, axis=0)
    return Memory(upper[:size], turned[:size], energy + left)
