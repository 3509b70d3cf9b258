"""Limits propagated through the Gaussian around an optimum, against quadrature, closed forms and
sampling."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.stats import norm

from factors.gp_prior import gaussian
from factors.kinematics import LinearLimit, SpeedLimit
from factors.residual import Expansion, Residual
from fgplan import CarLike, Density, DifferentialDrive, Holonomic, Robot, SecondOrder
from fgplan.assembly import Assembly
from fgplan.inference import Importance, Laplace
from fgplan.inference.limits import moderated
from fgplan.inference.tilted import tilted_length, tilted_number
from fgplan.keys import robot
from fgplan.model import Model, Term, Variable
from fgplan.solver import Solution
from tests.scenes import assembled, forked, initial, random_scene, short, track


@pytest.mark.parametrize("room", [np.inf, 0.06])
@pytest.mark.parametrize(("excess", "sd", "scale"), [
    (-2.0, 1.0, 20.0), (0.0, 1.0, 20.0), (1.0, 0.3, 5.0), (4.0, 0.5, 40.0), (-9.0, 1.0, 1.0),
    (0.5, 1.0, 20.0), (-0.02, 0.01, 20.0),
])  # fmt: skip
def test_a_limit_on_a_number_has_the_moments_of_quadrature(
    excess: float, sd: float, scale: float, room: float
) -> None:
    """With and without a bound a little beyond the place where the hinge begins."""

    def density(e: float) -> float:
        return float(norm.pdf(e, excess, sd) * np.exp(-0.5 * (scale * max(0.0, e)) ** 2))

    def moment(power: int, about: float = 0.0) -> float:
        ends = {excess - 12 * sd, min(0.0, excess), 0.0, 8 / scale, excess + 12 * sd, room}
        pieces = pairwise(sorted(end for end in ends if end <= min(room, 1e9)))
        return sum(
            quad(lambda e: density(e) * (e - about) ** power, a, b, epsabs=0)[0] for a, b in pieces
        )

    Z = moment(0)
    mean = moment(1) / Z
    got = tilted_number(np.array([excess]), np.array([sd**2]), scale, room)
    assert got.log_z[0] == pytest.approx(np.log(Z), abs=1e-7)
    assert got.mean[0, 0] == pytest.approx(mean, abs=1e-6)
    assert got.covariance[0, 0, 0] == pytest.approx(moment(2, mean) / Z, rel=1e-5)


@pytest.mark.parametrize("where", [(0.0, 0.0), (0.9, 0.3), (0.3, -1.2), (2.0, 0.0)])
@pytest.mark.parametrize("wide", [0.1, 0.6, 2.0])
@pytest.mark.parametrize("room", [np.inf, 0.06])
def test_a_limit_on_a_length_has_the_moments_of_a_fine_grid(
    where: Any, wide: float, room: float
) -> None:
    limit, scale = 1.1, 20.0
    covariance = wide**2 * np.array([[1.0, 0.4], [0.4, 0.7]])
    x = np.linspace(-1.5, 1.5, 701)
    s = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1)
    d = s - where
    p = np.exp(-0.5 * np.einsum("...i,ij,...j->...", d, np.linalg.inv(covariance), d))
    p *= np.exp(-0.5 * (scale * np.maximum(np.linalg.norm(s, axis=-1) - limit, 0)) ** 2)
    p *= np.linalg.norm(s, axis=-1) <= limit + room
    Z = p.sum()
    mean = np.einsum("xy,xyi->i", p, s) / Z
    e = s - mean
    spread = np.einsum("xy,xyi,xyj->ij", p, e, e) / Z
    got = tilted_length(np.array([where]), covariance[None], limit, scale, room)
    area = (x[1] - x[0]) ** 2 / (2 * np.pi * np.sqrt(np.linalg.det(covariance)))
    assert got.log_z[0] == pytest.approx(np.log(Z * area), abs=5e-3, rel=2e-3)
    assert_allclose(got.mean[0], mean, atol=6e-3)
    assert_allclose(got.covariance[0], spread, atol=3e-3)


def solved(residuals: list[Any], dim: int) -> tuple[Assembly, Solution]:
    """One state N(0, 1) a coordinate, with limits that are the robot's own."""
    prior = Term("prior", gaussian(np.zeros(dim), np.eye(dim)), (("robot", 0),), range(1), True)
    limits = [Term("limit", r, (("robot", 0),), range(1), True) for r in residuals]
    variable = Variable("robot", dim, robot)
    model = Model(np.zeros(1), (variable,), (prior, *limits), (), {}, np.zeros((1, dim)))
    assembly = Assembly([model])
    start, zero = np.zeros((1, 1, dim)), np.zeros(1, dtype=np.intp)
    return assembly, SecondOrder().solve(assembly, start, zero)[0]


