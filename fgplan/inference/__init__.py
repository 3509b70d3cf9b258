"""Inference on the joint density of one hypothesis: one interface, one file a method.

`fgplan.plan(..., inference=...)` takes any of them; see `docs/inference.md` for which one when.
"""

from fgplan.inference.base import Diagnostics, Inference, Inferred, Progress, probabilities
from fgplan.inference.hmc import HMC
from fgplan.inference.importance import Importance
from fgplan.inference.laplace import Laplace
from fgplan.inference.map import MAP
from fgplan.inference.mcmc import EllipticalSlice

__all__ = [
    "HMC",
    "MAP",
    "Diagnostics",
    "EllipticalSlice",
    "Importance",
    "Inference",
    "Inferred",
    "Laplace",
    "Progress",
    "probabilities",
]
