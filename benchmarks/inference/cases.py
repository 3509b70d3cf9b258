"""What is inferred: the paper's case, a person at the robot's own mean, a recorded crowd."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np
from numpy.typing import NDArray

from factors.gp_prior import gaussian
from factors.interaction import Interaction
from factors.pairwise import PredictedPairs
from fgplan import Scenario, SecondOrder, keys, recordings
from fgplan.assembly import Assembly
from fgplan.components import distinct
from fgplan.crowd import believe, seen
from fgplan.hypotheses import hypothesise
from fgplan.inference import HMC, Progress
from fgplan.model import Model, Term, Variable, build
from fgplan.solver import Solution

Array = NDArray[np.float64]

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True, eq=False)
class Case:
    """One hypothesis of one density.

    Args:
        name: For tables.
        assembly: The density.
        which: The hypothesis.
        optima: Its distinct local optima.
        solving: What they took to find [s of CPU].
        plane: Where the robot's position is in a state.
    """

    name: str
    assembly: Assembly
    which: int
    optima: tuple[Solution, ...]
    solving: float
    plane: slice


@dataclass(frozen=True, eq=False)
class Reference:
    """What is held for true.

    Args:
        mean: Of the robot's positions, shape (S, d) [m].
        energy: Of the best trajectory known [nats].
        log_z: Log evidence.
        error: Its standard error; 0 where it is exact.
        spread: Standard deviations of the positions, root mean square [m].
        warnings: Of the long run.
    """

    mean: Array
    energy: float
    log_z: float
    error: float
    spread: float
    warnings: tuple[str, ...]


def cases(short: bool, recorded: Path | None) -> Iterator[Case]:
    """All cases; `short` cuts the horizons, `recorded` is the folder of the recordings."""
    yield two_modes()
    paper = Scenario.load(ROOT / "data" / "scenarios" / "three_corridors_crowd.toml")
    yield of_scenario("three corridors, crowd", _cut(paper, 1.2) if short else paper, "B")
    if recorded is not None:
        case = next(c for c in recordings.load_cases(recorded) if c.tier in ("core", ""))
        scenario = recordings.scenario(recorded, case.identity, min(2.0, case.duration / 2))
        yield of_scenario("recorded crowd", _cut(scenario, 1.2) if short else scenario, None)


def two_modes() -> Case:
    """f^R ~ N(0, 1) in one dimension, a person held at 0 with h_c = 1 and alpha = 0.99."""
    prior = gaussian(np.zeros(1), np.eye(1))
    psi = PredictedPairs(Interaction(0.99, 1.0), np.zeros((1, 1)), robot_dim=1)
    terms = tuple(Term(n, r, (("robot", 0),), range(1)) for n, r in (("p", prior), ("psi", psi)))
    robot = Variable("robot", 1, keys.robot)
    assembly = Assembly([Model(np.zeros(1), (robot,), terms, (), {}, np.zeros((1, 1)))])
    starts = np.array([0.5, -0.5])[:, None, None]
    return _solved("two modes", assembly, 0, starts, slice(0, 1))


def of_scenario(name: str, scenario: Scenario, label: str | None) -> Case:
    """One hypothesis of a scenario: that of a label, or the first."""
    d = scenario.density
    belief = believe(seen(scenario), scenario.now, d.Qc_people, d.sigma_track, d.sigma_speed)
    hypotheses = hypothesise(scenario, belief)
    which = next((i for i, h in enumerate(hypotheses) if h.label == label), 0)
    assembly = Assembly(build(scenario, belief, hypotheses))
    model = assembly.models[which]
    starts = np.stack([model.initial(start) for start in hypotheses[which].starts])
    first = model.columns["robot"].start
    return _solved(name, assembly, which, starts, slice(first, first + 2))


def reference(case: Case, short: bool, progress: Progress | None = None) -> Reference:
    """The grid in one dimension; else a long run of HMC."""
    if case.assembly.dimension == 1:
        return _exact(case)
    method = HMC(draws=200, warmup=100) if short else HMC(chains=24, draws=500)
    result = method.infer(case.assembly, case.which, case.optima, 0, progress)
    sd = np.sqrt(np.diag(result.covariance)).reshape(result.mean.shape)[:, case.plane]
    return Reference(
        result.mean[:, case.plane],
        min(o.energy for o in case.optima),
        float(result.log_evidence or np.nan),
        float(result.log_evidence_error or np.nan),
        float(np.sqrt(np.mean(sd**2))),
        result.warnings,
    )


def _exact(case: Case) -> Reference:
    x = np.linspace(-12, 12, 200_001)
    log_p = -case.assembly.energy(x[:, None, None], np.asarray(case.which))
    log_p += case.assembly.models[case.which].log_normalizer
    p = np.exp(log_p) * (x[1] - x[0])
    Z = p.sum()
    spread = float(np.sqrt((p * x**2).sum() / Z))
    energy = min(o.energy for o in case.optima)
    return Reference(np.zeros((1, 1)), energy, float(np.log(Z)), 0.0, spread, ())


def _solved(name: str, assembly: Assembly, which: int, starts: Array, plane: slice) -> Case:
    began = process_time()
    found = SecondOrder().solve(assembly, starts, np.full(len(starts), which))
    took = process_time() - began
    ended = sorted((s for s in found if s.converged), key=lambda s: s.energy)
    return Case(name, assembly, which, tuple(distinct(ended)), took, plane)


def _cut(scenario: Scenario, horizon: float) -> Scenario:
    return scenario.replace(density=replace(scenario.density, horizon=horizon))
