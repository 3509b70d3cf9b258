"""Covariance functions over time, for Gaussian priors that are stated by their kernel.

A kernel matrix K (S, S) over times becomes the covariance of a trajectory (S, d), flattened step
by step, as `np.kron(K, spatial)` with `spatial` (d, d); kernels add and multiply elementwise.
"""

from __future__ import annotations

import numpy as np

from factors.residual import Array, positive


def matern(times: Array, sigma: float, length: float, nu: float = 1.5) -> Array:
    r"""Matérn covariance k(t, t') = sigma² f(r/length), r = |t − t'|.

    nu = 1/2: f = exp(−s); 3/2: (1 + a) exp(−a), a = √3 s; 5/2: (1 + a + a²/3) exp(−a), a = √5 s.

    Args:
        times: Shape (S,) [s].
        sigma: Standard deviation, in the unit of the trajectory.
        length: Correlation time [s].
        nu: Smoothness: 0.5, 1.5 or 2.5.

    Returns:
        Shape (S, S).

    Raises:
        ValueError: sigma or length is not positive, or nu is none of the three.

    Reference:
        Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, eq. 4.17.
    """
    positive(sigma=sigma, length=length)
    polynomials = {0.5: (1.0,), 1.5: (1.0, 1.0), 2.5: (1.0, 1.0, 1 / 3)}
    if nu not in polynomials:
        raise ValueError(f"nu must be one of {list(polynomials)}, got {nu}")
    times = np.asarray(times, dtype=float)
    a = np.sqrt(2 * nu) / length * np.abs(times[:, None] - times[None, :])
    shape = np.polynomial.polynomial.polyval(a, polynomials[nu])
    return np.asarray(sigma**2 * shape * np.exp(-a))


def linear_kernel(times: Array, sigma: float, slope: float, center: float = 0.0) -> Array:
    r"""Covariance of a straight line c + v (t − center), c ~ N(0, sigma²), v ~ N(0, slope²).

    Its rank is 2: add a Matérn kernel or noise to make it a density.

    Args:
        times: Shape (S,) [s].
        sigma: Standard deviation of the line at `center`, in the unit of the trajectory.
        slope: Standard deviation of its slope [the same unit per second].
        center: [s].

    Returns:
        Shape (S, S).

    Raises:
        ValueError: sigma or slope is not positive.

    Reference:
        Rasmussen and Williams, 2006, section 4.2.2; Trautman and Krause, IROS 2010, use it with
        a Matérn kernel for pedestrians.
    """
    positive(sigma=sigma, slope=slope)
    t = np.asarray(times, dtype=float) - center
    return np.asarray(sigma**2 + slope**2 * np.outer(t, t))
