"""Gaussians and Student t over whole trajectories, by the Cholesky factor of their precision.

The precision of a Markov prior is block-tridiagonal, so a draw costs one triangular solve, and
fixed states (known without error) never move.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from fgplan.assembly import Assembly, Quadratic, hold
from fgplan.block_tridiagonal import Factor, System, factorize
from fgplan.shear import Shear

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Generator = np.random.Generator


@dataclass(frozen=True, eq=False)
class Gaussian:
    r"""N(mean, H⁻¹) over the free coordinates of a trajectory.

    Args:
        mean: Shape (S, D).
        system: H, with unit curvature where a state is held.
        factor: Its Cholesky factor L Lᵀ.
        free: Which coordinates are random, shape (S, D).
        shear: Of a robot with wheels: the Gaussian is one in its coordinates y, and so are `mean`
            and `covariance`; draws and densities are those of states.
    """

    mean: Array
    system: System
    factor: Factor
    free: NDArray[np.bool_]
    shear: Shear | None = None

    @property
    def dimension(self) -> int:
        """Number of random coordinates."""
        return int(self.free.sum())

    @cached_property
    def log_volume(self) -> float:
        """log ∫ exp(−½ (x − mean)ᵀ H (x − mean)) dx = (d/2) log 2π − ½ log det H."""
        return 0.5 * self.dimension * float(np.log(2 * np.pi)) - 0.5 * self.factor.log_determinant

    def noise(self, rng: Generator, count: int) -> Array:
        """Standard normal numbers, 0 where a state is held, shape (N, S, D)."""
        return rng.standard_normal((count, *self.mean.shape)) * self.free

    def deviation(self, rng: Generator, count: int) -> Array:
        """Independent draws less the mean, in y, shape (N, S, D)."""
        return self.factor.backward(self.noise(rng, count))

    def draw(self, rng: Generator, count: int) -> Array:
        """Independent draws, shape (N, S, D)."""
        return self.bend(self.mean + self.deviation(rng, count))

    def bend(self, Y: Array) -> Array:
        """States x of y, shape (N, S, D)."""
        return Y if self.shear is None else self.shear.bend(Y)

    def straighten(self, X: Array) -> Array:
        """y of states x, shape (N, S, D)."""
        return X if self.shear is None else self.shear.straighten(X)

    def distance2(self, X: Array) -> Array:
        """Squared Mahalanobis distance from the mean, shape (N,)."""
        d = (self.straighten(X) - self.mean) * self.free
        return np.asarray(np.einsum("nsd,nsd->n", d, self.system.times(d)))

    def log_density(self, X: Array) -> Array:
        """Normalised, shape (N,)."""
        return np.asarray(-0.5 * self.distance2(X) - self.log_volume)

    @cached_property
    def covariance(self) -> Array:
        """H⁻¹ on the flattened trajectory, 0 where a state is held, shape (S·D, S·D)."""
        size = self.mean.size
        unit = np.eye(size)[self.free.ravel()].reshape(-1, *self.mean.shape)
        root = self.factor.backward(unit).reshape(-1, size)
        return np.asarray(root.T @ root)


@dataclass(frozen=True, eq=False)
class Blend:
    r"""Σ_j share_j · t_ν(mean_j, H_j⁻¹): a proposal; ν = inf is the Gaussian.

    Args:
        parts: The Gaussians.
        shares: Positive, they sum to 1.
        dof: ν of each; the tails of a Gaussian are too light to propose from.
    """

    parts: tuple[Gaussian, ...]
    shares: Array
    dof: tuple[float, ...]

    def draw(self, rng: Generator, count: int) -> Array:
        """Independent draws, shape (N, S, D)."""
        part = rng.choice(len(self.parts), size=count, p=self.shares)
        X = np.empty((count, *self.parts[0].mean.shape))
        for j, (gaussian, dof) in enumerate(zip(self.parts, self.dof, strict=True)):
            rows = np.flatnonzero(part == j)
            if len(rows):
                step = gaussian.deviation(rng, len(rows))
                if np.isfinite(dof):
                    step /= np.sqrt(rng.chisquare(dof, len(rows)) / dof)[:, None, None]
                X[rows] = gaussian.bend(gaussian.mean + step)
        return X

    def log_densities(self, X: Array) -> Array:
        """log(share_j · density_j), shape (N, J)."""
        columns = [
            np.log(share) + _log_t(gaussian, X, dof)
            for gaussian, share, dof in zip(self.parts, self.shares, self.dof, strict=True)
        ]
        return np.stack(columns, axis=-1)

    def log_density(self, X: Array) -> Array:
        """Normalised, shape (N,)."""
        return np.asarray(np.logaddexp.reduce(self.log_densities(X), axis=-1))


def _log_t(gaussian: Gaussian, X: Array, dof: float) -> Array:
    if not np.isfinite(dof):
        return gaussian.log_density(X)
    d = gaussian.dimension
    normaliser = gammaln((dof + d) / 2) - gammaln(dof / 2) - 0.5 * d * np.log(dof / 2)
    tail = -0.5 * (dof + d) * np.log1p(gaussian.distance2(X) / dof)
    return np.asarray(normaliser - gaussian.log_volume + tail)


def linear(assembly: Assembly, which: int) -> Gaussian:
    """The linear-Gaussian part of the density: GP priors, couplings and data of a hypothesis.

    Of a robot with wheels the motion is taken in its sheared coordinates around the plan, where it
    is linear, and the coupling to positions as if they were those of y.

    Raises:
        ValueError: that part alone does not fix all variables.
    """
    rows = np.array([which])
    diagonal, upper = assembly.linear_hessian(rows)
    slope = assembly.gradient[which].copy()
    return _from_slope(assembly, which, diagonal[0], upper[0], slope, "linear", assembly.free)


def prior(assembly: Assembly, which: int, robot: bool = True) -> Gaussian:
    """The normalised densities of a hypothesis alone: GP priors and data, no coupling.

    Args:
        assembly: The density.
        which: The hypothesis.
        robot: Whether the robot is among the random coordinates.

    Raises:
        ValueError: that part alone does not fix all variables, as for a level without a prior of
            its own.
    """
    model = assembly.models[which]
    S, D = model.reference.shape
    diagonal, upper = np.zeros((S, D, D)), np.zeros((S - 1, D, D))
    slope = np.zeros((S, D))
    for wired, residual in assembly.linear_terms(which):
        if residual.log_normalizer == 0.0:  # a potential, which the density leaves unnormalised
            continue
        part = residual.gauss_newton(*wired.variables(model.reference))
        wired.add_gradient(part.gradient, slope)
        wired.add_hessian(part.hessian, diagonal, upper)
    free = assembly.free.copy()
    if not robot:
        free[:, model.columns["robot"]] = False
    return _from_slope(assembly, which, diagonal, upper, slope, "prior", free)


def _from_slope(
    assembly: Assembly,
    which: int,
    diagonal: Array,
    upper: Array,
    slope: Array,
    name: str,
    free: NDArray[np.bool_],
) -> Gaussian:
    """From the gradient at the reference and the Hessian of a quadratic energy."""
    model = assembly.models[which]
    bent = assembly.shear(assembly.reference[which])
    if bent is not None:
        _add_motion(assembly, which, bent, diagonal, upper, slope)
    start = assembly.reference[which].copy()
    for (variable, k), value in model.fixed.items():
        start[k, model.columns[variable]] = value
    # The gradient where the held states have their values, which the reference may not have.
    moved = System(diagonal, upper).times((start - assembly.reference[which])[None])[0]
    step = -(slope + moved) * free
    hold(free, diagonal[None], upper[None])
    system = System(diagonal, upper)
    factor = factorize(*system)
    if factor is None:
        raise ValueError(f"the {name} part of the density does not fix all of its variables")
    return Gaussian(start + factor.solve(step), system, factor, free, bent)


def _add_motion(
    assembly: Assembly, which: int, bent: Shear, diagonal: Array, upper: Array, slope: Array
) -> None:
    """The robot's motion at the reference: in sheared coordinates it is that quadratic exactly."""
    for wired in assembly.nonlinear:
        if wired.residual is bent.motion:
            part = wired.residual.gauss_newton(*wired.variables(assembly.reference[which]))
            wired.add_gradient(part.gradient, slope)
            wired.add_hessian(part.hessian, diagonal, upper)


