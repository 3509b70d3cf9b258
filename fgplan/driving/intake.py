"""What of an observation can be believed: refused, repaired, or taken as it is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fgplan.driving.observation import Detection, Observation


@dataclass(frozen=True)
class Intake:
    """Limits of what is plausible.

    Args:
        jump: A robot may be this far from where it can have driven [m]: more is a fault of the
            localisation, or, when it stays there, a new place.
        slack: How much faster than its limit a robot may seem to be, as a factor.
    """

    jump: float = 0.5
    slack: float = 1.5

    def problem(
        self, new: Observation, last: Observation | None, max_speed: float, distrusted: bool
    ) -> str | None:
        """Why an observation cannot be used at all; None where it can.

        Args:
            new: What came now.
            last: The last one that was used.
            max_speed: Of the robot [m/s].
            distrusted: Whether the one before was refused for a jump, too: then it stays there.
        """
        state = [*np.ravel(new.position), *np.ravel(new.velocity), new.time, new.yaw_rate]
        if new.heading is not None:
            state.append(new.heading)
        if len(np.ravel(new.position)) != 2 or len(np.ravel(new.velocity)) != 2:
            return f"position {new.position!r} and velocity {new.velocity!r} need two numbers each"
        if not np.all(np.isfinite(state)):
            return f"the robot's state is not finite: {np.round(state, 3).tolist()}"
        if new.covariance is not None and not np.all(np.isfinite(new.covariance)):
            return "the robot's covariance is not finite"
        if last is None:
            return None
        if new.time <= last.time:
            repeated = "repeated" if new.time == last.time else "older than the last one"
            return f"the observation of {new.time:.3f} s is {repeated} ({last.time:.3f} s)"
        moved = float(np.hypot(*(new.position - last.position)))
        possible = self.slack * max_speed * (new.time - last.time) + self.jump
        if moved > possible and not distrusted:
            return f"the robot jumped by {moved:.2f} m in {new.time - last.time:.2f} s"
        return None

    def repaired(self, new: Observation, max_speed: float) -> tuple[Observation, tuple[str, ...]]:
        """The observation without what is impossible in it, and what that was."""
        notes = []
        speed = float(np.hypot(*new.velocity))
        if speed > self.slack * max_speed:
            notes.append(f"speed {speed:.2f} m/s is impossible; {max_speed:.2f} m/s taken")
            new = replace(new, velocity=new.velocity * (max_speed / speed))
        if new.goal is not None and not np.all(np.isfinite(new.goal)):
            notes.append(f"goal {np.asarray(new.goal).tolist()} is not finite; the old one is kept")
            new = replace(new, goal=None)
        if new.detections is not None:
            good = tuple(d for d in new.detections if _possible(d))
            if len(good) < len(new.detections):
                notes.append(f"{len(new.detections) - len(good)} impossible detection(s) left out")
                new = replace(new, detections=good)
        return new, tuple(notes)


def _possible(d: Detection) -> bool:
    numbers = [*np.ravel(d.position), d.radius, *([] if d.velocity is None else d.velocity)]
    return len(np.ravel(d.position)) == 2 and bool(np.all(np.isfinite(numbers))) and d.radius >= 0
