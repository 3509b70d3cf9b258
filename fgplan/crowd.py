"""The people: from tracks to one belief at t_0, and who of them the robot can see at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fgplan.scenario import FieldOfView, Scenario, Track

if TYPE_CHECKING:
    from fgplan.occupancy import OccupancyGrid

Array = NDArray[np.float64]

STANDING_SPEED = 0.05
"""Below this speed [m/s] a velocity says nothing about where the robot looks."""


@dataclass(frozen=True, eq=False)
class Belief:
    """p(f_0 | z^f): what the tracks say about n people now, one Gaussian a person.

    Args:
        names: One per person, in the scenario's order.
        mean: Rows (x, y, vx, vy), shape (n, 4) [m, m/s].
        covariance: Shape (n, 4, 4).
        radii: Shape (n,) [m].
        Qc: Power spectral density of the people's acceleration [m²/s³].

    Raises:
        ValueError: a shape is wrong, a number is not finite, or a covariance is not positive
            definite; the person is named.
    """

    names: tuple[str, ...]
    mean: Array
    covariance: Array
    radii: Array
    Qc: float

    def __post_init__(self) -> None:
        n = self.count
        for name, shape in (("mean", (n, 4)), ("covariance", (n, 4, 4)), ("radii", (n,))):
            value = np.asarray(getattr(self, name))
            if value.shape != shape:
                raise ValueError(f"{name} of {n} people has shape {value.shape}; give {shape}")
            finite = np.isfinite(value).all(axis=tuple(range(1, value.ndim)))
            wrong = np.flatnonzero(~finite)
            if len(wrong):
                i = int(wrong[0])
                raise ValueError(
                    f"{name} of {self.names[i]!r} is {value[i].tolist()}; give finite numbers"
                )
        try:
            np.linalg.cholesky(self.covariance)
        except np.linalg.LinAlgError:
            lowest = np.linalg.eigvalsh(self.covariance)[:, 0]
            i = int(np.argmin(lowest))
            raise ValueError(
                f"covariance of {self.names[i]!r} is not positive definite, its least eigenvalue "
                f"is {lowest[i]:.3g}; nobody is known exactly: give a small variance instead of 0"
            ) from None

    @property
    def count(self) -> int:
        """Number of people n."""
        return len(self.names)

    @classmethod
    def of_axes(
        cls, names: tuple[str, ...], mean: Array, spread: Array, radii: Array, Qc: float
    ) -> Belief:
        """Of people both of whose axes have one covariance, pp, pv and vv, rows of (n, 3)."""
        pp, pv, vv = spread.T
        blocks = np.stack([pp, pv, pv, vv], axis=-1).reshape(-1, 2, 2)
        covariance = np.einsum("mij,kl->mikjl", blocks, np.eye(2)).reshape(-1, 4, 4)
        return cls(names, mean, covariance, radii, Qc)

    def select(self, index: NDArray[np.intp]) -> Belief:
        """The belief about some of the people."""
        return Belief(
            tuple(self.names[i] for i in index),
            self.mean[index],
            self.covariance[index],
            self.radii[index],
            self.Qc,
        )

    def predict(self, times: Array) -> tuple[Array, Array]:
        """The people at later times, by the white-noise-on-acceleration prior alone.

        Args:
            times: Seconds from now, shape (S,), none negative.

        Returns:
            Means (S, n, 4) and covariances (S, n, 4, 4).

        Raises:
            ValueError: a time is negative.
        """
        means = self.expected(times)
        t = np.asarray(times, dtype=float)[:, None, None, None]
        P, q = self.covariance, self.Qc * np.eye(2)
        covariance = np.empty((len(t), *P.shape))
        cross = P[:, :2, 2:] + t * P[:, 2:, 2:]
        covariance[..., :2, :2] = P[:, :2, :2] + t * (P[:, 2:, :2] + cross) + t**3 / 3 * q
        covariance[..., :2, 2:] = cross + t**2 / 2 * q
        covariance[..., 2:, :2] = np.swapaxes(covariance[..., :2, 2:], -1, -2)
        covariance[..., 2:, 2:] = P[:, 2:, 2:] + t * q
        return means, covariance

    def expected(self, times: Array) -> Array:
        """The means of `predict` alone, shape (S, n, 4).

        Raises:
            ValueError: a time is negative.
        """
        t = np.asarray(times, dtype=float)
        if t.min(initial=0.0) < 0:
            raise ValueError(f"times must not be negative: the belief is of now, got {t.min()} s")
        means = np.repeat(self.mean[None], len(t), axis=0)
        means[..., :2] += t[:, None, None] * self.mean[:, 2:]
        return means


def believe(
    tracks: Sequence[Track], now: float, Qc: float, sigma_track: float, sigma_speed: float
) -> Belief:
    """The exact posterior at `now` of each person's state, given all positions of the track.

    The process is Markov, so a Kalman filter through the track's own time stamps is the Gaussian
    process regression with the white-noise-on-acceleration prior (Barfoot, Tong, Särkkä, RSS
    2014): before the first position nothing is known of where the person is, and the velocity
    has zero mean and standard deviation `sigma_speed`. Gaps only let the uncertainty grow.

    A person's belief does not depend, to the last bit, on who else is in `tracks`.

    Args:
        tracks: Each with at least one position, none after `now`.
        now: [s].
        Qc: Power spectral density of the acceleration [m²/s³].
        sigma_track: Standard deviation of a position [m].
        sigma_speed: Prior standard deviation of each component of the velocity [m/s].

    Raises:
        ValueError: a track is empty or has a position after `now`.
    """
    times, positions = _padded(tracks, now)
    count, length = times.shape
    dt = np.diff(times, axis=1, append=now)
    # Padding repeats the last time stamp, so it moves nothing; a gain of 0 makes it teach nothing.
    sizes = np.array([len(track.times) for track in tracks], dtype=int)
    told = (np.arange(length) < sizes[:, None]).astype(float)
    q_pp, q_pv, q_vv = Qc * dt**3 / 3, Qc * dt**2 / 2, Qc * dt

    # Both axes share one 2x2 covariance [[pp, pv], [pv, vv]] a person.
    R = sigma_track**2
    pp, pv, vv = np.full(count, R), np.zeros(count), np.full(count, sigma_speed**2)
    p, v = (positions[:, 0].copy() if length else np.zeros((count, 2))), np.zeros((count, 2))
    for k in range(length):
        if k > 0:
            innovation = told[:, k] / (pp + R)
            gain_p, gain_v = pp * innovation, pv * innovation
            residual = positions[:, k] - p
            p, v = p + gain_p[:, None] * residual, v + gain_v[:, None] * residual
            vv = vv - gain_v * pv
            # 1 − gain, which as a difference is 0 where R is nothing beside the prediction.
            keep = np.where(told[:, k] > 0, R / (pp + R), 1.0)
            pp, pv = pp * keep, pv * keep
        step = dt[:, k]
        p = p + step[:, None] * v
        pp = pp + step * (2 * pv + step * vv) + q_pp[:, k]
        pv = pv + step * vv + q_pv[:, k]
        vv = vv + q_vv[:, k]
    return Belief.of_axes(
        names=tuple(track.identity for track in tracks),
        mean=np.hstack([p, v]),
        spread=np.stack([pp, pv, vv], axis=-1),
        radii=np.array([track.radius for track in tracks], dtype=float),
        Qc=float(Qc),
    )


def heading(scenario: Scenario) -> float:
    """Where the robot looks [rad]: as stated, else where it moves, else to the goal, else 0."""
    robot = scenario.robot
    if robot.heading is not None:
        return float(robot.heading)
    direction = np.asarray(robot.velocity, dtype=float)
    if np.hypot(*direction) <= STANDING_SPEED:
        goal = robot.position if scenario.goal is None else scenario.goal
        direction = np.asarray(goal, dtype=float) - robot.position
    return float(np.arctan2(direction[1], direction[0]))


def visible(
    field_of_view: FieldOfView,
    position: Array,
    heading: float,
    points: Array,
    grid: OccupancyGrid | None,
) -> NDArray[np.bool_]:
    """Which points the robot sees; the edges of range and angle count as seen.

    Args:
        field_of_view: Range, full opening angle, and whether the map hides what is behind it.
        position: Of the robot, shape (2,) [m].
        heading: [rad].
        points: Shape (n, 2) [m].
        grid: The map; None hides nobody.

    Returns:
        Shape (n,).
    """
    offset = np.asarray(points, dtype=float).reshape(-1, 2) - position
    distance = np.hypot(offset[:, 0], offset[:, 1])
    mask: NDArray[np.bool_] = distance <= field_of_view.range
    if field_of_view.angle < 2 * np.pi:
        bearing = np.arctan2(offset[:, 1], offset[:, 0]) - heading
        aside = np.abs(np.arctan2(np.sin(bearing), np.cos(bearing)))
        # 1e-12: a point on the very edge must not depend on the rounding of the arctangent.
        mask &= (aside <= field_of_view.angle / 2 + 1e-12) | (distance == 0)
    if field_of_view.occlusion and grid is not None:
        mask[mask] = _in_sight(np.asarray(position, dtype=float), offset[mask], grid)
    return mask


def seen(scenario: Scenario) -> tuple[Track, ...]:
    """The tracks of the people whose latest position is in the field of view, in order.

    Who is not seen is not in the density, so the plan is the same to the last bit as without
    them.
    """
    if scenario.field_of_view is None or not scenario.tracks:
        return tuple(scenario.tracks)
    latest = np.array([track.positions[-1] for track in scenario.tracks], dtype=float)
    mask = visible(
        scenario.field_of_view,
        np.asarray(scenario.robot.position, dtype=float),
        heading(scenario),
        latest,
        scenario.grid,
    )
    return tuple(track for track, inside in zip(scenario.tracks, mask, strict=True) if inside)


def _in_sight(position: Array, offset: Array, grid: OccupancyGrid) -> NDArray[np.bool_]:
    """Which points position + offset, shape (n, 2), the map does not hide, shape (n,)."""
    xmin, ymin, xmax, ymax = grid.bounds
    corners = np.array([[xmin, ymin], [xmin, ymax], [xmax, ymin], [xmax, ymax]]) - position
    reach = np.linalg.norm(corners, axis=1).max()
    distance = np.linalg.norm(offset, axis=1)
    # Nothing hides beyond the map, and the line is sampled all the way to its end.
    ends = position + offset * np.minimum(1.0, reach / np.maximum(distance, 1e-9))[:, None]
    # One by one: the sampling follows the farthest point of a call, and who is seen must not
    # depend on who else is there.
    return np.array([grid.line_of_sight(position, end[None])[0] for end in ends], dtype=bool)


def _padded(tracks: Sequence[Track], now: float) -> tuple[Array, Array]:
    """Times (n, m) and positions (n, m, 2) of all tracks, the short ones' last row repeated."""
    length = max((len(track.times) for track in tracks), default=0)
    times = np.full((len(tracks), length), float(now))
    positions = np.zeros((len(tracks), length, 2))
    for i, track in enumerate(tracks):
        size = len(track.times)
        if size == 0:
            raise ValueError(f"the track of {track.identity!r} is empty")
        times[i, :size], times[i, size:] = track.times, track.times[-1]
        positions[i, :size], positions[i, size:] = track.positions, track.positions[-1]
        if times[i, -1] > now:
            raise ValueError(
                f"{track.identity!r} was seen at {times[i, -1]} s, after now = {now} s"
            )
    return times, positions
