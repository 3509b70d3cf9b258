"""The planar examples of GPMP2, built from fgplan's factors and optimised by GTSAM.

They are regression targets: the same graphs in GPMP2's own C++ give the same errors and
iterations. The python_point path starts exactly on lines of the distance grid and, at one state,
exactly on the hinge's threshold: Gauss-Newton's bad end there depends on the last bit of both.

Reference:
    Mukadam, Dong, Yan, Dellaert, Boots, "Continuous-time Gaussian process motion planning via
    probabilistic inference", IJRR 2018; its examples PointRobot2DFactorGraphExample (MATLAB) and
    pointRobot2FactorExample (Python).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from factors.distance_field import Outside, SignedDistanceField
from factors.gp_prior import GPPrior, gaussian
from factors.obstacle import InterpolatedObstacle, Obstacle

Array = NDArray[np.float64]

RADIUS = 1.5  # of the robot [m]
PRIOR_SIGMA = 1e-4  # of start and end [m, m/s]
DENSE = 50  # points an interval for the clearance


@dataclass(frozen=True)
class Case:
    """One of GPMP2's planar examples.

    Args:
        name: Of the case.
        start, end: Positions [m]; the robot stands still at both.
        duration: [s].
        intervals: Number of intervals between states.
        checks: Interpolated obstacle checks of an interval, as fractions of it.
        sigma: Of the obstacle hinge [m].
        margin: ε of the obstacle hinge [m].
        optimizers: What the example was run with.
    """

    name: str
    start: tuple[float, float]
    end: tuple[float, float]
    duration: float
    intervals: int
    checks: tuple[float, ...]
    sigma: float
    margin: float
    optimizers: tuple[str, ...]

    @property
    def dt(self) -> float:
        """Time between two states [s]."""
        return self.duration / self.intervals


CASES = (
    Case(
        "matlab_point",
        start=(-15, -8),
        end=(17, 14),
        duration=5,
        intervals=10,
        checks=(0.2, 0.4, 0.6, 0.8),
        sigma=0.3,
        margin=2,
        optimizers=("GaussNewton",),
    ),
    Case(
        "python_point",
        start=(0, 0),
        end=(17, 14),
        duration=10,
        intervals=20,
        checks=(0.5,),  # GPMP2's own script puts it at 0.4: its 50 checks do not divide by 20
        sigma=0.5,
        margin=4,
        optimizers=("Dogleg", "LevenbergMarquardt", "GaussNewton"),
    ),
)


@dataclass(frozen=True)
class Row:
    """One line of the table; errors are GTSAM's ½‖e‖², clearance is in metres."""

    case: str
    optimizer: str
    initial_error: float
    final_error: float
    iterations: int
    min_clearance: float


def run() -> Iterator[Row]:
    """Every case with every optimizer it is known for."""
    field = multi_obstacle_field()
    for case in CASES:
        for optimizer in case.optimizers:
            yield solve(case, optimizer, field)


def table() -> list[dict[str, Any]]:
    """`run` as plain numbers."""
    return [asdict(row) for row in run()]


def solve(case: Case, optimizer: str, field: SignedDistanceField) -> Row:
    """Optimise one case with GTSAM's optimizer of that name and its default parameters."""
    graph, initial = build(case, field)
    parameters = getattr(gtsam, f"{optimizer}Params")()
    solver = getattr(gtsam, f"{optimizer}Optimizer")(graph, initial, parameters)
    result = solver.optimize()
    states = np.array([result.atVector(k) for k in range(case.intervals + 1)])
    return Row(
        case.name,
        optimizer,
        float(graph.error(initial)),
        float(graph.error(result)),
        int(solver.iterations()),
        min_clearance(case, field, states),
    )


def build(
    case: Case, field: SignedDistanceField
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The factor graph and the straight line it starts from; state k has key k."""
    start, end = np.array(case.start, float), np.array(case.end, float)
    fixed = PRIOR_SIGMA**2 * np.eye(4)
    prior = GPPrior(case.dt, np.eye(2))
    hinge = (field, RADIUS, case.margin, case.sigma)
    at_state = Obstacle(*hinge)
    between = InterpolatedObstacle(*hinge, case.dt, case.checks, weight=len(case.checks))

    graph, initial = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(gaussian(np.append(start, [0, 0]), fixed).on(0))
    graph.push_back(gaussian(np.append(end, [0, 0]), fixed).on(case.intervals))
    for k in range(case.intervals):
        graph.push_back(prior.on(k, k + 1))
        graph.push_back(at_state.on(k + 1))  # none at the first state, which is given
        graph.push_back(between.on(k, k + 1))
    velocity = end / case.duration  # as in GPMP2, although the start is not the origin
    N = case.intervals
    for k in range(N + 1):
        initial.insert(k, np.append(start * (N - k) / N + end * k / N, velocity))
    return graph, initial


def multi_obstacle_field() -> SignedDistanceField:
    """GPMP2's MultiObstacleDataset: 30 m × 40 m, three rectangles, free outside."""
    occupied = np.zeros((300, 400), dtype=bool)
    occupied[165:234, 295:344] = True
    occupied[165:234, 80:179] = True
    occupied[25:74, 150:249] = True
    cell = 0.1
    values = cell * (distance_transform_edt(~occupied) - distance_transform_edt(occupied))
    return SignedDistanceField(values, np.array([-20.0, -10.0]), cell, outside=Outside.FREE)


def min_clearance(case: Case, field: SignedDistanceField, states: Array) -> float:
    """Smallest gap between the robot's edge and an obstacle along the trajectory [m]."""
    dense = InterpolatedObstacle(field, RADIUS, 0.0, 1.0, case.dt, DENSE)
    points = dense.points(states[:-1], states[1:]).reshape(-1, 2)
    along = np.concatenate([states[:, :2], points])
    return float(field.distance(along).min() - RADIUS)
