"""Recorded people: the robot takes the place of one of them, the others walk as they did.

The robot sees annotations when their time has come, and never what was interpolated between an
annotation and the next: that would tell it the future.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgplan.driving import Detection
from fgplan.errors import Mistake, ScenarioError
from fgplan.recordings import LONGEST_GAP, RADIUS, Case, Recording, load_cases
from fgplan.scenario import Level
from fgplan.simulation.body import Body, Limits
from fgplan.simulation.episode import Episode
from fgplan.simulation.metrics import row
from fgplan.simulation.people import Disc, People
from fgplan.simulation.world import Rules, Seen, World

Array = NDArray[np.float64]

PERIOD = 0.1
TOLERANCE = 0.3
"""The robot drives until it is this near the goal [m]; who evaluates may be content earlier."""
TIME_FACTOR, TIME_EXTRA = 2.0, 5.0
"""A run is cut at this many times what the person took, and so many seconds more."""


ACCELERATION = 5.0
"""The base takes every velocity at once; more than this is no walking [m/s²]."""
DENSITY = {
    "dt": 0.25,
    "horizon": 5.0,
    "Qc_robot": 4.0,
    "t_ref": 0.25,
    "contact_margin": 0.5,
    "contact_sigma": 0.09,
    "alpha": 0.8,
}
"""What differs from the defaults; chosen on the cases of `seq_eth`."""
CLEARANCE = 0.4
"""That the guard asks of a plan [m], of the 0.5 m that the density asks for; chosen likewise."""


class Replay:
    """The people of a recording, who notice no robot.

    Args:
        recording: Whose.
        case: Names the person who is replaced, and the start.
        until: How long the run may last [s].
    """

    def __init__(self, recording: Recording, case: Case, until: float) -> None:
        start, end = case.start_time, case.start_time + until
        self.rows = {
            agent: rows
            for agent, rows in recording.tracks.items()
            if agent != case.agent and rows[0, 0] <= end and rows[-1, 0] >= start - PERIOD
        }
        self.time = start
        count = len(self.rows)
        self.names = [f"p{agent}" for agent in self.rows]
        self.radii = np.full(count, RADIUS)
        self.positions = np.zeros((count, 2))
        self.velocities = np.zeros((count, 2))
        self.present = np.zeros(count, dtype=bool)
        self._place()

    def advance(self, dt: float, robot: Disc | None) -> None:
        before, there = self.positions, self.present
        self.time += dt
        self._place()
        still = (there & self.present)[:, None]
        self.velocities = np.where(still, (self.positions - before) / dt, 0.0)

    def _place(self) -> None:
        now = self.time
        positions, present = np.zeros_like(self.positions), np.zeros_like(self.present)
        for i, rows in enumerate(self.rows.values()):
            times = rows[:, 0]
            # 1e-6: a sum of decimal times must meet the annotations' own decimals.
            if not times[0] - 1e-6 <= now <= times[-1] + 1e-6:
                continue
            after = min(int(np.searchsorted(times, now - 1e-6)), len(times) - 1)
            before = max(after - 1, 0)
            gap = times[after] - times[before]
            if gap > LONGEST_GAP and abs(times[after] - now) > 1e-6:
                continue
            share = 1.0 if gap == 0 else min((now - times[before]) / gap, 1.0)
            positions[i] = rows[before, 1:] + share * (rows[after, 1:] - rows[before, 1:])
            present[i] = True
        self.positions, self.present = positions, present


class Annotations:
    """Sees the annotations since the last look, and nothing (None) where there are none.

    Args:
        people: Of the same run.
    """

    def __init__(self, people: Replay) -> None:
        self._people = people
        self._times = np.concatenate([rows[:, 0] for rows in people.rows.values()] or [np.zeros(0)])
        self._seen = -np.inf

    def __call__(self, time: float, body: Body, people: People) -> Seen:
        last, self._seen = max(self._seen, time - PERIOD), time
        if not np.any((self._times > last + 1e-6) & (self._times <= time + 1e-6)):
            return Seen(None)
        found = []
        for name, rows in zip(self._people.names, self._people.rows.values(), strict=True):
            index = int(np.searchsorted(rows[:, 0], time + 1e-6)) - 1
            if index >= 0 and rows[index, 0] > last + 1e-6:
                found.append(Detection(rows[index, 1:], name, RADIUS))
        return Seen(tuple(found))


@dataclass(frozen=True)
class Recorded:
    """Makes the worlds of recorded cases.

    Args:
        folder: Of the recordings.
        tier: Stratum of the cases; None takes all.
    """

    folder: Path
    tier: str | None = None

    @property
    def cases(self) -> tuple[Case, ...]:
        """A seed is the index of one.

        Raises:
            ScenarioError: the folder holds no recordings, or none of the tier.
        """
        return _cases(self.folder, self.tier)

    def __call__(self, seed: int) -> World:
        """The world of a case; the base takes every velocity at once, as that of a person."""
        case = self.cases[seed]
        recording = _recording(self.folder, case.recording)
        scenario = recording.scenario(case).replace(crowd="predicted")
        robot = replace(scenario.robot, max_acceleration=ACCELERATION)
        scenario = scenario.replace(
            robot=robot,
            goal_speed=robot.preferred_speed,
            count=1,
            levels=(Level(h=1.0),),
            density=replace(scenario.density, **DENSITY),
        )
        limit = TIME_FACTOR * case.duration + TIME_EXTRA
        people = Replay(recording, case, limit)
        return World(
            name=case.identity,
            scenario=scenario,
            people=people,
            sensor=Annotations(people),
            limits=Limits(scenario.robot.max_speed),
            rules=Rules(
                period=PERIOD,
                substeps=1,
                time_limit=limit,
                tolerance=TOLERANCE,
                clearance=CLEARANCE,
                seen_by_people=False,
                slows_down=False,
            ),
        )


def measure(episode: Episode) -> dict[str, Any]:
    """The numbers of a run, and its way: rows (t, x, y) [s, m]."""
    way = np.column_stack([episode.times, episode.robot[:, :2]])
    return {**row(episode), "way": np.round(way, 4).tolist()}


def table(rows: Sequence[dict[str, Any]]) -> str:
    """What the recordings' own evaluation reads: CSV with case_id, t, x, y."""
    lines = ["case_id,t,x,y"]
    for run in rows:
        lines += [f"{run['world']},{t:.3f},{x:.4f},{y:.4f}" for t, x, y in run["way"]]
    return "\n".join(lines)


@lru_cache(maxsize=4)
def _cases(folder: Path, tier: str | None) -> tuple[Case, ...]:
    every = load_cases(folder)
    cases = tuple(case for case in every if tier in (None, case.tier))
    if not cases:
        tiers = ", ".join(sorted({case.tier for case in every}))
        mistake = Mistake("tier", tier, f"names no case; the tiers here are {tiers}")
        raise ScenarioError(str(folder), (mistake,))
    return cases


@lru_cache(maxsize=16)
def _recording(folder: Path, name: str) -> Recording:
    return Recording.load(folder, name)
