"""How kernels are compiled: once a machine, and kept beside the source or in the user's cache.

Kernels that are called from Python state their arguments: they are compiled, or loaded, where they
are imported, and not later, when there may be no time for it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import cache
from typing import Any, Protocol, TypeVar

import numpy as np
from numba import njit, types
from numba.core.compiler import Compiler
from numba.extending import register_jitable

F = TypeVar("F", bound=Callable[..., Any])
INT, FLOAT, BOOL = types.intp, types.float64, types.boolean
REORDERED = {"contract", "reassoc", "nsz", "arcp"}
"""What may be done to sums and products: NaN and inf still count."""


REGISTER = 8
"""Numbers that a register holds at most; the memory of as many is read at once."""


class Decorator(Protocol):
    """From a function to its compiled form."""

    def __call__(self, function: F, /) -> F: ...


def given(dimensions: int, of: Any = FLOAT) -> Any:
    """An array that is read, of any layout."""
    return types.Array(of, dimensions, "A", readonly=True)


def packed(dimensions: int, of: Any = FLOAT) -> Any:
    """A contiguous array that is read: whole registers at a time."""
    return types.Array(of, dimensions, "C", readonly=True)


def result(dimensions: int, of: Any = FLOAT) -> Any:
    """A contiguous array that is written."""
    return types.Array(of, dimensions, "C")


def exact(*arguments: Any) -> Decorator:
    """Compile as written: what is not a number stays what it is, and dividing by 0 is inf.

    Args:
        arguments: Types of the arguments; none for a kernel that others call.
    """
    return _compiled(arguments, False)


def reordered(*arguments: Any) -> Decorator:
    """The same with sums in any order, so that they are vectorised."""
    return _compiled(arguments, REORDERED)


def apart() -> Decorator:
    """The same for a kernel that others call, no two of whose arrays share memory that is written:
    otherwise every loop begins with finding out whether they do."""
    return _compiled((), REORDERED, pipeline_class=_Apart)


class _Apart(Compiler):  # type: ignore[misc]
    """numba's compiler with a flag that `njit` does not offer."""

    def define_pipelines(self) -> Any:
        self.state.flags.noalias = True
        return super().define_pipelines()


def _compiled(arguments: tuple[Any, ...], fastmath: Any, **more: Any) -> Decorator:
    options = {"error_model": "numpy", "fastmath": fastmath, **more}
    if not arguments:
        inner: Decorator = njit(**options)
        return inner

    def outer(function: F) -> F:
        signature = types.void(*arguments)
        try:
            kept: F = njit(signature, cache=True, **options)(function)
        except RuntimeError:  # there is nowhere to keep it
            kept = njit(signature, **options)(function)
        if kept.stats.cache_misses or not kept.stats.cache_path:  # type: ignore[attr-defined]
            _tell()
        return kept

    return outer


@cache
def _tell() -> None:
    """Say once why the first process waits."""
    logging.getLogger("fgplan").warning(
        "compiling kernels: some 15 s, once a machine where they can be kept"
    )


@register_jitable  # type: ignore[untyped-decorator]
def room(shape: tuple[int, ...]) -> Any:
    """An array that is not written yet and begins where a register's load does."""
    size = 1
    for length in shape:
        size *= length
    numbers = np.empty(size + REGISTER)
    first = (-numbers.ctypes.data % (8 * REGISTER)) // 8
    return numbers[first : first + size].reshape(shape)
