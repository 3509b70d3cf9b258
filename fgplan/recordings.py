"""Recorded pedestrians as scenarios: the robot takes the place of one of them.

A folder of recordings holds `cases.csv` (one line a case: who is replaced, from where to where),
`tracks/NAME.csv` (columns time_s, agent_id, x, y; others are ignored) and `maps/NAME.yaml`, where
NAME is a case's `dataset`. All is in metres and seconds, times on the clock of `time_s`.

A scenario holds only what could be observed by its moment: nothing after `now` is looked at, and
the recorded velocities, which are central differences, are never read.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import believe
from fgplan.errors import MapError, Mistake, ScenarioError
from fgplan.occupancy import OccupancyGrid
from fgplan.scenario import Density, Robot, Scenario, Track

Array = NDArray[np.float64]

RADIUS = 0.2
"""Of the robot and of each person [m]: contact at 0.4 m between centres."""
LONGEST_GAP = 0.85
"""Detections further apart are two runs: between them the person was not followed [s]."""
PRESENT = 0.5
"""Who was last seen longer ago has left the picture [s]."""
SPEED_RESERVE = 1.3
"""The robot may be this much faster than the person it replaces was on average."""

_CASE_NUMBERS = (
    "agent_id",
    "start_time",
    "human_time",
    "start_x",
    "start_y",
    "v0x",
    "v0y",
    "goal_x",
    "goal_y",
    "human_speed",
)


@dataclass(frozen=True, eq=False)
class Case:
    """A recorded person whom the robot replaces.

    Args:
        identity: Name of the case.
        recording: Name of the recording that it is from.
        agent: The replaced person.
        start_time: On the recording's clock [s].
        duration: How long the person took [s].
        start: Where the person was at the start, (x, y, vx, vy) [m, m/s].
        goal: Where the person went, shape (2,) [m].
        speed: The person's mean speed [m/s].
        tier: The stratum it belongs to, "" where the file names none.
    """

    identity: str
    recording: str
    agent: int
    start_time: float
    duration: float
    start: Array
    goal: Array
    speed: float
    tier: str = ""


@dataclass(frozen=True, eq=False)
class Recording:
    """The people of one recording and its map.

    Args:
        name: Of the recording.
        tracks: Rows (t, x, y) of each person, shape (m, 3), times increasing [s, m].
        grid: The map; unknown cells are free.
    """

    name: str
    tracks: Mapping[int, Array]
    grid: OccupancyGrid

    @classmethod
    def load(cls, folder: str | Path, name: str) -> Recording:
        """Read the tracks and the map of one recording.

        Raises:
            ScenarioError: a file is missing or cannot be read.
        """
        folder = Path(folder)
        place = folder / "maps" / f"{name}.yaml"
        try:
            grid = OccupancyGrid.load(place)
        except MapError as error:
            raise _refusal(folder, f"maps/{name}.yaml", str(place), str(error)) from error
        # Large collections keep the tracks of one split apart, in a folder of their own.
        found = sorted((folder / "tracks").glob(f"**/{name}.csv"), key=lambda p: (len(p.parts), p))
        path = found[0] if found else folder / "tracks" / f"{name}.csv"
        return cls(name, _read_tracks(folder, path), grid)

    def scenario(self, case: Case, at: float = 0.0) -> Scenario:
        """What was known `at` seconds after the start of a case.

        Args:
            case: Of this recording.
            at: From 0 to the case's duration [s]. At 0 the robot has the case's start and
                velocity, later the posterior mean of the replaced person's own past.

        Raises:
            ScenarioError: `at` is outside the case, or the replaced person is not in the
                recording by then.
        """
        source = f"case {case.identity}"
        if not 0 <= at <= case.duration:
            mend = f"give a time from 0 to the case's {case.duration:g} s"
            raise _refusal(source, "at", at, mend)
        # The sum of two decimal times must meet the detections' own decimals.
        now = round(case.start_time + at, 6)
        density = Density()
        state = case.start
        if at > 0:
            past = self._past(case.agent, now)
            if past is None:
                mend = f"names nobody followed in {self.name} at {now:g} s"
                raise _refusal(source, "agent_id", case.agent, mend)
            sigmas = density.sigma_track, density.sigma_speed
            state = believe([past], now, density.Qc_people, *sigmas).mean[0]
        others = (self._past(agent, now) for agent in self.tracks if agent != case.agent)
        return Scenario(
            robot=Robot(
                position=state[:2],
                velocity=state[2:],
                radius=RADIUS,
                preferred_speed=case.speed,
                max_speed=max(SPEED_RESERVE * case.speed, float(np.hypot(*state[2:]))),
            ),
            goal=case.goal,
            grid=self.grid,
            tracks=tuple(track for track in others if track is not None),
            now=now,
            density=density,
            name=f"{case.identity} at {at:g} s",
        )

    def _past(self, agent: int, now: float) -> Track | None:
        """The run of detections that leads up to `now`; None for who is not there now."""
        rows = self.tracks.get(agent, np.zeros((0, 3)))
        rows = rows[rows[:, 0] <= now]
        if len(rows) == 0 or rows[-1, 0] < now - PRESENT:
            return None
        breaks = np.flatnonzero(np.diff(rows[:, 0]) > LONGEST_GAP)
        rows = rows[breaks[-1] + 1 :] if len(breaks) else rows
        return Track(f"p{agent}", rows[:, 0], rows[:, 1:], RADIUS)


def load_cases(folder: str | Path) -> tuple[Case, ...]:
    """All cases of a folder of recordings, in the file's order.

    Raises:
        ScenarioError: there is no `cases.csv`, a column is missing, or a value is no number.
    """
    folder = Path(folder)
    header, lines = _read_table(
        folder, folder / "cases.csv", ("case_id", "dataset", *_CASE_NUMBERS)
    )
    numbers = _numbers(folder, "cases.csv", header, lines, _CASE_NUMBERS)
    tier = header.index("tier") if "tier" in header else None
    cases = []
    for line, row in zip(lines, numbers, strict=True):
        value = dict(zip(_CASE_NUMBERS, row.tolist(), strict=True))
        cases.append(
            Case(
                identity=line[header.index("case_id")],
                recording=line[header.index("dataset")],
                agent=int(value["agent_id"]),
                start_time=value["start_time"],
                duration=value["human_time"],
                start=np.array([value[name] for name in ("start_x", "start_y", "v0x", "v0y")]),
                goal=np.array([value["goal_x"], value["goal_y"]]),
                speed=value["human_speed"],
                tier="" if tier is None else line[tier],
            )
        )
    return tuple(cases)


def scenario(folder: str | Path, case_id: str, at: float = 0.0) -> Scenario:
    """Plan among the recorded people as they were `at` seconds after the start of a case.

    Raises:
        ScenarioError: the folder holds no such recordings, there is no such case, or `at` is
            outside of it.
    """
    cases = {case.identity: case for case in load_cases(folder)}
    if case_id not in cases:
        near = get_close_matches(case_id, cases, n=3) or list(cases)[:3]
        mend = f"is not in cases.csv; the nearest are {', '.join(near)}"
        raise _refusal(folder, "case", case_id, mend)
    case = cases[case_id]
    return Recording.load(folder, case.recording).scenario(case, at)


def _read_tracks(folder: Path, path: Path) -> dict[int, Array]:
    """Rows (t, x, y) of each person, by time."""
    columns = ("agent_id", "time_s", "x", "y")
    header, lines = _read_table(folder, path, columns)
    rows = _numbers(folder, str(path.relative_to(folder)), header, lines, columns)
    rows = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
    again = np.all(rows[1:, :2] == rows[:-1, :2], axis=1)
    rows = rows[np.concatenate([[True], ~again])[: len(rows)]]
    agents, first = np.unique(rows[:, 0], return_index=True)
    parts = np.split(rows[:, 1:], first[1:])
    return {int(agent): part for agent, part in zip(agents, parts, strict=False)}


def _read_table(
    folder: Path, path: Path, columns: tuple[str, ...]
) -> tuple[list[str], list[list[str]]]:
    """Header and lines of a CSV file that has the columns."""
    where = str(path.relative_to(folder))
    try:
        with path.open(newline="", encoding="utf-8") as file:
            lines = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        mend = f"cannot be read ({error}); name a folder of recordings"
        raise _refusal(folder, where, str(path), mend) from error
    header = lines[0] if lines else []
    missing = [name for name in columns if name not in header]
    if missing:
        raise _refusal(folder, where, header, f"has no column {', '.join(missing)}")
    for number, line in enumerate(lines, start=1):
        if len(line) != len(header):
            mend = f"has {len(line)} values; the header names {len(header)}"
            raise _refusal(folder, f"{where}, line {number}", line, mend)
    return header, lines[1:]


def _numbers(
    folder: Path, where: str, header: list[str], lines: list[list[str]], columns: tuple[str, ...]
) -> Array:
    """The columns as numbers, shape (lines, columns)."""
    index = [header.index(name) for name in columns]
    try:
        rows = np.array([[float(line[i]) for i in index] for line in lines])
        if np.all(np.isfinite(rows)):
            return rows.reshape(len(lines), len(columns))
    except ValueError:
        pass
    raise ScenarioError(
        str(folder),
        tuple(
            Mistake(f"{where}, line {number}, {name}", line[i], "give a number")
            for number, line in enumerate(lines, start=2)
            for name, i in zip(columns, index, strict=True)
            if not _is_number(line[i])
        ),
    )


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


def _refusal(source: object, path: str, value: object, mend: str) -> ScenarioError:
    return ScenarioError(str(source), (Mistake(path, value, mend),))
