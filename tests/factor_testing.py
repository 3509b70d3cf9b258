"""One checker for every factor: derivatives, batches and the GTSAM factor must agree.

The oracle is central differences of the error (for Jacobians) and of the energy (for gradient and
true Hessian), plus the residual itself evaluated one point at a time.
"""

from __future__ import annotations

from collections.abc import Callable

import gtsam
import numpy as np
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from factors.residual import Residual

Array = NDArray[np.float64]

STEP = 1e-5  # of central differences: truncation and rounding are both below 1e-9 of the scale


def check_derivatives(residual: Residual, *x: Array, atol: float = 1e-6) -> None:
    """Assert that everything a residual says about itself is consistent.

    Args:
        residual: Any residual.
        x: One vector (dims[i],) per variable; or (S, dims[i]) when the residual has parameters
            per step. Away from kinks: a hinge has no second derivative on its threshold.
        atol: Tolerance of the differences, relative to the largest number compared (or to 1).
    """
    x = tuple(np.asarray(xi, dtype=float) for xi in x)
    assert len(x) == len(residual.dims)
    if x[0].ndim == 1:
        _check_point(residual, x, atol)
        _check_gtsam_factor(residual, x)
        rng = np.random.default_rng(0)
        x = tuple(xi + 0.05 * rng.standard_normal((3, *xi.shape)) for xi in x)
    else:
        for step, xs in enumerate(zip(*x, strict=True)):
            _check_point(residual.at(step), xs, atol)
            _check_gtsam_factor(residual.at(step), xs)
    _check_batches(residual, x)


def differences(f: Callable[..., Array], *x: Array) -> Array:
    """Central differences of f at vectors x: shape (*f.shape, Σ dims)."""
    columns = []
    for slot, xi in enumerate(x):
        for component in range(len(xi)):
            step = np.zeros_like(xi)
            step[component] = STEP
            ahead = f(*x[:slot], xi + step, *x[slot + 1 :])
            behind = f(*x[:slot], xi - step, *x[slot + 1 :])
            columns.append((ahead - behind) / (2 * STEP))
    return np.stack(columns, axis=-1)


def _check_point(residual: Residual, x: tuple[Array, ...], atol: float) -> None:
    support = residual.support
    e, blocks = residual.linearize(*x)
    assert e.shape == (residual.rows,)
    assert tuple(block.shape for block in blocks) == tuple((len(e), d) for d in residual.dims)
    assert_allclose(residual.error(*x), e, rtol=1e-12, atol=1e-12)
    J = np.concatenate(blocks, axis=-1)
    _assert_close(J, differences(residual.error, *x), atol, "Jacobian")

    energy = residual.energy(*x)
    assert_allclose(energy, 0.5 * e @ e, rtol=1e-9, atol=1e-12, err_msg="energy is not ½‖e‖²")
    aside = np.setdiff1d(np.arange(J.shape[-1]), support)
    assert not J[:, aside].any(), "the error depends on components outside the support"
    J = J[:, support]
    flat = residual.gauss_newton(*x)
    assert_allclose(flat.energy, energy, rtol=1e-9, atol=1e-12)
    assert_allclose(flat.gradient, J.T @ e, rtol=1e-9, atol=1e-9)
    assert_allclose(flat.hessian, J.T @ J, rtol=1e-9, atol=1e-9)

    full = residual.expand(*x)
    assert full.gradient.shape == (len(support),)
    assert full.hessian.shape == (len(support), len(support))
    assert_allclose(full.energy, energy, rtol=1e-9, atol=1e-12)
    _assert_close(full.gradient, differences(residual.energy, *x)[support], atol, "gradient")
    slopes = differences(lambda *y: residual.expand(*y).gradient, *x)
    _assert_close(full.hessian, slopes[:, support], atol, "true Hessian")
    assert_allclose(full.hessian, full.hessian.T, rtol=1e-9, atol=1e-9)
    if residual.convex:
        assert np.linalg.eigvalsh(full.hessian)[0] > -1e-9 * max(1.0, np.abs(full.hessian).max())


def _check_batches(residual: Residual, x: tuple[Array, ...]) -> None:
    """Leading axes (S,) and (B, S) give the numbers of one point at a time."""
    rng = np.random.default_rng(1)
    stacked = tuple(xi + 0.02 * rng.standard_normal((2, *xi.shape)) for xi in x)
    evaluations: tuple[Callable[[Residual], Callable[..., tuple[Array, ...]]], ...] = (
        lambda r: lambda *y: (r.error(*y), r.energy(*y)),
        lambda r: lambda *y: (r.linearize(*y)[0], *r.linearize(*y)[1]),
        lambda r: r.gauss_newton,
        lambda r: r.expand,
    )
    for evaluate in evaluations:
        together = evaluate(residual)(*stacked)
        one_start = evaluate(residual)(*(xi[0] for xi in stacked))
        for start, step in np.ndindex(stacked[0].shape[:2]):
            alone = evaluate(residual.at(step))(*(xi[start, step] for xi in stacked))
            for whole, part in zip(together, alone, strict=True):
                assert whole.shape == (*stacked[0].shape[:2], *part.shape)
                assert_allclose(whole[start, step], part, rtol=1e-9, atol=1e-10)
        for whole, part in zip(together, one_start, strict=True):
            assert_allclose(whole[0], part, rtol=1e-9, atol=1e-10)


def _check_gtsam_factor(residual: Residual, x: tuple[Array, ...]) -> None:
    keys = list(range(len(x)))[::-1]  # not in sorted order, which must not matter
    values = gtsam.Values()
    for key, xi in zip(keys, x, strict=True):
        values.insert(key, xi)
    factor = residual.on(*keys)
    assert list(factor.keys()) == keys
    e, blocks = residual.linearize(*x)
    assert_allclose(factor.error(values), residual.energy(*x), rtol=1e-9, atol=1e-12)
    linear = factor.linearize(values)  # named: its matrices die with it
    A, b = linear.jacobian()
    assert_allclose(A, np.concatenate(blocks, axis=-1), rtol=1e-12, atol=1e-12)
    assert_allclose(b, -e, rtol=1e-9, atol=1e-9)


def _assert_close(actual: Array, expected: Array, atol: float, what: str) -> None:
    scale = max(1.0, float(np.abs(expected).max(initial=0.0)))
    assert_allclose(actual, expected, rtol=0, atol=atol * scale, err_msg=what)
