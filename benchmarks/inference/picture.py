"""Where sampling from the prior collapses, and where Laplace misleads."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from benchmarks.inference import Row
from benchmarks.inference.cases import Case, of_scenario
from factors.gp_prior import gaussian
from factors.kinematics import SpeedLimit
from fgplan import Density, GivenPlan, Level, Robot, Scenario, Track, keys
from fgplan.assembly import Assembly
from fgplan.inference import Importance, Laplace, Progress
from fgplan.model import Model, Term, Variable
from fgplan.solver import SecondOrder

Array = NDArray[np.float64]

WIDTHS = np.geomspace(1e-3, 10, 13)
"""h [m²]"""
STEPS = (3, 6, 12)
PEOPLE = (0, 1, 2, 4, 8)
GAPS = np.linspace(0.0, 3.0, 25)
"""Between the mean and the limit, in standard deviations."""


def draw(rows: Sequence[Row], path: Path, short: bool, progress: Progress) -> None:
    """Four panels as a PNG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 8), layout="constrained")
    axes = figure.subplots(2, 2)
    draws = 2000 if short else 20_000
    _collapse_with_h(axes[0, 0], draws, progress)
    _collapse_with_people(axes[0, 1], draws, progress)
    _misled_by_limits(axes[1, 0])
    _error_against_cost(axes[1, 1], rows)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def corridor(steps: int, h: float, people: int = 0) -> Case:
    """A straight plan half a metre beside the way the robot would coast; people come along it, one
    on the left and one on the right."""
    density = Density(
        dt=0.4, horizon=0.4 * steps, contact_sigma=np.inf, limit_sigma=np.inf, Qc_robot=0.5
    )
    seen = np.array([-0.8, -0.4, 0.0])
    tracks = tuple(
        Track(f"p{i}", seen, np.column_stack([2.0 + 0.5 * i - 0.5 * seen, np.full(3, y)]))
        for i, y in enumerate([0.9, 0.1] * (people // 2) + [0.9] * (people % 2))
    )
    scenario = Scenario(
        Robot(np.zeros(2), np.array([0.8, 0.0])),
        plans=(GivenPlan("beside", np.array([[0.0, 0.0], [1.0, 0.5], [9.0, 0.5]])),),
        count=0, tracks=tracks, density=density, levels=(Level(h=h),),
    )  # fmt: skip
    return of_scenario("", scenario, None)


def _share(case: Case, source: Any, draws: int) -> float:
    result = Importance(draws, source).infer(case.assembly, case.which, case.optima, 0)
    return float(result.diagnostics.ess or 0.0) / draws


def expected_share(case: Case, h: float) -> float:
    r"""ESS/N of sampling a linear-Gaussian density from its prior, in closed form:

    (E ψ)²/E ψ², with E exp(−(x−η)²/2h) = √det(h(K+h)⁻¹) exp(−½ (m−η)ᵀ(K+h)⁻¹(m−η)); ψ² is the
    same with h/2.
    """
    from fgplan.inference.gaussian import prior

    g = prior(case.assembly, case.which)
    S, D = g.mean.shape
    rows = np.arange(1, S)[:, None] * D + np.arange(2)
    at = rows.ravel()  # positions from the first step on
    K, off = g.covariance[np.ix_(at, at)], g.mean.ravel()[at] - _plan(case).ravel()

    def log_mean(width: float) -> float:
        total = K + width * np.eye(len(at))
        fit = off @ np.linalg.solve(total, off) + np.linalg.slogdet(total)[1]
        return float(-0.5 * fit + 0.5 * len(at) * np.log(width))

    return float(np.exp(2 * log_mean(h) - log_mean(h / 2)))


def _plan(case: Case) -> Array:
    return np.asarray(case.assembly.reference[case.which][1:, :2])


def _collapse_with_h(axes: Any, draws: int, progress: Progress) -> None:
    for n, steps in enumerate(STEPS):
        built = [(h, corridor(steps, float(h))) for h in WIDTHS]
        exact = [expected_share(case, float(h)) for h, case in built]
        axes.loglog(WIDTHS, exact, f"C{n}-", label=f"T = {steps}")
        found = [_share(case, "prior", draws) for _, case in built]
        axes.loglog(WIDTHS, found, f"C{n}o", mfc="none")
        progress("picture", n + 1, len(STEPS) + len(PEOPLE))
    axes.axhline(1 / draws, color="grey", ls=":")
    axes.text(WIDTHS[-1], 1.2 / draws, "one sample is left", ha="right", color="grey")
    axes.set(
        title="From the prior: circles sampled, lines exact",
        xlabel="h [m²]", ylabel="effective share of the samples", ylim=(0.3 / draws, 1.5),
    )  # fmt: skip
    axes.legend()


def _collapse_with_people(axes: Any, draws: int, progress: Progress) -> None:
    shares: dict[str, list[float]] = {"prior": [], "linear": [], "laplace": []}
    for i, n in enumerate(PEOPLE):
        case = corridor(6, 0.3, n)
        for source, found in shares.items():
            found.append(_share(case, source, draws))
        progress("picture", len(STEPS) + i + 1, len(STEPS) + len(PEOPLE))
    for source, found in shares.items():
        label = {"prior": "prior", "linear": "linear part", "laplace": "around optima"}[source]
        axes.semilogy(PEOPLE, found, "o-", label=label)
    axes.set(
        title="People, T = 6, h = 0.3 m²", xlabel="people", ylabel="effective share",
        ylim=(0.3 / draws, 1.5),
    )  # fmt: skip
    axes.legend(title="importance sampling from")


def limited(gap: float) -> Assembly:
    """v ~ N(0, 1) in one dimension, with a stiff limit at |v| = gap."""
    prior = gaussian(np.zeros(2), np.eye(2))
    limit = SpeedLimit(gap, 0.01, dim=2)
    on = (("robot", 0),)
    terms = tuple(Term(n, r, on, range(1), True) for n, r in (("p", prior), ("v", limit)))
    robot = Variable("robot", 2, keys.robot)
    return Assembly([Model(np.zeros(1), (robot,), terms, (), {}, np.zeros((1, 2)))])


def _misled_by_limits(axes: Any) -> None:
    methods = {
        "Laplace by curvature": (Laplace(check=0, limits="curvature"), "C3--"),
        "Laplace, limits propagated": (Laplace(check=0), "C2-"),
        "importance sampling": (Importance(4096, "linear"), "C0o"),
    }
    found: dict[str, list[float | None]] = {name: [] for name in methods}
    for gap in GAPS[1:]:
        assembly = limited(float(gap))
        optima = SecondOrder().solve(assembly, np.zeros((1, 1, 2)), np.zeros(1, dtype=np.intp))
        for name, (method, _) in methods.items():
            found[name].append(method.infer(assembly, 0, optima).log_evidence)
    axes.plot(GAPS[1:], np.log(2 * norm.cdf(GAPS[1:]) - 1), "k-", lw=3, label="exact")
    for name, (_, style) in methods.items():
        axes.plot(GAPS[1:], found[name], style, mfc="none", label=name)
    axes.set(
        title="A limit that the optimum does not touch",
        xlabel="from the optimum to the limit [sd]", ylabel="log evidence, one coordinate [nats]",
    )  # fmt: skip
    axes.legend()


def _error_against_cost(axes: Any, rows: Sequence[Row]) -> None:
    names = [row.case for row in rows]
    case = next((n for n in names if n.startswith("three")), names[0])
    for method in dict.fromkeys(row.method for row in rows):
        own = [r for r in rows if r.case == case and r.method == method and r.mean_error]
        axes.loglog([r.seconds for r in own], [r.mean_error for r in own], "o-", label=method)
    axes.set(title=case, xlabel="CPU time [s]", ylabel="error of the mean [sd]")
    axes.legend(fontsize=7)
