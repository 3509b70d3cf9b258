"""Who is there: from detections to one belief a person, step after step.

Each person is a Gaussian over (p, v), predicted by the white-noise-on-acceleration prior and
updated by Kalman's formulae: the posterior of `fgplan.crowd.believe`, without its memory of all
detections. What is not seen fades by the prior's own uncertainty, until it is let go.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import Belief, believe
from fgplan.driving.observation import Detection
from fgplan.scenario import Track

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Counts = NDArray[np.intp]
Visible = Callable[[Array], Mask]
"""Which of the points (n, 2) would be seen if somebody stood there."""


@dataclass(frozen=True)
class Tracking:
    """How people are followed.

    Args:
        gate: A detection further from a person than this, as a squared Mahalanobis distance, is
            of somebody else; for two coordinates 16 lets 3 in 10,000 go.
        jump: A detection with an identity may be off by this much more [m], before it is taken
            for a fault of the detector.
        misses: Looks at the place of a person without seeing anybody there, before the person is
            taken to have gone.
        hidden: Who stays out of sight is remembered for this long [s].
        spread: Nor longer than until the standard deviation of the place is this large [m].
        sigma_velocity: Standard deviation of a detected velocity [m/s].
    """

    gate: float = 16.0
    jump: float = 0.5
    misses: int = 3
    hidden: float = 4.0
    spread: float = 1.5
    sigma_velocity: float = 0.05


@dataclass(frozen=True, eq=False)
class People:
    """Everybody who is followed, at one moment.

    Args:
        time: [s].
        names: Of n people.
        mean: Rows (x, y, vx, vy), shape (n, 4).
        spread: (pp, pv, vv) of the covariance, the same for both axes, shape (n, 3).
        radii: Shape (n,) [m].
        seen: When each was last seen, shape (n,) [s].
        missed: Looks in vain since then, shape (n,).
        suspect: Detections refused in a row, shape (n,).
        born: How many people were ever given a name.
    """

    time: float = 0.0
    names: tuple[str, ...] = ()
    mean: Array = field(default_factory=lambda: np.zeros((0, 4)))
    spread: Array = field(default_factory=lambda: np.zeros((0, 3)))
    radii: Array = field(default_factory=lambda: np.zeros(0))
    seen: Array = field(default_factory=lambda: np.zeros(0))
    missed: Counts = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    suspect: Counts = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    born: int = 0

    def belief(self, Qc: float) -> Belief:
        """p(f_0 | z^f) for the density."""
        return Belief.of_axes(self.names, self.mean, self.spread, self.radii, Qc)

    def keep(self, rows: Mask) -> People:
        """Some of them."""
        return replace(
            self,
            names=tuple(name for name, stays in zip(self.names, rows, strict=True) if stays),
            mean=self.mean[rows],
            spread=self.spread[rows],
            radii=self.radii[rows],
            seen=self.seen[rows],
            missed=self.missed[rows],
            suspect=self.suspect[rows],
        )


@dataclass(frozen=True)
class Tracker:
    """Association, births, deaths, gaps and reappearance.

    Args:
        Qc: Power spectral density of the people's acceleration [m²/s³].
        sigma_track: Standard deviation of a detected position [m].
        sigma_speed: Prior standard deviation of each component of a velocity [m/s].
        settings: See `Tracking`.
    """

    Qc: float
    sigma_track: float
    sigma_speed: float
    settings: Tracking = Tracking()

    def recall(self, tracks: Sequence[Track], now: float) -> People:
        """The people of tracks that end before now, in the order of the tracks."""
        belief = believe(tracks, now, self.Qc, self.sigma_track, self.sigma_speed)
        n, P = belief.count, belief.covariance
        return People(
            time=now,
            names=belief.names,
            mean=belief.mean,
            spread=np.stack([P[:, 0, 0], P[:, 0, 2], P[:, 2, 2]], axis=-1),
            radii=belief.radii,
            seen=np.array([track.times[-1] for track in tracks], dtype=float),
            missed=np.zeros(n, dtype=np.intp),
            suspect=np.zeros(n, dtype=np.intp),
        )

    def predict(self, people: People, time: float) -> People:
        """The same people at a later time, by the prior alone."""
        t = time - people.time
        mean = people.mean.copy()
        mean[:, :2] += t * mean[:, 2:]
        pp, pv, vv = people.spread.T
        spread = np.stack(
            [
                pp + t * (2 * pv + t * vv) + self.Qc * t**3 / 3,
                pv + t * vv + self.Qc * t**2 / 2,
                vv + self.Qc * t,
            ],
            axis=-1,
        )
        return replace(people, time=time, mean=mean, spread=spread)

    def update(
        self,
        people: People,
        time: float,
        detections: Sequence[Detection] | None,
        visible: Visible,
    ) -> tuple[People, tuple[str, ...]]:
        """The people after a look round.

        Args:
            people: Before it.
            time: Of the look, not before `people.time` [s].
            detections: Who was seen; None says that nothing was sensed.
            visible: Where the robot would have seen somebody.

        Returns:
            The people now, and which detections were refused, in words.
        """
        people = self.predict(people, time)
        if detections is None:
            return self._forget(people), ()
        owner, refused = self._associate(people, detections)
        old = [(i, d) for i, d in zip(owner, detections, strict=True) if i >= 0]
        new = [d for i, d in zip(owner, detections, strict=True) if i == NOBODY]
        rows = np.array([i for i, _ in old], dtype=np.intp)
        fresh = [k for k, row in enumerate(rows.tolist()) if people.seen[row] < time]
        people = self._correct(people, rows[fresh], [old[k][1] for k in fresh])
        unseen = np.ones(len(people.names), dtype=bool)
        unseen[rows] = False
        suspect = np.where(unseen, people.suspect, 0)
        notes = []
        for i, (what, row) in refused.items():
            suspect[row] += 1
            unseen[row] = False
            notes.append(what)
            if suspect[row] >= self.settings.misses:  # not a fault: it stays there
                new.append(detections[i])
        gone = suspect >= self.settings.misses
        looked = unseen.copy()
        if unseen.any():
            looked[unseen] = visible(people.mean[unseen, :2])
        people = replace(people, missed=people.missed + looked, suspect=suspect)
        people = people.keep(~gone)
        return self._forget(self._welcome(people, new)), tuple(notes)

    def _associate(
        self, people: People, detections: Sequence[Detection]
    ) -> tuple[list[int], dict[int, tuple[str, int]]]:
        """Whose each detection is: a row, or NOBODY, or REFUSED; and what was refused of whom.

        Of several by one name the nearest is who is known by it. One beside it is the same person
        again, any other is somebody else: a class is often given for an identity.
        """
        row_of = {name: i for i, name in enumerate(people.names)}
        owner = [NOBODY] * len(detections)
        refused: dict[int, tuple[str, int]] = {}
        apart = self._distances(people, detections)
        allowed = np.sqrt(self.settings.gate * (people.spread[:, 0] + self.sigma_track**2))
        rows = [row_of.get(d.identity) if d.identity is not None else None for d in detections]
        nearest: dict[int, int] = {}
        for i, row in enumerate(rows):
            if row is not None and (row not in nearest or apart[i, row] < apart[nearest[row], row]):
                nearest[row] = i
        anonymous = [i for i, d in enumerate(detections) if d.identity is None]
        taken: set[int] = set()
        for i, row in enumerate(rows):
            if row is None:
                continue
            if i != nearest[row] and apart[i, row] > allowed[row]:
                anonymous.append(i)
            elif i != nearest[row]:
                owner[i] = REFUSED
                refused[i] = (f"{detections[i].identity} was detected twice", row)
            elif apart[i, row] <= allowed[row] + self.settings.jump:
                owner[i] = row
                taken.add(row)
            else:
                owner[i] = REFUSED
                refused[i] = (f"{detections[i].identity} jumped by {apart[i, row]:.1f} m", row)
        free = [row for row in range(len(people.names)) if row not in taken]
        if anonymous and free:
            from scipy.optimize import linear_sum_assignment

            scaled = (apart[np.ix_(anonymous, free)] / allowed[free]) ** 2
            within = scaled <= 1
            # Who lies outside of every gate costs as much as staying alone.
            pairs = linear_sum_assignment(np.where(within, scaled, 1e6))
            for a, b in zip(*pairs, strict=True):
                if within[a, b]:
                    owner[anonymous[a]] = free[b]
        return owner, refused

    def _distances(self, people: People, detections: Sequence[Detection]) -> Array:
        """Between detections and people, shape (m, n) [m]."""
        where = np.array([d.position for d in detections], dtype=float).reshape(-1, 1, 2)
        return np.asarray(np.linalg.norm(where - people.mean[None, :, :2], axis=-1))

    def _correct(
        self, people: People, rows: NDArray[np.intp], detections: Sequence[Detection]
    ) -> People:
        """Kalman's update of the people who were seen."""
        if not len(rows):
            return people
        mean, spread = people.mean.copy(), people.spread.copy()
        where = np.array([d.position for d in detections], dtype=float)
        pp, pv, vv = spread[rows].T
        x = mean[rows]
        R = self.sigma_track**2
        gain_p, gain_v = pp / (pp + R), pv / (pp + R)
        residual = where - x[:, :2]
        x = x + np.hstack([gain_p[:, None] * residual, gain_v[:, None] * residual])
        pp, pv, vv = pp * R / (pp + R), pv * R / (pp + R), vv - gain_v * pv
        told = np.array([d.velocity is not None for d in detections])
        if told.any():
            speed = np.array([d.velocity if d.velocity is not None else (0, 0) for d in detections])
            S = self.settings.sigma_velocity**2
            gain_p, gain_v = told * pv / (vv + S), told * vv / (vv + S)
            residual = speed - x[:, 2:]
            x = x + np.hstack([gain_p[:, None] * residual, gain_v[:, None] * residual])
            pp = pp - gain_p * pv
            pv, vv = np.where(told, pv * S / (vv + S), pv), np.where(told, vv * S / (vv + S), vv)
        mean[rows], spread[rows] = x, np.stack([pp, pv, vv], axis=-1)
        radii, seen, missed = people.radii.copy(), people.seen.copy(), people.missed.copy()
        radii[rows] = [d.radius for d in detections]
        seen[rows], missed[rows] = people.time, 0
        return replace(people, mean=mean, spread=spread, radii=radii, seen=seen, missed=missed)

    def _welcome(self, people: People, detections: Sequence[Detection]) -> People:
        """New people: they are where they were seen, and may move any way."""
        if not detections:
            return people
        n, names, born = len(detections), list(people.names), people.born
        for detection in detections:
            name = detection.identity
            while name is None or name in names:
                born += 1
                name = f"person {born}"
            names.append(name)
        mean = np.zeros((n, 4))
        mean[:, :2] = [d.position for d in detections]
        spread = np.tile([self.sigma_track**2, 0.0, self.sigma_speed**2], (n, 1))
        S, V = self.settings.sigma_velocity**2, self.sigma_speed**2
        for i, detection in enumerate(detections):
            if detection.velocity is not None:
                mean[i, 2:] = V / (V + S) * np.asarray(detection.velocity)
                spread[i, 2] = V * S / (V + S)
        return replace(
            people,
            names=tuple(names),
            mean=np.vstack([people.mean, mean]),
            spread=np.vstack([people.spread, spread]),
            radii=np.append(people.radii, [d.radius for d in detections]),
            seen=np.append(people.seen, np.full(n, people.time)),
            missed=np.append(people.missed, np.zeros(n, dtype=np.intp)),
            suspect=np.append(people.suspect, np.zeros(n, dtype=np.intp)),
            born=born,
        )

    def _forget(self, people: People) -> People:
        limits = self.settings
        gone = people.missed >= limits.misses
        gone |= people.time - people.seen > limits.hidden
        gone |= np.sqrt(people.spread[:, 0]) > limits.spread
        return people.keep(~gone) if gone.any() else people


NOBODY, REFUSED = -1, -2
"""Owners of a detection that is of somebody new, and of one that is not believed."""
