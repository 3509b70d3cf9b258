"""Gaussian-process priors over trajectories, as factors between consecutive states.

A state is m positions, then m velocities. Both processes are Markov in that state, so the exact
prior of a whole trajectory is a product over neighbours.
"""

from __future__ import annotations

from functools import cached_property, lru_cache

import numpy as np

from factors.residual import Array, Linear, log_gaussian_normalizer, positive, whitener


class GPPrior(Linear):
    r"""White-noise-on-acceleration (WNOA) prior between consecutive states.

    e = x_{k+1} − Phi(dt) x_k,  e ~ N(0, Q(dt)),  x = (p, v), constant velocity on average.

    Args:
        dt: Time between the two states [s].
        Qc: Power spectral density of the acceleration, shape (m, m) [m²/s³].

    Raises:
        ValueError: dt is not positive, or Qc is not symmetric positive definite.

    Reference:
        Barfoot, Tong, Särkkä, RSS 2014.
    """

    dt: float
    Qc: Array

    def __init__(self, dt: float, Qc: Array) -> None:
        positive(dt=dt)
        W = kron(whitener(white_noise(dt)), whitener(Qc, "Qc"))
        m = len(np.atleast_2d(Qc))
        super().__init__((-W @ transition(dt, m), W), np.zeros(2 * m), log_gaussian_normalizer(W))
        object.__setattr__(self, "dt", float(dt))
        object.__setattr__(self, "Qc", np.atleast_2d(np.asarray(Qc, dtype=float)))

    @cached_property
    def Q(self) -> Array:
        """Covariance of e, shape (2m, 2m)."""
        return kron(white_noise(self.dt), self.Qc)

    def interpolate(self, tau: float) -> tuple[Array, Array]:
        r"""Λ, Ψ, each (2m, 2m), of the conditional mean x(t_k + τ) = Λ x_k + Ψ x_{k+1}.

        Args:
            tau: Time after the first state, 0 ≤ tau ≤ dt [s].

        Raises:
            ValueError: tau lies outside the interval.
        """
        if not 0 <= tau <= self.dt:
            raise ValueError(f"tau must lie in [0, {self.dt}], got {tau}")
        m = len(self.Qc)
        # Λ and Ψ do not depend on Qc, only on time: the kron with the identity keeps them exact.
        Psi_t = (
            white_noise(tau) @ transition(self.dt - tau, 1).T @ np.linalg.inv(white_noise(self.dt))
        )
        Lambda_t = transition(tau, 1) - Psi_t @ transition(self.dt, 1)
        return kron(Lambda_t, np.eye(m)), kron(Psi_t, np.eye(m))


@lru_cache(maxsize=256)
def isotropic_prior(dt: float, q: float, m: int) -> GPPrior:
    """The WNOA prior of m independent coordinates of one power spectral density q [m²/s³], kept:
    a planner asks for the same one many times a second."""
    return GPPrior(dt, q * np.eye(m))


def matern_prior(mean: Array, dt: float, sigma: float, length: float) -> Linear:
    r"""Matérn-3/2 process around a mean trajectory, between consecutive states.

    d = x − mean,  d_{k+1} − A d_k ~ N(0, S − A S Aᵀ),  S = diag(sigma², 3 sigma²/length²): the
    deviation is stationary with covariance sigma² (1 + √3|t|/length) exp(−√3|t|/length), so sigma
    is the width of the corridor around the mean at every time. `matern_first` starts the chain.

    Args:
        mean: Rows of the mean trajectory, shape (S + 1, 2m): positions [m], velocities [m/s].
        dt: Time between two states [s].
        sigma: Standard deviation of the deviation in position [m].
        length: Its correlation time [s].

    Raises:
        ValueError: dt, sigma or length is not positive.

    Reference:
        Hartikainen and Särkkä, MLSP 2010, on Matérn covariances as state-space models.
    """
    positive(dt=dt, sigma=sigma, length=length)
    m = mean.shape[-1] // 2
    A_t, Q_t = matern_step(dt, sigma, length)
    W = kron(whitener(Q_t), np.eye(m))
    A = kron(A_t, np.eye(m))
    b = (mean[1:] - mean[:-1] @ A.T) @ W.T
    return Linear((-W @ A, W), b, log_gaussian_normalizer(W))


def matern_step(dt: float, sigma: float, length: float) -> tuple[Array, Array]:
    """A(dt) and S − A S Aᵀ of a `matern_prior`'s deviation in one dimension, each (2, 2)."""
    rate = np.sqrt(3) / length
    A = np.exp(-rate * dt) * np.array([[1 + rate * dt, dt], [-(rate**2) * dt, 1 - rate * dt]])
    return A, _matern_noise(rate * dt, rate, sigma)


def matern_first(mean: Array, sigma: float, length: float) -> Linear:
    """The stationary prior of the first state of a `matern_prior`; `mean` has shape (2m,)."""
    m = mean.shape[-1] // 2
    scale = np.repeat([sigma, np.sqrt(3) / length * sigma], m)
    return gaussian(mean, np.diag(scale**2))


def gaussian(mean: Array, covariance: Array) -> Linear:
    """N(mean, covariance) of one variable; `mean` has shape (d,), or (S, d) where it differs by
    step."""
    return whitened(mean, whitener(covariance))


def whitened(mean: Array, W: Array) -> Linear:
    """N(mean, (WᵀW)⁻¹) of one variable, W a `whitener` up to an order of the coordinates."""
    return Linear((W,), np.asarray(mean, dtype=float) @ W.T, log_gaussian_normalizer(W))


def transition(dt: float, m: int) -> Array:
    """Phi(dt) = [[I, dt I], [0, I]] of m positions and m velocities."""
    return kron(np.array([[1.0, dt], [0.0, 1.0]]), np.eye(m))


def kron(a: Array, b: Array) -> Array:
    """Kronecker product: blocks of time × space."""
    return np.asarray(np.kron(a, b), dtype=float)


def white_noise(dt: float) -> Array:
    """Q(dt) over Qc of white noise on acceleration, shape (2, 2): position, velocity."""
    return np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])


def _matern_noise(a: float, rate: float, sigma: float) -> Array:
    """S − A S Aᵀ of a Matérn-3/2 process over a = rate·dt, without the cancellation that leaves
    nothing of it for a long correlation time."""
    decay = np.exp(-2 * a)
    # 1 − exp(−2a)(1 + 2a + 2a²), for small a by the rest of the series of exp(2a).
    rest = np.cumprod(2 * a / np.arange(1, 24))[2:].sum()
    pp = decay * rest if a < 1 else 1 - decay * (1 + 2 * a + 2 * a**2)
    pv = 2 * a**2 * decay * rate
    vv = (2 * a * (1 - a) * decay - np.expm1(-2 * a)) * rate**2
    return np.asarray(sigma**2 * np.array([[pp, pv], [pv, vv]]), dtype=float)
