r"""What one-sided limits cut off of a Gaussian, by expectation propagation.

At an optimum that keeps a limit, the Hessian does not see it, although much of the Gaussian around
lies beyond. Here everything but the robot's limits is the quadratic at the optimum, and each limit
t_i(A_i x) stays what it is: a hinge on one number (a box, a cone) or on the length of two (speed,
acceleration). It is replaced by a Gaussian factor t̃_i that gives the same moments,

    Z_i, mean, covariance of  t_i(u) N(u; cavity),   cavity = all other factors,

for all i at once until nothing changes. The product of all is a Gaussian with the density's own
moments instead of the optimum's curvature, and its mass is

    log Z = log Z_0 + Σ_i [log Z_i − log ∫ t̃_i N(u; cavity)]  with Z_0 that of the product.

Reference:
    Minka, UAI 2001; Cunningham, Hennig, Lacoste-Julien, arXiv 1111.6832 (2011), on how good it is
    for Gaussians cut off by halfspaces.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from factors.hinge import hinge_scale
from factors.kinematics import (
    AT_REST,
    AccelerationLimit,
    CurvatureLimit,
    LinearLimit,
    SpeedLimit,
)
from factors.residual import Residual
from fgplan.assembly import Assembly
from fgplan.block_tridiagonal import System, factorize
from fgplan.inference.gaussian import Gaussian
from fgplan.inference.tilted import Tilted, tilted_length, tilted_number
from fgplan.robots import LIMIT_SHARE

Array = NDArray[np.float64]

SWEEPS = 40
SETTLED = 1e-3
"""Change of log Z in a sweep at which it ends [nats]."""
DAMPING = 0.7
"""Share of a new site factor that is taken on: all change at once."""


@dataclass(frozen=True, eq=False)
class Sites:
    """Limits of one kind, n of them, on u = A_i (x − x*), m numbers each.

    Args:
        A: On the robot's states, shape (n, m, S, R), zero where a state is held.
        at: A_i x* of a length, A_i x* − limit of a number, shape (n, m).
        limit: Of a length; not used for a number.
        scale: 1/σ of the hinge.
        room: From where the hinge begins to what is never exceeded: one for a length, shape (n,)
            for numbers; inf where there is no such bound.
    """

    A: Array
    at: Array
    limit: float
    scale: float
    room: float | Array

    def tilted(self, mean: Array, covariance: Array) -> Tilted:
        """Moments of the limits under cavities of u: means (n, m), covariances (n, m, m)."""
        s = self.at + mean
        if self.A.shape[1] == 1:
            found = tilted_number(s[:, 0], covariance[:, 0, 0], self.scale, self.room)
        else:
            found = tilted_length(s, covariance, self.limit, self.scale, float(self.room))
        return found._replace(mean=found.mean - self.at)


def moderated(
    assembly: Assembly, state: Array, which: int, bounded: bool = False
) -> tuple[Gaussian, float] | None:
    """The Gaussian around a local optimum with the limits propagated, and the log of the mass of
    the unnormalised density; None where the rest of the density has no minimum there.

    Args:
        assembly: The density.
        state: A local optimum, shape (S, D).
        which: Its hypothesis.
        bounded: Whether the density is 0 beyond the limits themselves (`Posterior.bounded`), of
            which the hinges begin at a share of `LIMIT_SHARE`.
    """
    index = np.array([which])
    q = assembly.expand(state[None], index)
    _, system = next(q.systems(np.zeros(1, dtype=np.intp)))
    diagonal, upper = system.diagonal.copy(), system.upper.copy()
    slope, energy = q.gradient[0].copy(), float(q.energy[0])
    sites = []
    for wired, term in assembly.wired(which):
        if not term.robots_own:
            continue
        found = list(_sites(assembly, term.residual, term.steps.start, state, bounded))
        if not found:
            continue
        part = wired.residual.expand(*wired.variables(state))
        energy -= float(part.energy.sum())
        wired.add_gradient(-part.gradient, slope)
        wired.add_hessian(-part.hessian, diagonal, upper)
        sites += found
    slope *= assembly.free
    assembly.hold_fixed(diagonal[None], upper[None])
    rest = system._replace(diagonal=diagonal, upper=upper)
    if factorize(*rest) is None:
        return None
    try:
        ended = _propagate(assembly, state, rest, slope, sites)
    except np.linalg.LinAlgError:  # what is left of a Gaussian far beyond its limits has no width
        return None
    return None if ended is None or not np.isfinite(ended[1]) else (ended[0], ended[1] - energy)


def _propagate(
    assembly: Assembly, state: Array, rest: System, slope: Array, sites: Sequence[Sites]
) -> tuple[Gaussian, float] | None:
    """Expectation propagation over all sites; the log mass relative to the energy at the state."""
    precisions = [np.zeros((len(s.A), s.A.shape[1], s.A.shape[1])) for s in sites]
    shifts = [np.zeros(s.at.shape) for s in sites]
    log_z, robot = -np.inf, assembly.models[0].columns["robot"]
    for sweep in range(SWEEPS):
        system, shift = _product(rest, robot, -slope, sites, precisions, shifts)
        factor = factorize(*system)
        if factor is None:
            return None
        mean = factor.solve(shift)
        gaussian = Gaussian(state + mean, system, factor, assembly.free, assembly.shear(state))
        before, log_z = log_z, gaussian.log_volume + 0.5 * float(np.vdot(shift, mean))
        for i, s in enumerate(sites):
            rows = np.zeros((len(s.A) * s.A.shape[1], *state.shape))
            rows[..., robot] = s.A.reshape(-1, *s.A.shape[2:])
            root = factor.forward(rows).reshape(*s.A.shape[:2], -1)
            inverse = _inverse(root @ np.swapaxes(root, 1, 2))
            own = np.einsum("nmsd,sd->nm", s.A, mean[:, robot])
            cavity = inverse - precisions[i]
            push = _times(inverse, own) - shifts[i]
            widths = _inverse(cavity)
            tilted = s.tilted(_times(widths, push), widths)
            log_z += float(np.sum(tilted.log_z - _overlap(cavity, push, precisions[i], shifts[i])))
            narrow = _inverse(tilted.covariance)
            share = 1.0 if sweep == 0 else DAMPING
            precisions[i] = precisions[i] + share * (narrow - cavity - precisions[i])
            shifts[i] = shifts[i] + share * (_times(narrow, tilted.mean) - push - shifts[i])
        if abs(log_z - before) < SETTLED:
            break
    return gaussian, log_z


def _product(
    rest: System,
    robot: slice,
    shift: Array,
    sites: Sequence[Sites],
    precisions: Sequence[Array],
    shifts: Sequence[Array],
) -> tuple[System, Array]:
    """Precision and shift of the quadratic and all site factors."""
    diagonal, upper, total = rest.diagonal.copy(), rest.upper.copy(), shift.copy()
    for s, precision, push in zip(sites, precisions, shifts, strict=True):
        total[:, robot] += np.einsum("nmsd,nm->sd", s.A, push)
        weighted = np.einsum("nab,nbsd->nasd", precision, s.A)
        diagonal[:, robot, robot] += _stacked(s.A, weighted)
        upper[:, robot, robot] += _stacked(s.A[:, :, :-1], weighted[:, :, 1:])
    return rest._replace(diagonal=diagonal, upper=upper), total


def _stacked(A: Array, B: Array) -> Array:
    """Σ_na A_na B_naᵀ at each step, of (n, m, S, R), shape (S, R, R)."""
    count = A.shape[0] * A.shape[1]
    left = np.moveaxis(A.reshape(count, *A.shape[2:]), 0, -1)
    return np.asarray(left @ np.swapaxes(B.reshape(count, *B.shape[2:]), 0, 1))


def _overlap(cavity: Array, push: Array, precision: Array, shift: Array) -> Array:
    """log ∫ N(u; cavity) exp(shift·u − ½ uᵀ precision u) du, shape (n,)."""
    both, total = cavity + precision, push + shift
    return np.asarray(
        0.5 * (np.linalg.slogdet(cavity)[1] - np.linalg.slogdet(both)[1])
        + 0.5 * np.einsum("na,na->n", total, np.linalg.solve(both, total[..., None])[..., 0])
        - 0.5 * np.einsum("na,na->n", push, np.linalg.solve(cavity, push[..., None])[..., 0])
    )


def _sites(
    assembly: Assembly, residual: Residual, first: int, state: Array, bounded: bool
) -> Iterator[Sites]:
    """The limits of a residual at all its steps from `first` on; none where it is no limit that
    can be propagated."""
    columns = assembly.models[0].columns["robot"]
    robot, free = state[:, columns], assembly.free[:, columns]
    rows = _rows(residual, robot)
    if rows is None:
        return
    matrices, limit, scale, length = rows
    n, m = len(robot) - first - len(matrices) + 1, len(matrices[0])
    A, at, steps = np.zeros((n, m, *robot.shape)), np.zeros((n, m)), first + np.arange(n)
    for offset, matrix in enumerate(matrices):
        A[np.arange(n), :, steps + offset] = matrix
        at += robot[steps + offset] @ matrix.T
    A *= free
    room = (1 / LIMIT_SHARE - 1) * limit if bounded and limit.any() else np.full(m, np.inf)
    if not length:  # each row is a limit of its own
        A, at = A.reshape(n * m, 1, *robot.shape), (at - limit).reshape(n * m, 1)
    moving = np.any(A != 0, axis=(1, 2, 3))
    left = float(room[0]) if length else np.tile(room, n)[moving]
    yield Sites(A[moving], at[moving], float(np.max(limit)), scale, left)


class _Rows(NamedTuple):
    """Matrices (m, R) on neighbouring states of the robot, their limits (m,), 1/σ, and whether the
    limit is on their length together."""

    matrices: Sequence[Array]
    limit: Array
    scale: float
    length: bool


def _rows(residual: Residual, robot: Array) -> _Rows | None:
    """What a limit of the robot is on; None where it is no limit that can be propagated."""
    if isinstance(residual, LinearLimit):
        scale = hinge_scale(residual.sigma, residual.weight)
        return _Rows(residual.A, residual.b, scale, False)
    if isinstance(residual, SpeedLimit | AccelerationLimit) and residual.dim <= 4:
        scale, limit = hinge_scale(residual.sigma, residual.weight), residual.limit
        velocity = np.eye(residual.dim)[residual.dim // 2 :]
        if residual.dim == 2:  # the length of one number: a limit on either side
            velocity = np.concatenate([velocity, -velocity])
        on: tuple[Array, ...] = (velocity,)
        if isinstance(residual, AccelerationLimit):
            on, limit, scale = (-velocity, velocity), limit * residual.dt, scale / residual.dt
        return _Rows(on, np.full(len(velocity), limit), scale, residual.dim == 4)
    if isinstance(residual, CurvatureLimit) and np.all(robot[:, 3] >= -AT_REST):
        # While it drives forward the cone radius·|ω| ≤ |v| is two halfspaces.
        scale = hinge_scale(residual.sigma, residual.weight)
        cone = np.array([[0, 0, 0, -1, residual.radius], [0, 0, 0, -1, -residual.radius]])
        return _Rows((cone,), np.zeros(2), scale, False)
    return None


def _inverse(M: Array) -> Array:
    return np.asarray(np.linalg.inv(M), dtype=np.float64)


def _times(M: Array, v: Array) -> Array:
    return np.asarray(np.einsum("nab,nb->na", M, v))