def at_mode(assembly: Assembly, state: Array, which: int) -> Gaussian | None:
    """Laplace's Gaussian: the true Hessian at a local optimum; None where it is not one."""
    quadratic = assembly.expand(state[None], np.array([which]))
    _, system = next(quadratic.systems(np.zeros(1, dtype=np.intp)))
    factor = factorize(*system)
    if factor is None:
        return None
    # The gradient is zero there, so that the Hessian is the same in sheared coordinates.
    return Gaussian(state, system, factor, assembly.free, assembly.shear(state))


def average_curvature(assembly: Assembly, X: Array, which: int) -> Gaussian:
    """N(mean of X, (mean Gauss–Newton Hessian over X)⁻¹): positive definite where `linear` is.

    Of a robot with wheels that of the first state alone, in coordinates sheared there: headings
    that differ have no common curvature.

    Args:
        assembly: The density.
        X: States, shape (N, S, D).
        which: The hypothesis.

    Raises:
        ValueError: the mean is not positive definite or not finite.
    """
    bent = assembly.shear(X[0])
    X = X if bent is None else X[:1]
    quadratic: Quadratic = assembly.gauss_newton(X, np.full(len(X), which))
    total: System | None = None
    for n, (_, system) in enumerate(quadratic.systems(np.arange(len(X)))):
        total = system if total is None else total.mixed(system, 1 / (n + 1))
    factor = None if total is None else factorize(*total)
    if total is None or factor is None:
        raise ValueError("the mean curvature is not positive definite")
    return Gaussian(X.mean(axis=0), total, factor, assembly.free, bent)


