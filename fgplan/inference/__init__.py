"""Inference on the joint density of one hypothesis: one interface, one file a method.

`fgplan.plan(..., inference=...)` takes any of them; see `docs/inference.md` for which one when.
"""

from fgplan.inference.base import Diagnostics, Inference, Inferred, Progress, probabilities
from fgplan.inference.hmc import HMC
from fgplan.inference.importance import Importance
from fgplan.inference.laplace import Laplace
from fgplan.inference.map import MAP
from fgplan.inference.mcmc import EllipticalSlice

METHODS: dict[str, Inference] = {
    method.name: method for method in (MAP(), Laplace(), Importance(), EllipticalSlice(), HMC())
}
"""All methods with their default settings, by the name that the command line knows them by."""


def named(inference: Inference | str) -> Inference:
    """The method itself, or that of a name in `METHODS`.

    Raises:
        ValueError: no method has that name.
    """
    if not isinstance(inference, str):
        return inference
    if inference not in METHODS:
        raise ValueError(f"inference must be one of {', '.join(METHODS)}, got {inference!r}")
    return METHODS[inference]


__all__ = [
    "HMC",
    "MAP",
    "METHODS",
    "Diagnostics",
    "EllipticalSlice",
    "Importance",
    "Inference",
    "Inferred",
    "Laplace",
    "Progress",
    "named",
    "probabilities",
]
