"""The most probable trajectory alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fgplan.assembly import Assembly
from fgplan.inference.base import Diagnostics, Inferred, Progress, Seed
from fgplan.solver import Solution


@dataclass(frozen=True)
class MAP:
    """The best local optimum that Levenberg–Marquardt found: a point, without evidence."""

    name: str = "map"

    def infer(
        self,
        assembly: Assembly,
        which: int,
        optima: Sequence[Solution],
        seed: Seed = 0,
        progress: Progress | None = None,
    ) -> Inferred:
        best = min(optima, key=lambda o: o.energy)
        warnings = []
        if not best.converged:
            warnings.append(f"not a local optimum: {best.stop.value}")
        if len(optima) > 1:
            warnings.append(f"one mode of {len(optima)}")
        return Inferred(
            method=self.name,
            states=best.state[None],
            weights=np.ones(1),
            energies=np.array([best.energy]),
            log_evidence=None,
            log_evidence_error=None,
            diagnostics=Diagnostics(draws=1),
            warnings=tuple(warnings),
            model=assembly.models[which],
        )
