"""What is inferred: the density of one hypothesis, within what the robot can do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fgplan.assembly import Assembly
from fgplan.solver import Solution

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Posterior:
    """The density of one hypothesis as it is sampled: 0 where the robot would break a limit.

    An optimum leans on the hinges of the limits, which begin below them, and the hard check refuses
    what goes beyond. A sample is held to the same: `Model.within`.

    Args:
        assembly: The density.
        which: The hypothesis.
        optima: Its distinct local optima, at least one.
    """

    assembly: Assembly
    which: int
    optima: Sequence[Solution]

    @cached_property
    def keeping(self) -> NDArray[np.bool_]:
        """Which optima break no limit."""
        within = self.assembly.models[self.which].within
        if within is None:
            return np.ones(len(self.optima), dtype=bool)
        return within(self._robot(np.stack([o.state for o in self.optima])))

    @cached_property
    def bounded(self) -> bool:
        """Whether limits are bounds. Where every optimum breaks one they are hinges alone, so that
        something can be said of a hypothesis that the hard check refuses anyway."""
        return self.assembly.models[self.which].within is not None and bool(self.keeping.any())

    @property
    def warnings(self) -> tuple[str, ...]:
        """Where limits are not kept."""
        if self.keeping.any():
            return ()
        return ("no optimum keeps the robot's limits: samples may break them, too",)

    @property
    def log_normalizer(self) -> float:
        """Of the Gaussian densities in the product."""
        return self.assembly.models[self.which].log_normalizer

    @property
    def best(self) -> Solution:
        """The optimum of the lowest energy."""
        return min(self.optima, key=lambda o: o.energy)

    def energy(self, X: Array) -> Array:
        """−log of the unnormalised density at states (N, S, D), shape (N,) [nats]; inf where it
        is 0 or not finite."""
        energy = self.assembly.energy(X, np.asarray(self.which))
        return np.where(np.isfinite(energy) & self.allows(X), energy, np.inf)

    def allows(self, X: Array) -> NDArray[np.bool_]:
        """Which states (N, S, D) break no limit, shape (N,)."""
        within = self.assembly.models[self.which].within
        if within is None or not self.bounded:
            return np.ones(len(X), dtype=bool)
        with np.errstate(all="ignore"):  # where a path ends that diverged
            return within(self._robot(X))

    def slope(self, X: Array) -> tuple[Array, Array]:
        """Energy (N,) and its gradient (N, S, D), limits seen as hinges alone."""
        with np.errstate(all="ignore"):  # a path that diverges is refused, not reported
            q = self.assembly.gauss_newton(X, np.full(len(X), self.which))
        energy = np.where(np.isfinite(q.energy), q.energy, np.inf)
        return energy, np.where(np.isfinite(q.gradient), q.gradient, 0.0)

    def _robot(self, X: Array) -> Array:
        return np.asarray(X[..., self.assembly.models[self.which].columns["robot"]])