def markov_fit(X: Array, free: NDArray[np.bool_], bent: Shear | None = None) -> Gaussian | None:
    r"""The Gaussian with the mean of X and its covariances within and between neighbouring steps,
    which of all such Gaussians has the largest entropy: its precision is block-tridiagonal,

    H = Σ_k Σ_{k,k+1}⁻¹ − Σ_{0<k<S−1} Σ_k⁻¹  (each on its own places).

    Args:
        X: Draws, shape (N, S, D); N well above 2 D.
        free: Which coordinates are random; a step is free or held as a whole variable.
        bent: The coordinates in which moments are taken.

    Returns:
        None where there are too few draws.

    Reference:
        Dempster, Biometrics 1972, on covariance selection.
    """
    X = X if bent is None else bent.straighten(X)
    N, S, D = X.shape
    mean = X.mean(axis=0)
    d = X - mean
    diagonal, upper = np.zeros((S, D, D)), np.zeros((S - 1, D, D))
    held = [np.diag((~free[k]).astype(float)) for k in range(S)]
    try:
        for k in range(S):
            single = np.einsum("ni,nj->ij", d[:, k], d[:, k]) / N + held[k]
            if S == 1 or 0 < k < S - 1:
                diagonal[k] += (1.0 if S == 1 else -1.0) * np.linalg.inv(single)
            if k + 1 < S:
                two = d[:, k : k + 2].reshape(N, 2 * D)
                pair = np.einsum("ni,nj->ij", two, two, optimize=True) / N
                pair[:D, :D] += held[k]
                pair[D:, D:] += held[k + 1]
                inverse = np.linalg.inv(pair)
                diagonal[k] += inverse[:D, :D]
                diagonal[k + 1] += inverse[D:, D:]
                upper[k] += inverse[:D, D:]
    except np.linalg.LinAlgError:
        return None
    factor = factorize(diagonal, upper)
    return None if factor is None else Gaussian(mean, System(diagonal, upper), factor, free, bent)


def blend(parts: Sequence[tuple[Gaussian, float, float]]) -> Blend:
    """From (Gaussian, share, ν) triples; shares are rescaled to sum to 1."""
    shares = np.array([share for _, share, _ in parts])
    return Blend(
        tuple(g for g, _, _ in parts), shares / shares.sum(), tuple(n for _, _, n in parts)
    )
