"""Many runs: side by side, resumable, and nothing is lost but what was running.

A finished run is one line of a file, written by whoever ran it, before anybody hears of it. So a
kill costs the running episodes only, and the next start skips all that are in the file. Workers of
a cluster need a disk that all of them see; what is not in the file when it comes back is added.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from fgplan.errors import FgplanError
from fgplan.inference.base import Progress
from fgplan.simulation import metrics
from fgplan.simulation.episode import Episode, run
from fgplan.simulation.extra import needed
from fgplan.simulation.planners import named
from fgplan.simulation.world import Setup

ANSWER = 10.0
"""A scheduler must answer within this time [s]."""

Row = dict[str, Any]
Measure = Callable[[Episode], Row]


class NoScheduler(FgplanError, OSError):
    """No dask scheduler answers at an address."""


class BadStore(FgplanError, ValueError):
    """A file of results that cannot be read."""


class SameKey(FgplanError, ValueError):
    """Two jobs whose runs nobody could tell apart."""


@dataclass(frozen=True)
class Job:
    """One run to be made.

    Args:
        setup: Makes the world; must be picklable where runs are made side by side.
        scenario: Name of the setup in tables.
        planner: By name.
        seed: Of the world.
        version: Of the setup: a run of another one by the same key is not this one. "" is of any.
    """

    setup: Setup
    scenario: str
    planner: str
    seed: int
    version: str = ""

    @property
    def key(self) -> str:
        """What a finished run is known by."""
        return f"{self.scenario} {self.planner} {self.seed}"


def play(job: Job, measure: Measure = metrics.row, store: Path | None = None) -> Row:
    """Make one run, note it in the store, and return it."""
    world = job.setup(job.seed)
    episode = run(world, named(job.planner)(world))
    row = {
        "key": job.key,
        "scenario": job.scenario,
        "planner": job.planner,
        "seed": job.seed,
        "version": job.version,
        **measure(episode),
    }
    if store is not None:
        _append(store, row)
    return row


def run_all(
    jobs: Sequence[Job],
    executor: Executor | None = None,
    store: Path | None = None,
    measure: Measure = metrics.row,
    progress: Progress | None = None,
) -> list[Row]:
    """Rows of all jobs, in their order.

    Args:
        jobs: With different keys.
        executor: What runs them; None runs one after the other here.
        store: File of finished runs, one JSON object a line; those in it are not run again.
        measure: What to keep of a run.
        progress: Told how many are done.

    Raises:
        SameKey: two jobs have the same key; nothing was run.
        BadStore: the file cannot be read, or a run in it is of another version of its world.
    """
    twice = [key for key, count in Counter(job.key for job in jobs).items() if count > 1]
    if twice:
        raise SameKey(
            f"jobs: got {len(twice)} more than once, the first is {twice[0]!r}; a run is known by "
            "scenario, planner and seed: name each planner once, and give files other names"
        )
    rows = {} if store is None else read(store, mend=True)
    for job in jobs:
        before = rows.get(job.key, {}).get("version", "")
        if job.version and before and job.version != before:
            raise BadStore(
                f"{store}: run {job.key!r} is of another version of its world, {before}, than that "
                f"of now, {job.version}; name a new file, or put the world back as it was"
            )
    waiting = [job for job in jobs if job.key not in rows]
    task = partial(play, measure=measure, store=store)
    done = map(task, waiting) if executor is None else executor.map(task, waiting)
    for count, row in enumerate(done, start=len(jobs) - len(waiting) + 1):
        rows[row["key"]] = row
        if progress is not None:
            progress("episodes", count, len(jobs))
    if store is not None:
        known = read(store)
        for job in waiting:
            if job.key not in known:
                _append(store, rows[job.key])
    return [rows[job.key] for job in jobs]


def read(store: Path, mend: bool = False) -> dict[str, Row]:
    """Finished runs by key.

    Args:
        store: The file; where there is none, no run is finished.
        mend: Cut off a last line that was killed while it was written.

    Raises:
        BadStore: a line is not such a run.
    """
    if not store.exists():
        return {}
    text = store.read_bytes()
    whole = text[: text.rfind(b"\n") + 1]
    if mend and len(whole) < len(text):
        os.truncate(store, len(whole))
    rows: dict[str, Row] = {}
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            row = json.loads(line)
            rows[row["key"]] = row
        except (ValueError, TypeError, KeyError) as error:
            raise BadStore(
                f"{store}, line {number}: got {line[:60]!r}; a line is one finished run as JSON "
                f"({error!r}); name a file of this command, or a new one"
            ) from error
    return rows


@contextmanager
def local(workers: int) -> Iterator[Executor | None]:
    """This machine; one worker needs no other process."""
    if workers == 1:
        yield None
        return
    # A fresh interpreter each, with one thread: runs side by side must not share theirs.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """The workers of a dask scheduler (extra `[cluster]`).

    Raises:
        MissingExtra: dask's `distributed` is not installed.
        NoScheduler: no scheduler answers there.
    """
    distributed = needed("distributed", "cluster")
    try:
        client = distributed.Client(address, timeout=ANSWER)
    except (OSError, ValueError) as error:
        raise NoScheduler(
            f"scheduler: got {address!r}; give the address of a dask scheduler that runs, such as "
            f"tcp://127.0.0.1:8786 ({error})"
        ) from error
    try:
        yield client.get_executor(pure=False)
    finally:
        client.close()


def _append(store: Path, row: Row) -> None:
    """One line in one write, so that lines of several processes do not mix."""
    line = json.dumps(row, allow_nan=False) + "\n"
    store.parent.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(store, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        os.write(descriptor, line.encode())
    finally:
        os.close(descriptor)
