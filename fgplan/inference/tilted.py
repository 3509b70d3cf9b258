"""Moments of a Gaussian under one limit: what expectation propagation asks of each."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

Array = NDArray[np.float64]

ANGLES, INSIDE, BEYOND = 12, 10, 6
"""Gauss–Legendre nodes of a limit on a length: half of the angle, radius within and beyond it."""
ABOVE = 16
"""Nodes of a number above the place where its hinge begins."""
WIDE = 6.0
"""Standard deviations integrated over."""


class Tilted(NamedTuple):
    """log Z, mean (n, m) and covariance (n, m, m) of t_i(u) N(u; cavity), by site."""

    log_z: Array
    mean: Array
    covariance: Array


def tilted_number(
    excess: Array, variance: Array, scale: float, room: float | Array = np.inf
) -> Tilted:
    """Of exp(−½ (scale · max(0, e))²) [e ≤ room] under e ~ N(excess, variance), all (n,): two
    pieces of Gaussians, the second by quadrature."""
    sd = np.sqrt(variance)
    shrink = 1 + scale**2 * variance
    inner, outer = excess / shrink, sd / np.sqrt(shrink)
    # The second piece is about N(inner, outer²) on [0, room]: where it is.
    room = np.broadcast_to(room, excess.shape)
    last = np.minimum(room, np.maximum(inner, 0.0) + WIDE * outer)
    steep = np.maximum(np.maximum(inner - room, -inner), 1e-300)  # from the nearer end
    reach = np.minimum(2 * WIDE * outer, 4 * WIDE * outer**2 / steep)
    first = np.maximum(0.0, last - np.where(inner > 0, reach, np.inf))
    last = np.where(inner > 0, last, np.minimum(last, reach))
    e, e_w = _nodes(ABOVE, first, last)
    log_p = np.log(e_w) - 0.5 * (scale * e) ** 2 - 0.5 * ((e - excess[:, None]) / sd[:, None]) ** 2
    log_p -= 0.5 * np.log(2 * np.pi) + np.log(sd)[:, None]
    log_above = np.logaddexp.reduce(log_p, axis=1)
    p = np.exp(log_p - log_above[:, None])
    above = (p * e).sum(axis=1)
    wide = (p * (e - above[:, None]) ** 2).sum(axis=1)
    cut, narrow = _cut(-excess / sd)
    log_w = np.stack([log_ndtr(-excess / sd), log_above])
    means, variances = np.stack([excess - sd * cut, above]), np.stack([variance * narrow, wide])
    log_z = np.logaddexp(*log_w)
    w = np.exp(log_w - log_z)
    mean = (w * means).sum(axis=0)
    spread = (w * (variances + (means - mean) ** 2)).sum(axis=0)
    return Tilted(log_z, mean[:, None], spread[:, None, None])


def _cut(alpha: Array) -> tuple[Array, Array]:
    """Of z ~ N(0, 1) given z < α: −mean, and variance."""
    ratio = np.exp(-0.5 * alpha**2 - 0.5 * np.log(2 * np.pi) - log_ndtr(alpha))
    return ratio, np.maximum(1 - alpha * ratio - ratio**2, 1e-12)


def tilted_length(
    mean: Array, covariance: Array, limit: float, scale: float, room: float = np.inf
) -> Tilted:
    """Of exp(−½ (scale · max(0, ‖s‖ − limit))²) [‖s‖ ≤ limit + room] under s ~ N(mean, covariance)
    in the plane, by quadrature in angle and radius where the Gaussian is."""
    centre = np.linalg.norm(mean, axis=1)
    sd = np.sqrt(np.linalg.eigvalsh(covariance)[:, -1])
    reach = WIDE * sd
    low = np.minimum(np.maximum(centre - reach, 0.0), limit)
    middle = np.minimum(centre + reach, limit)
    # Beyond the limit it is about a Gaussian in the radius, between the limit and the centre.
    narrow = 1 / np.sqrt(1 / sd**2 + scale**2)
    peak = narrow**2 * (centre / sd**2 + scale**2 * limit)
    end = limit + room
    first = np.maximum(limit, np.minimum(peak, end) - WIDE * narrow)
    last = np.minimum(np.maximum(limit, peak + WIDE * narrow), end)
    half = np.where(
        centre > reach, np.arcsin(np.minimum(reach / np.maximum(centre, 1e-12), 1)), np.pi
    )
    toward = np.arctan2(mean[:, 1], mean[:, 0])
    phi, phi_w = _nodes(ANGLES, toward - half, toward), _nodes(ANGLES, toward, toward + half)
    inside, beyond = _nodes(INSIDE, low, middle), _nodes(BEYOND, first, last)
    angle, angle_w = (np.concatenate(pair, axis=1) for pair in zip(phi, phi_w, strict=True))
    radius, radius_w = (np.concatenate(pair, axis=1) for pair in zip(inside, beyond, strict=True))
    x = radius[:, None] * np.cos(angle)[:, :, None] - mean[:, 0, None, None]
    y = radius[:, None] * np.sin(angle)[:, :, None] - mean[:, 1, None, None]
    H = np.linalg.inv(covariance)[..., None, None]
    log_p = (-0.5 * H[:, 0, 0] * x - H[:, 0, 1] * y) * x - 0.5 * H[:, 1, 1] * y**2
    log_p -= 0.5 * (scale * np.maximum(radius - limit, 0.0))[:, None] ** 2
    top = log_p.max(axis=(1, 2))
    log_p -= top[:, None, None]
    weight = np.exp(log_p) * (radius * radius_w)[:, None] * angle_w[:, :, None]
    total = weight.sum(axis=(1, 2))
    weight /= total[:, None, None]
    shift = np.stack([(weight * x).sum(axis=(1, 2)), (weight * y).sum(axis=(1, 2))], axis=-1)
    xx, xy, yy = ((weight * v).sum(axis=(1, 2)) for v in (x * x, x * y, y * y))
    square = np.stack([xx, xy, xy, yy], axis=-1).reshape(-1, 2, 2)
    spread = square - shift[:, :, None] * shift[:, None, :]
    log_z = top + np.log(total) - np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(covariance)[1]
    return Tilted(log_z, mean + shift, spread)


def _nodes(count: int, low: Array, high: Array) -> tuple[Array, Array]:
    """Gauss–Legendre nodes and weights between limits (n,), shape (n, count)."""
    x, w = _legendre(count)
    half = 0.5 * (high - low)[:, None]
    return low[:, None] + half * (x + 1), half * w


@cache
def _legendre(count: int) -> tuple[Array, Array]:
    return np.polynomial.legendre.leggauss(count)
