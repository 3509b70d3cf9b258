"""Missions in closed loop among people: is what is asked done, or its failure reported?

A run is judged by where the robot's centre was, by the definition of satisfaction
(`fgplan.mission.satisfies`), which shares no code with the planner's automaton.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from fgplan.driving import Outcome
from fgplan.labels import AT_ONCE
from fgplan.mission import Mission
from fgplan.regions import word_along
from fgplan.scenario import Scenario
from fgplan.simulation import metrics
from fgplan.simulation.batch import Job, run_all
from fgplan.simulation.episode import Episode
from fgplan.simulation.errand import State
from fgplan.simulation.file import FromFile

Row = dict[str, Any]

DATA = Path(__file__).parents[2] / "data" / "scenarios"
CHANGES = (("world.period", "0.2"), ("plans.count", "2"))
"""Of the files: a run costs half as much."""
FAILURES = (Outcome.NO_VALID_PATH, Outcome.NO_VALID_CONTROL, Outcome.NO_PROGRESS, Outcome.STOPPED)
"""What a planner says when it cannot go on."""


def runs(
    name: str, seeds: Sequence[int], store: Path | None, progress: Callable[..., None] | None = None
) -> list[Row]:
    """One row a seed of a scenario file with a mission.

    Args:
        name: Of the file, without its ending.
        seeds: Of the worlds.
        store: Finished runs, which are not made again.
        progress: Told how many are done.
    """
    setup = FromFile(DATA / f"{name}.toml", CHANGES)
    jobs = [Job(setup, name, "fgplan", seed) for seed in seeds]
    asked = Scenario.load(DATA / f"{name}.toml")
    return run_all(jobs, store=store, measure=partial(measured, asked), progress=progress)


def measured(asked: Scenario, episode: Episode) -> Row:
    """The numbers of every run, and those of its mission.

    Args:
        asked: With the mission and its regions.
        episode: What happened.
    """
    last = episode.outcomes[-1] if episode.outcomes else None
    claims = last is Outcome.GOAL_REACHED
    satisfied = episode.mission is State.SATISFIED
    reported = not satisfied and not claims and (last in FAILURES or bool(episode.error))
    return {
        **metrics.row(episode),
        "satisfied": satisfied,
        "claims": claims,
        "reported": reported,
        "last": "" if last is None else str(last),
        "headed_back": headed_back(asked, episode),
        "word": [sorted(letter) for letter in episode.word],
    }


def headed_back(asked: Scenario, episode: Episode) -> int:
    """Steps in which the robot followed a plan to a stop at which its mission had moved on
    before; for missions that ask for no place twice."""
    mission = asked.mission
    assert mission is not None
    regions = [r for r in asked.regions if r.name in mission.atoms]
    met: set[str] = set()
    count = 0
    steps = zip(episode.labels, episode.robot[:-1, :2], episode.robot[1:, :2], strict=True)
    for label, before, now in steps:
        if label is not None and met & set(label.split()[0].split(AT_ONCE)):
            count += 1
        for letter in word_along(regions, [before, now]):
            mission, was = mission.advance(letter), mission
            met |= _moved_at(was, mission, letter)
    return count


def _moved_at(was: Mission, now: Mission, letter: frozenset[str]) -> set[str]:
    return set() if was.remaining == now.remaining or not was.trace else set(letter)


def summary(rows: Sequence[Row]) -> Row:
    """What the runs of one scenario come to."""
    done = [r for r in rows if r["satisfied"]]
    times = [r["time"] for r in done if r["time"] is not None]
    return {
        "scenario": rows[0]["scenario"],
        "runs": len(rows),
        "satisfied": len(done),
        "reported": sum(r["reported"] for r in rows),
        "neither": sum(not r["satisfied"] and not r["reported"] for r in rows),
        "false_claims": sum(r["claims"] and not r["satisfied"] for r in rows),
        "headed_back": sum(r["headed_back"] > 0 for r in rows),
        "contacts": sum(r["collisions"] > 0 for r in rows),
        "time_mean": sum(times) / len(times) if times else None,
    }