@pytest.mark.parametrize("gap", [0.1, 0.5, 1.0, 3.0])
def test_a_stiff_box_has_the_mass_of_the_normal_law_inside(gap: float) -> None:
    """v ~ N(0, 1) with |v| ≤ gap. Seen to fail by log 2Φ(gap) − 1 with the curvature alone."""
    assembly, optimum = solved([SpeedLimit(gap, 1e-4, dim=2)], 2)
    result = Laplace(check=0).infer(assembly, 0, [optimum])
    exact = np.log(2 * norm.cdf(gap) - 1)
    assert result.log_evidence == pytest.approx(exact, abs=0.1)
    flat = Laplace(check=0, limits="curvature").infer(assembly, 0, [optimum])
    assert flat.log_evidence == pytest.approx(0, abs=1e-9)


def test_independent_halfspaces_are_exact() -> None:
    """x_i ≤ b_i for independent x_i: each factor is propagated without error."""
    b = np.array([0.3, -0.5, 1.0])
    assembly, optimum = solved([LinearLimit((np.eye(3),), b, 1e-5)], 3)
    result = Laplace(check=0).infer(assembly, 0, [optimum])
    assert result.log_evidence == pytest.approx(float(norm.logcdf(b).sum()), abs=1e-4)
    ratio = norm.pdf(b) / norm.cdf(b)
    assert_allclose(result.mean[0], -ratio, atol=1e-4)
    assert_allclose(np.diag(result.covariance), 1 - b * ratio - ratio**2, atol=1e-4)


def test_without_limits_nothing_changes() -> None:
    density = short(limit_sigma=np.inf)
    assembly, hypotheses = assembled(forked(track("a", 3.0, 0.5), density=density))
    X, which = initial(assembly, hypotheses)
    found = SecondOrder().solve(assembly, X[:1], which[:1])
    one, two = (Laplace(check=0, limits=kind).infer(assembly, 0, found)  # type: ignore[arg-type]
                for kind in ("propagated", "curvature"))  # fmt: skip
    assert one.log_evidence == pytest.approx(two.log_evidence, abs=1e-9)


@pytest.mark.parametrize(
    "model", [Holonomic(), DifferentialDrive(), CarLike()], ids=["holonomic", "differential", "car"]
)
def test_mass_and_moments_agree_with_sampling_under_the_default_limits(model: Any) -> None:
    """Where the curvature is off by three nats and more."""
    who = Robot(np.zeros(2), np.array([0.8, 0.0]), 0.0, model=model)
    scenario = random_scene(5, 2, crowd="predicted", density=Density(horizon=1.6))
    assembly, hypotheses = assembled(scenario.replace(robot=who))
    X, which = initial(assembly, hypotheses)
    found = SecondOrder().solve(assembly, X[which == 0], which[which == 0])
    optima = [s for s in found if s.converged]
    drawn = Importance(16_384).infer(assembly, 0, optima, 1)
    assert drawn.warnings == ()
    assert drawn.log_evidence is not None
    propagated, flat = (
        Laplace(check=0, limits=kind).infer(assembly, 0, optima)  # type: ignore[arg-type]
        for kind in ("propagated", "curvature")
    )
    assert propagated.log_evidence == pytest.approx(drawn.log_evidence, abs=0.2)
    assert flat.log_evidence is not None
    assert abs(flat.log_evidence - drawn.log_evidence) > 3
    spread = np.sqrt(np.diag(drawn.covariance)).reshape(drawn.mean.shape)
    # Positions of a robot with wheels are in sheared coordinates; the rest is the same in both.
    moving = spread[:, 2:] > 1e-9
    off = np.abs(propagated.mean - drawn.mean)[:, 2:][moving] / spread[:, 2:][moving]
    assert off.max() < 0.2


def test_what_only_its_limit_holds_is_seen_by_curvature() -> None:
    """A ridge of the density that the limit cuts off: without it there is no minimum to go from."""
    assembly, optimum = solved([LinearLimit((np.array([[1.0]]),), np.array([0.5]), 0.01)], 1)
    assert moderated(assembly, optimum.state, 0) is not None
    ridge = Term("ridge", Ridge(), (("robot", 0),), range(1))
    m = assembly.models[0]
    shared = (*m.shared, ridge)
    held = Assembly([Model(m.times, m.variables, shared, (), {}, m.reference)])
    start, zero = np.full((1, 1, 1), 0.5), np.zeros(1, dtype=np.intp)
    end = SecondOrder().solve(held, start, zero)[0]
    assert end.converged
    assert moderated(held, end.state, 0) is None
    result = Laplace(check=0).infer(held, 0, [end])
    assert result.log_evidence is not None


class Ridge(Residual):
    """Energy −x² + ¼ x⁴ + 1: two valleys at ±√2 and a ridge at 0."""

    dims, rows = (1,), 1

    def linearize(self, *x: Any) -> Any:
        raise TypeError("it is no square")

    def energy(self, *x: Any) -> Any:
        return (0.25 * x[0] ** 4 - x[0] ** 2 + 1)[..., 0]

    def gauss_newton(self, *x: Any) -> Expansion:
        return self.expand(*x)

    def expand(self, *x: Any) -> Expansion:
        z = x[0]
        return Expansion(self.energy(z), z**3 - 2 * z, (3 * z**2 - 2)[..., None])
