"""How much probability lies around a local optimum."""

from __future__ import annotations

import numpy as np

from fgplan.assembly import Assembly
from fgplan.solver import Solution, factor_hessian


def laplace(assembly: Assembly, solution: Solution, which: int) -> float | None:
    r"""log Z by Laplace's method with the true Hessian H of −log p.

    log Z = log p(x*) + (d/2) log 2π − ½ log det H, with every Gaussian density normalised: 0 when
    there are no potentials. The Gauss–Newton Hessian would misrank hypotheses by more than a nat.

    Args:
        assembly: The density.
        solution: A local optimum.
        which: Its hypothesis.

    Returns:
        The log evidence of this one mode; None where the Hessian is not positive definite, which
        is to say where the point is not a minimum.
    """
    factor = factor_hessian(assembly, solution.state, which)
    if factor is None:
        return None
    log_density = assembly.models[which].log_normalizer - solution.energy
    volume = 0.5 * assembly.dimension * np.log(2 * np.pi) - 0.5 * factor.log_determinant
    return float(log_density + volume)
