"""What a factor is: a whitened residual, its Jacobians and, where it matters, its true Hessian.

A residual is plain numpy and works on any number of leading axes, so that one call evaluates all
time steps (and all starts) of a trajectory. `on` turns the same object into a GTSAM factor. This
is the only file that builds `gtsam.CustomFactor`: a callback that leaves a Jacobian unset or gives
it the wrong shape can crash the process, and the guard here turns that into an error.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Expansion(NamedTuple):
    """Second-order expansion of a negative log density: shapes (...), (..., s), (..., s, s), over
    the s components that the residual depends on (its `support`)."""

    energy: Array
    gradient: Array
    hessian: Array


class Residual(ABC):
    r"""A factor of the density: φ(x_1, ..., x_m) ∝ exp(−½‖e(x_1, ..., x_m)‖²), e whitened.

    Subclasses are frozen dataclasses. Variables are vectors whose first components are positions;
    every method takes them with any leading axes (..., dims[i]).

    Attributes:
        per_step: Names of fields whose first axis runs over time steps; `at` picks one step.
        convex: Whether the Hessian of `expand` is positive semidefinite everywhere.
        log_normalizer: log of the constant that makes exp(−energy) a density in the variable it
            describes; 0 for potentials, which the density leaves unnormalised.
    """

    per_step: ClassVar[tuple[str, ...]] = ()
    convex: ClassVar[bool] = False
    log_normalizer: float = 0.0

    @property
    @abstractmethod
    def dims(self) -> tuple[int, ...]:
        """Size of each variable."""

    @property
    @abstractmethod
    def rows(self) -> int:
        """Number of components of the error."""

    @property
    def support(self) -> NDArray[np.intp]:
        """Components of the concatenated variables that the residual depends on; all by default.

        Expansions are given on these alone: an interaction of n people needs 2n positions out of
        a variable of 4n.
        """
        return np.arange(sum(self.dims))

    @abstractmethod
    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        """Error (..., rows) and one Jacobian (..., rows, dims[i]) per variable."""

    def error(self, *x: Array) -> Array:
        """Whitened error, shape (..., rows)."""
        return self.linearize(*x)[0]

    def energy(self, *x: Array) -> Array:
        """−log φ, shape (...)."""
        e = self.error(*x)
        return np.asarray(0.5 * np.einsum("...i,...i->...", e, e))

    def gauss_newton(self, *x: Array) -> Expansion:
        """Expansion that drops the curvature of the residual: positive semidefinite."""
        e, blocks = self.linearize(*x)
        J = np.concatenate(blocks, axis=-1)[..., self.support]
        Jt = np.swapaxes(J, -1, -2)
        energy = 0.5 * np.einsum("...i,...i->...", e, e)
        return Expansion(energy, (Jt @ e[..., None])[..., 0], Jt @ J)

    def expand(self, *x: Array) -> Expansion:
        """Expansion with the true Hessian. Exact as it stands only where e is linear; every
        residual with curvature overrides it."""
        return self.gauss_newton(*x)

    def at(self, step: int) -> Residual:
        """This residual with the parameters of one time step."""
        if not self.per_step:
            return self
        chosen = {name: getattr(self, name)[step] for name in self.per_step}
        return replace(self, **chosen)  # type: ignore[type-var]

    def on(self, *keys: int) -> gtsam.NonlinearFactor:
        """The GTSAM factor on these keys.

        Raises:
            ValueError: as many keys as variables are needed; or, when the factor is evaluated, a
                variable, error or Jacobian has the wrong shape.
        """
        self._check_keys(keys)
        return gtsam.CustomFactor(
            gtsam.noiseModel.Unit.Create(self.rows), list(keys), _callback(self, keys)
        )

    def _check_keys(self, keys: Sequence[int]) -> None:
        if len(keys) != len(self.dims):
            raise ValueError(
                f"{type(self).__name__} connects {len(self.dims)} variables, got {len(keys)} keys"
            )


@dataclass(frozen=True, eq=False)
class Linear(Residual):
    """e = Σ A_i x_i − b: constant Jacobians, so the solver assembles it once.

    Args:
        A: One whitened matrix (rows, dims[i]) per variable.
        b: Whitened right-hand side, shape (rows,), or (steps, rows) where it differs by step.
        log_normalizer: See `Residual`.
    """

    per_step: ClassVar[tuple[str, ...]] = ("b",)

    A: tuple[Array, ...]
    b: Array
    log_normalizer: float = 0.0

    @cached_property
    def dims(self) -> tuple[int, ...]:
        return tuple(a.shape[1] for a in self.A)

    @property
    def rows(self) -> int:
        return len(self.A[0])

    def error(self, *x: Array) -> Array:
        terms = [xi @ a.T for a, xi in zip(self.A, x, strict=True)]
        return np.asarray(sum(terms[1:], terms[0]) - self.b)

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        e = self.error(*x)
        blocks = tuple(np.broadcast_to(a, (*e.shape[:-1], *a.shape)) for a in self.A)
        return e, blocks

    def gauss_newton(self, *x: Array) -> Expansion:
        e, J = self.error(*x), self._J
        curvature = np.broadcast_to(self.information, (*e.shape[:-1], *self.information.shape))
        return Expansion(0.5 * np.einsum("...i,...i->...", e, e), e @ J, curvature)

    @cached_property
    def _J(self) -> Array:
        return np.concatenate(self.A, axis=1)

    @cached_property
    def information(self) -> Array:
        """Its Hessian, wherever it is: Jᵀ J, shape (s, s)."""
        return self._J.T @ self._J

    def at(self, step: int) -> Linear:
        return self if self.b.ndim == 1 else Linear(self.A, self.b[step], self.log_normalizer)

    def on(self, *keys: int) -> gtsam.NonlinearFactor:
        """The GTSAM factor; up to three keys it runs in C++ without a Python callback."""
        self._check_keys(keys)
        if len(keys) > 3:
            return super().on(*keys)
        parts: list[Any] = [part for pair in zip(keys, self.A, strict=True) for part in pair]
        parts += [self.b, gtsam.noiseModel.Unit.Create(self.rows)]
        factor = gtsam.JacobianFactor(*parts)
        origin = gtsam.Values()  # without it the container reports error 0 and never shifts
        for key, size in zip(keys, self.dims, strict=True):
            origin.insert(key, np.zeros(size))
        return gtsam.LinearContainerFactor(factor, origin)


def whitener(covariance: Any, name: str = "covariance") -> Array:
    """W with WᵀW = covariance⁻¹, lower triangular.

    Raises:
        ValueError: the matrix is not square, finite, symmetric and positive definite.
    """
    S = np.atleast_2d(np.asarray(covariance, dtype=float))
    if S.ndim != 2 or S.shape[0] != S.shape[1]:
        raise ValueError(f"{name} must be a square matrix, got shape {S.shape}")
    return whiteners(S, name)


def positive(**values: float) -> None:
    """Raises ValueError, with its name, for a number that is not finite and above 0."""
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be positive, got {value}")


def whiteners(S: Array, name: str = "covariance") -> Array:
    """The same of many matrices, shape (..., d, d).

    Raises:
        ValueError: as `whitener`, for all together.
    """
    if not np.all(np.isfinite(S)):
        raise ValueError(f"{name} holds a number that is not finite: {S.tolist()}")
    size = np.abs(S)
    most = size.max(axis=(-1, -2), keepdims=True, initial=0.0)
    if (np.abs(S - np.swapaxes(S, -1, -2)) > 1e-9 * size + 1e-12 * most).any():
        raise ValueError(f"{name} must be symmetric, got {S.tolist()}")
    try:
        L = np.linalg.cholesky(S)
    except np.linalg.LinAlgError:
        raise ValueError(f"{name} must be positive definite, got {S.tolist()}") from None
    return np.tril(np.linalg.inv(L))  # inv pivots, which leaves rounding above the diagonal


def log_gaussian_normalizer(W: Array) -> float:
    """log of (2π)^(−n/2) det(Σ)^(−1/2), from the whitener W of Σ."""
    return float(np.sum(np.log(np.abs(np.diag(W)))) - 0.5 * len(W) * np.log(2 * np.pi))


def _callback(residual: Residual, keys: Sequence[int]) -> Any:
    """GTSAM's error function. It holds the residual and nothing that owns the graph, else it
    would leak."""

    def evaluate(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> Array:
        x = [values.atVector(key) for key in keys]
        for slot, (xi, size) in enumerate(zip(x, residual.dims, strict=True)):
            _guard(residual, f"variable {slot}", np.shape(xi), (size,))
        if jacobians is None:
            e = np.asarray(residual.error(*x), dtype=float)
        else:
            e, blocks = residual.linearize(*x)
            _guard(residual, "number of Jacobians", (len(blocks),), (len(keys),))
            for slot, (block, size) in enumerate(zip(blocks, residual.dims, strict=True)):
                _guard(residual, f"Jacobian {slot}", np.shape(block), (residual.rows, size))
                jacobians[slot] = np.array(block, dtype=float, order="F")
        _guard(residual, "error", np.shape(e), (residual.rows,))
        return e

    return evaluate


def _guard(residual: Residual, what: str, got: tuple[int, ...], expected: tuple[int, ...]) -> None:
    if got != expected:
        raise ValueError(f"{type(residual).__name__}: {what} has shape {got}, expected {expected}")
