"""What commands say on a terminal: errors, progress, files."""

from __future__ import annotations

import sys
import tempfile
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


def file_of(json_to: str | None) -> Path | None:
    """The file that --json names; None where it names none: standard output, or nothing."""
    return None if json_to in (None, "-") else Path(str(json_to))


def expect(path: Path | None, *suffixes: str) -> None:
    """Refuse, before any work, a file that could not be written after it; nothing is made yet.

    Args:
        path: Of the file; None: there will be none.
        suffixes: Those that can be written; none: all.
    """
    if path is None:
        return
    if suffixes and path.suffix.lower() not in suffixes:
        fail(f"{path}: got {path.suffix or 'no suffix'!r}; can write {', '.join(suffixes)}")
    try:
        if path.is_file():
            path.open("ab").close()
        elif path.is_dir():
            fail(f"{path} cannot be written: it is a folder; name a file")
        elif not path.exists():  # what is no file either, a pipe say, is opened once only
            folder = next(above for above in path.absolute().parents if above.exists())
            tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        fail(f"{path} cannot be written: {error.strerror}; name another place")


def write(path: Path, text: str) -> Path:
    """Write a file, and the folders above it."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        fail(f"{path} cannot be written: {error}")
    return path
