"""Packages that only a simulation needs."""

from __future__ import annotations

import importlib
from types import ModuleType

from fgplan.errors import FgplanError


class MissingExtra(FgplanError, ImportError):
    """A package that an extra installs is not there."""


def needed(module: str, extra: str = "sim") -> ModuleType:
    """Import a package of an extra.

    Raises:
        MissingExtra: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtra(
            f"{module} is not installed ({error}); in the folder of fgplan, "
            f"pip install -e '.[{extra}]'"
        ) from error
