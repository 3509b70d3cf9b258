"""What commands say on a terminal: errors, progress, files."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import typer

from fgplan.errors import FgplanError, NoPlan
from fgplan.inference import Progress

if TYPE_CHECKING:
    from rich.progress import TaskID


@contextmanager
def reported() -> Iterator[None]:
    """Errors of the input, or of the search, in words; anything else keeps its traceback."""
    try:
        yield
    except FgplanError as error:
        fail(str(error), 1 if isinstance(error, NoPlan) else 2)


@contextmanager
def progress() -> Iterator[Progress]:
    """A bar on a terminal's standard error for what takes long; it goes when all is done."""
    from rich.console import Console
    from rich.progress import Progress as Bars

    console = Console(stderr=True)
    with Bars(console=console, transient=True, disable=not console.is_terminal) as bars:
        tasks: dict[str, TaskID] = {}

        def tell(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=total)
            bars.update(tasks[what], completed=done, visible=done < total)

        yield tell


def fail(message: str, code: int = 2) -> NoReturn:
    """Say what is wrong, and end."""
    print(f"fgplan: {message}", file=sys.stderr)
    raise typer.Exit(code)


def write(path: Path, text: str) -> Path:
    """Write a file, and the folders above it."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        fail(f"{path} cannot be written: {error}")
    return path
