"""Many runs: resumable, and the same wherever they are made."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fgplan.simulation.batch import BadStore, Job, SameKey, cluster, local, play, read, run_all
from fgplan.simulation.crowdnav import CrowdNav
from fgplan.simulation.world import World

TIMES = ("step_ms_p50", "step_ms_p95", "step_ms_p99")


class Counted:
    """CrowdNav that counts how many worlds it made."""

    def __init__(self) -> None:
        self.made: list[int] = []

    def __call__(self, seed: int) -> World:
        self.made.append(seed)
        return CrowdNav()(seed)


def jobs(setup: Any, count: int = 4) -> list[Job]:
    return [Job(setup, "circle", "straight", seed) for seed in range(count)]


def without_times(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{k: v for k, v in row.items() if k not in TIMES} for row in rows]


def test_a_run_of_another_version_of_its_world_is_not_taken_for_this_one(tmp_path):
    store = tmp_path / "runs.jsonl"
    of = [replace(job, version="1") for job in jobs(CrowdNav(), 1)]
    rows = run_all(of, store=store)
    assert run_all(of, store=store) == rows
    before = store.read_bytes()
    with pytest.raises(BadStore, match=r"runs\.jsonl: run 'circle straight 0' .*, 1, .* now, 2;"):
        run_all([replace(job, version="2") for job in of], store=store)
    assert store.read_bytes() == before


def test_side_by_side_is_the_same_as_one_after_the_other() -> None:
    alone = run_all(jobs(CrowdNav()))
    with ThreadPoolExecutor(3) as pool:
        together = run_all(jobs(CrowdNav()), pool)
    assert without_times(alone) == without_times(together)
    assert [row["seed"] for row in alone] == [0, 1, 2, 3]


def test_finished_runs_are_not_run_again(tmp_path: Path) -> None:
    store, told = tmp_path / "runs.jsonl", []
    first = run_all(jobs(CrowdNav(), 2), store=store)
    setup = Counted()
    rows = run_all(jobs(setup), store=store, progress=lambda *what: told.append(what))
    assert setup.made == [2, 3]
    assert rows[:2] == first
    assert told == [("episodes", 3, 4), ("episodes", 4, 4)]
    assert run_all(jobs(setup), store=store) == rows
    assert setup.made == [2, 3]


def test_a_kill_loses_what_was_running_alone(tmp_path: Path) -> None:
    """The worker itself writes: when a later run dies, those before are in the file."""

    def setup(seed: int) -> World:
        if seed == 2:
            raise KeyboardInterrupt
        return CrowdNav()(seed)

    store = tmp_path / "runs.jsonl"
    with pytest.raises(KeyboardInterrupt):
        run_all(jobs(setup), store=store)
    assert {row["seed"] for row in read(store).values()} == {0, 1}


def test_a_line_cut_off_in_the_middle_is_run_again(tmp_path: Path) -> None:
    store = tmp_path / "runs.jsonl"
    rows = run_all(jobs(CrowdNav(), 2), store=store)
    store.write_bytes(store.read_bytes()[:-40])
    again = run_all(jobs(CrowdNav(), 2), store=store)
    assert without_times(again) == without_times(rows)
    assert [json.loads(line)["seed"] for line in store.read_text().splitlines()] == [0, 1]


def test_a_file_of_something_else_is_refused(tmp_path: Path) -> None:
    store = tmp_path / "notes.txt"
    store.write_text("shopping\n")
    with pytest.raises(BadStore, match=r"notes.txt, line 1: got b'shopping'"):
        run_all(jobs(CrowdNav(), 1), store=store)


def test_jobs_that_cannot_be_told_apart_are_refused_before_any_run() -> None:
    setup = Counted()
    with pytest.raises(SameKey, match=r"got 2 more than once, the first is 'circle straight 0'"):
        run_all([*jobs(setup, 2), *jobs(CrowdNav(5, "square"), 3)])
    assert setup.made == []


def test_results_of_workers_without_the_disk_are_added(tmp_path: Path) -> None:
    class Far(ThreadPoolExecutor):
        """Workers on another machine, whose files nobody here sees."""

        def map(self, task: Any, *jobs: Any, **_: Any) -> Any:  # type: ignore[override]
            return (play(job) for job in jobs[0])

    store = tmp_path / "runs.jsonl"
    with Far() as pool:
        run_all(jobs(CrowdNav(), 2), pool, store)
    assert len(read(store)) == 2


def test_a_dask_cluster_gives_the_same(tmp_path: Path) -> None:
    from distributed import LocalCluster

    store = tmp_path / "runs.jsonl"
    with (
        LocalCluster(1, threads_per_worker=1, processes=False, dashboard_address=":0") as machines,
        cluster(machines.scheduler_address) as executor,
    ):
        rows = run_all(jobs(CrowdNav(), 2), executor, store)
    assert without_times(rows) == without_times(run_all(jobs(CrowdNav(), 2)))
    assert len(read(store)) == 2


def test_processes_of_this_machine_give_the_same() -> None:
    with local(2) as executor:
        rows = run_all(jobs(CrowdNav(), 2), executor)
    assert without_times(rows) == without_times(run_all(jobs(CrowdNav(), 2)))
