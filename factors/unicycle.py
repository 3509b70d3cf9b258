r"""Motion that cannot slide sideways: states (x, y, θ, v, ω) instead of (x, y, vx, vy).

Between two states speed and turn rate change linearly (constant accelerations), so

    v(t) = v + (v' − v) t/dt,  θ(t) = θ + ω t + (ω' − ω) t²/(2 dt),  ṗ = v(t) (cos θ(t), sin θ(t)).

The density of the next state is that of white accelerations (`unicycle_prior`, linear) and of a
tiny defect of the position (`UnicycleMotion`), which keeps it a density and the solver smooth.
θ is a number, not an angle: it is never wrapped, and turning all the way round is 2π further.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from factors.residual import Array, Expansion, Linear, Residual, positive

DIM = 5
"""Size of a state (x, y, θ, v, ω)."""
NODES = 3
"""Gauss–Legendre nodes a step. The integral misses an arc of angle φ and radius r by about
r (φ/6.5)^7: 1e-8 m at 0.6 rad a step and 1 m."""
_LOCAL = np.array([2, 3, 4, 7, 8])
"""(θ, v, ω, v', ω') in the support of `UnicycleMotion`."""


def unicycle_prior(dt: float, Qc: float, Qc_yaw: float, sigma_heading: float) -> Linear:
    r"""White noise on both accelerations, between consecutive states.

    v' − v ~ N(0, Qc dt),  ω' − ω ~ N(0, Qc_yaw dt),  θ' − θ − (ω + ω') dt/2 ~ N(0, sigma_heading²).

    Args:
        dt: Time between the two states [s].
        Qc: Power spectral density of the acceleration along the heading [m²/s³].
        Qc_yaw: Power spectral density of the yaw acceleration [rad²/s³].
        sigma_heading: Defect of the heading [rad].

    Raises:
        ValueError: a parameter is not positive.
    """
    positive(dt=dt, Qc=Qc, Qc_yaw=Qc_yaw, sigma_heading=sigma_heading)
    scale = 1 / np.array([sigma_heading, np.sqrt(Qc * dt), np.sqrt(Qc_yaw * dt)])
    before, after = np.zeros((3, DIM)), np.zeros((3, DIM))
    before[:, 2:], after[:, 2:] = -np.eye(3), np.eye(3)
    before[0, 4] = after[0, 4] = -dt / 2
    log_normalizer = float(np.log(scale).sum() - 1.5 * np.log(2 * np.pi))
    return Linear((scale[:, None] * before, scale[:, None] * after), np.zeros(3), log_normalizer)


@dataclass(frozen=True, eq=False)
class UnicycleMotion(Residual):
    r"""e = (p' − p − ∫ v(t) (cos θ(t), sin θ(t)) dt)/sigma between consecutive states.

    Along a constant twist the integral is the arc of the exponential map, so the error is zero
    where that of GTSAM's `WnoaMotionFactorPose2` is.

    Args:
        dt: Time between the two states [s].
        sigma: Defect of the position a step, in any direction [m].

    Raises:
        ValueError: dt or sigma is not positive.
    """

    dt: float
    sigma: float

    def __post_init__(self) -> None:
        positive(dt=self.dt, sigma=self.sigma)

    @property
    def dims(self) -> tuple[int, ...]:
        return (DIM, DIM)

    @property
    def rows(self) -> int:
        return 2

    @property
    def log_normalizer(self) -> float:  # type: ignore[override]  # depends on sigma
        """Of a Gaussian of two dimensions and standard deviation sigma."""
        return float(-2 * np.log(self.sigma) - np.log(2 * np.pi))

    @cached_property
    def support(self) -> NDArray[np.intp]:
        """All but the second heading: it follows from the prior."""
        return np.array([0, 1, 2, 3, 4, 5, 6, 8, 9])

    @cached_property
    def _nodes(self) -> tuple[Array, Array, Array]:
        """See `_quadrature`."""
        return _quadrature(self.dt)

    @cached_property
    def _outer(self) -> tuple[Array, Array]:
        """a bᵀ + b aᵀ and b bᵀ of each node, flattened: (n, 25)."""
        _, a, b = self._nodes
        ab = a[:, :, None] * b[:, None, :]
        bb = b[:, :, None] * b[:, None, :]
        return (ab + np.swapaxes(ab, 1, 2)).reshape(-1, 25), bb.reshape(-1, 25)

    def error(self, *x: Array) -> Array:
        speed, cos, sin = self._at_nodes(*x)
        return self._defect(x, speed, cos, sin)

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        speed, cos, sin = self._at_nodes(*x)
        e = self._defect(x, speed, cos, sin)
        J = np.zeros((*e.shape, 2 * DIM))
        J[..., self.support] = self._slope(speed, cos, sin)
        return e, (J[..., :DIM], J[..., DIM:])

    def expand(self, *x: Array) -> Expansion:
        speed, cos, sin = self._at_nodes(*x)
        e, J = self._defect(x, speed, cos, sin), self._slope(speed, cos, sin)
        Jt = np.swapaxes(J, -1, -2)
        hessian = Jt @ J
        w, _, _ = self._nodes
        ab, bb = self._outer
        along = e[..., :1] * cos + e[..., 1:] * sin
        across = e[..., 1:] * cos - e[..., :1] * sin
        curve = (w * speed * along) @ bb - (w * across) @ ab
        hessian[..., _LOCAL[:, None], _LOCAL] += curve.reshape(*curve.shape[:-1], 5, 5) / self.sigma
        energy = 0.5 * np.einsum("...i,...i->...", e, e)
        return Expansion(energy, (Jt @ e[..., None])[..., 0], hessian)

    def moved(self, *x: Array) -> Array:
        """How far the speeds and turn rates carry the robot, shape (..., 2) [m]."""
        speed, cos, sin = self._at_nodes(*x)
        w, _, _ = self._nodes
        return np.stack([(speed * cos) @ w, (speed * sin) @ w], axis=-1)

    def moved_slope(self, *x: Array) -> Array:
        """Jacobian of `moved` in (θ, v, ω, v', ω'), shape (..., 2, 5)."""
        return np.asarray(-self.sigma * self._slope(*self._at_nodes(*x))[..., _LOCAL])

    def _at_nodes(self, before: Array, after: Array) -> tuple[Array, Array, Array]:
        """Speed, cosine and sine of the heading at the nodes, each (..., n)."""
        local = np.concatenate([before[..., 2:], after[..., 3:]], axis=-1)
        _, a, b = self._nodes
        heading = local @ b.T
        return local @ a.T, np.cos(heading), np.sin(heading)

    def _defect(self, x: tuple[Array, ...], speed: Array, cos: Array, sin: Array) -> Array:
        w, _, _ = self._nodes
        moved = np.stack([(speed * cos) @ w, (speed * sin) @ w], axis=-1)
        return np.asarray((x[1][..., :2] - x[0][..., :2] - moved) / self.sigma)

    def _slope(self, speed: Array, cos: Array, sin: Array) -> Array:
        """Jacobian in the support, shape (..., 2, 9)."""
        w, a, b = self._nodes
        J = np.zeros((*speed.shape[:-1], 2, 9))
        J[..., [0, 1], [0, 1]] = -1
        J[..., [0, 1], [5, 6]] = 1
        J[..., 0, _LOCAL] = (w * speed * sin) @ b - (w * cos) @ a
        J[..., 1, _LOCAL] = -(w * speed * cos) @ b - (w * sin) @ a
        return J / self.sigma


@dataclass(frozen=True, eq=False)
class InPlane(Residual):
    r"""A residual on states (x, y, vx, vy), applied to states (x, y, θ, v, ω).

    With (vx, vy) = v (cos θ, sin θ), by the chain rule, curvature included.

    Args:
        residual: All its variables have size 4.

    Raises:
        ValueError: a variable has another size.
    """

    residual: Residual

    def __post_init__(self) -> None:
        if any(dim != 4 for dim in self.residual.dims):
            raise ValueError(f"a planar state has size 4, got variables of {self.residual.dims}")

    @property
    def dims(self) -> tuple[int, ...]:
        return (DIM,) * len(self.residual.dims)

    @property
    def rows(self) -> int:
        return self.residual.rows

    @property
    def log_normalizer(self) -> float:  # type: ignore[override]  # that of the residual
        """That of the residual."""
        return self.residual.log_normalizer

    @cached_property
    def support(self) -> NDArray[np.intp]:
        """All components but the turn rates."""
        return np.concatenate([DIM * i + np.arange(4) for i in range(len(self.dims))])

    def at(self, step: int) -> InPlane:
        return InPlane(self.residual.at(step))

    def error(self, *x: Array) -> Array:
        return self.residual.error(*(planar(xi) for xi in x))

    def energy(self, *x: Array) -> Array:
        return self.residual.energy(*(planar(xi) for xi in x))

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        e, blocks = self.residual.linearize(*(planar(xi) for xi in x))
        J = []
        for xi, block in zip(x, blocks, strict=True):
            full = np.zeros((*block.shape[:-1], DIM))
            full[..., :4] = block @ _planar_slope(xi)
            J.append(full)
        return e, tuple(J)

    def gauss_newton(self, *x: Array) -> Expansion:
        return self._pull(x, self.residual.gauss_newton(*(planar(xi) for xi in x)))[0]

    def expand(self, *x: Array) -> Expansion:
        inner = self.residual.expand(*(planar(xi) for xi in x))
        (energy, gradient, hessian), slope = self._pull(x, inner)
        for i, xi in enumerate(x):
            gx, gy = slope[..., 4 * i + 2], slope[..., 4 * i + 3]
            v, cos, sin = xi[..., 3], np.cos(xi[..., 2]), np.sin(xi[..., 2])
            j = 4 * i + 2  # θ, then v, in the support
            hessian[..., j, j] -= v * (gx * cos + gy * sin)
            hessian[..., j, j + 1] += gy * cos - gx * sin
            hessian[..., j + 1, j] += gy * cos - gx * sin
        return Expansion(energy, gradient, hessian)

    def _pull(self, x: tuple[Array, ...], inner: Expansion) -> tuple[Expansion, Array]:
        """The expansion in states (x, y, θ, v), without the curvature of the map to the plane,
        and the gradient in states (x, y, vx, vy)."""
        m, batch = len(x), inner.energy.shape
        place = self.residual.support
        slope, H = np.zeros((*batch, 4 * m)), np.zeros((*batch, 4 * m, 4 * m))
        slope[..., place] = inner.gradient
        H[..., place[:, None], place] = inner.hessian
        G = np.zeros_like(H)
        for i, xi in enumerate(x):
            G[..., 4 * i : 4 * i + 4, 4 * i : 4 * i + 4] = _planar_slope(xi)
        Gt = np.swapaxes(G, -1, -2)
        gradient = (Gt @ slope[..., None])[..., 0]
        return Expansion(inner.energy, gradient, Gt @ H @ G), slope


def planar(x: Array) -> Array:
    """States (x, y, vx, vy), shape (..., 4), of states (x, y, θ, v, ω)."""
    theta, v = x[..., 2], x[..., 3]
    moving = np.stack([v * np.cos(theta), v * np.sin(theta)], axis=-1)
    return np.concatenate([x[..., :2], moving], axis=-1)


def advance(x: Array, change: Array, dt: Array | float) -> Array:
    """The next state after constant accelerations: no defect at all, up to the quadrature.

    Args:
        x: Shape (..., 5).
        change: (v' − v, ω' − ω), shape (..., 2) [m/s, rad/s].
        dt: A number, or one per state (...) [s].
    """
    s, share = _gauss()
    dt = np.asarray(dt, dtype=float)[..., None]
    v, omega = x[..., 3:4], x[..., 4:5]
    dv, domega = change[..., :1], change[..., 1:]
    speed = dt * share * (v + s * dv)
    heading = x[..., 2:3] + dt * (s * omega + 0.5 * s**2 * domega)
    east = np.einsum("...i,...i->...", speed, np.cos(heading))
    north = np.einsum("...i,...i->...", speed, np.sin(heading))
    theta = (x[..., 2:3] + dt * (omega + 0.5 * domega))[..., 0]
    moved = np.stack([x[..., 0] + east, x[..., 1] + north, theta], axis=-1)
    return np.concatenate([moved, x[..., 3:] + change], axis=-1)


def slip(x: Array, dt: Array | float) -> Array:
    """How far each step (S − 1,) of states (S, 5) ends beside where its motion leads [m]."""
    ahead = advance(x[:-1], np.diff(x[:, 3:], axis=0), dt)
    return np.asarray(np.linalg.norm(x[1:, :2] - ahead[:, :2], axis=-1))


@cache
def _gauss() -> tuple[Array, Array]:
    """Nodes and weights (n,) of an integral from 0 to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    return (nodes + 1) / 2, weights / 2


def _quadrature(dt: float) -> tuple[Array, Array, Array]:
    """Weights (n,) [s], and rows (n, 5) that give v and θ at the nodes from (θ, v, ω, v', ω')."""
    s, share = _gauss()
    zero, one = np.zeros(NODES), np.ones(NODES)
    speed = np.stack([zero, 1 - s, zero, s, zero], axis=-1)
    heading = np.stack([one, zero, dt * (s - s**2 / 2), zero, dt * s**2 / 2], axis=-1)
    return dt * share, speed, heading


def _planar_slope(x: Array) -> Array:
    """∂(x, y, vx, vy)/∂(x, y, θ, v), shape (..., 4, 4)."""
    theta, v = x[..., 2], x[..., 3]
    cos, sin = np.cos(theta), np.sin(theta)
    G = np.zeros((*x.shape[:-1], 4, 4))
    G[..., 0, 0] = G[..., 1, 1] = 1
    G[..., 2, 2], G[..., 2, 3] = -v * sin, cos
    G[..., 3, 2], G[..., 3, 3] = v * cos, sin
    return G
