"""What is done without a plan: the last one goes on, or the robot comes to rest."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fgplan.crowd import Belief
from fgplan.driving.following import action_of, at_start_of, shifted, standing
from fgplan.driving.guard import Guarded, Judge, Tier
from fgplan.driving.intake import Refused
from fgplan.driving.memory import Memory
from fgplan.driving.observation import Decision, Observation, Outcome
from fgplan.driving.settings import Settings
from fgplan.driving.tracking import Tracker
from fgplan.obeying import closed
from fgplan.safety import People
from fgplan.scenario import Scenario
from fgplan.trajectory import Trajectory

Array = NDArray[np.float64]


def judge_of(scenario: Scenario, belief: Belief, settings: Settings) -> Judge:
    """Who has the last word on a moment."""
    return Judge(closed(scenario), belief, settings.period, settings.guard, settings.lag)


@dataclass(frozen=True)
class Unplanned:
    """Drives a robot without a plan.

    Args:
        settings: How it drives.
        tracker: Predicts the people.
    """

    settings: Settings
    tracker: Tracker

    def rest(
        self,
        memory: Memory,
        belief: Belief,
        outcome: Outcome,
        reason: str,
        repairs: tuple[str, ...],
    ) -> tuple[Decision, Memory]:
        """Come to rest, or stay at it, and keep out of the way of nobody's feet."""
        scenario = memory.scenario
        safe = self._guarded(scenario, belief, standing(scenario, self.settings.period))
        return _done(memory, scenario, safe, outcome, reason, repairs)

    def carry_on(self, memory: Memory, refused: Refused) -> tuple[Decision, Memory]:
        """Without a usable observation: the last plan goes on, for a while, or the robot stops."""
        # A clock that stands, runs back or is none at all says that one more period is over.
        since = refused.time - memory.started
        if not 0 < since < np.inf:
            since = self.settings.period
        scenario, ahead = _driven(memory, since)
        if ahead is None and np.isfinite(refused.time):
            scenario = scenario.replace(now=refused.time)
        last = memory.observation
        if last is None or scenario.now - last.time > self.settings.blind:
            ahead = None
        wanted = ahead or standing(scenario, self.settings.period)
        safe = self._guarded(scenario, self._people(memory, scenario), wanted)
        reason = f"{refused.text}; {'the last plan goes on' if ahead else 'the robot stops'}"
        ended, named = Outcome.BAD_OBSERVATION, (refused.text,)
        decision, after = _done(memory, scenario, safe, ended, reason, named)
        goes_on = ahead is not None and safe.tier <= Tier.TOUCHING_NOBODY
        return decision, replace(after, trajectory=ahead) if goes_on else after

    def stop(self, memory: Memory, observation: Observation, why: str) -> tuple[Decision, Memory]:
        """The fastest stop from what was commanded last, whatever is wrong: the last resort. It
        goes on from step to step, and where the guard breaks, too, it is not guarded."""
        scenario, _ = _driven(memory, self.settings.period)
        with suppress(Exception):
            scenario = self._seen(memory, scenario, observation)
        ahead = standing(scenario, self.settings.period)
        safe, kind = Guarded(ahead, 1, Tier.LATEST_CONTACT, np.inf), "stop"
        with suppress(Exception):
            safe = self._guarded(scenario, self._people(memory, scenario), ahead)
            kind = "stop" if safe.tier <= Tier.TOUCHING_NOBODY else "avoid"
        decision, memory = _done(memory, scenario, safe, Outcome.NO_VALID_CONTROL, why)
        return replace(decision, action=replace(decision.action, kind=kind)), memory

    def _seen(self, memory: Memory, scenario: Scenario, observation: Observation) -> Scenario:
        """Where the robot is seen to be, if it can be. Who is slow to obey is told to be slower
        still: it is as fast as it was told to be, unless it is seen to be slower."""
        robot = scenario.robot
        if self.settings.intake.refused(observation, None, None, robot) is not None:
            return scenario
        velocity = np.asarray(observation.velocity, dtype=float)
        if memory.trajectory is not None:
            velocity = min(velocity, robot.velocity, key=np.linalg.norm)
        seen = replace(
            robot,
            position=np.asarray(observation.position, dtype=float),
            velocity=velocity,
            heading=observation.heading,
        )
        return scenario.replace(robot=seen, now=float(observation.time))

    def _people(self, memory: Memory, scenario: Scenario) -> Belief:
        """As they are predicted now."""
        now = max(scenario.now, memory.people.time)
        return self.tracker.predict(memory.people, now).belief(scenario.density.Qc_people)

    def _guarded(self, scenario: Scenario, belief: Belief, wanted: Trajectory) -> Guarded:
        """A trajectory among people as they are predicted."""
        times = scenario.density.times
        predicted = People(times, belief.predict(times)[0], belief.radii)
        return judge_of(scenario, belief, self.settings).command(wanted, predicted)


def _driven(memory: Memory, since: float) -> tuple[Scenario, Trajectory | None]:
    """Where what is driven has brought the robot since its last command [s], no farther than it can
    get, and what is left of it; where nothing was driven yet, what was known at first."""
    scenario = memory.scenario
    if memory.trajectory is None:
        return scenario, None
    ahead = shifted(memory.trajectory, since, scenario.density.times)
    before, robot = scenario.robot, at_start_of(ahead, scenario.robot)
    moved = robot.position - before.position
    far = since * max(before.max_speed, float(np.linalg.norm(before.velocity)))
    share = min(1.0, far / max(float(np.linalg.norm(moved)), 1e-9))
    robot = replace(robot, position=before.position + share * moved)
    return scenario.replace(robot=robot, now=memory.started + since), ahead


def _done(
    memory: Memory,
    scenario: Scenario,
    safe: Guarded,
    outcome: Outcome,
    reason: str,
    repairs: tuple[str, ...] = (),
) -> tuple[Decision, Memory]:
    """The decision for what is safe, and that it is being driven."""
    decision = Decision(
        time=scenario.now,
        action=action_of(scenario, safe, reason),
        outcome=outcome,
        reason=reason,
        trajectory=safe.trajectory,
        label=memory.followed,
        repairs=repairs,
    )
    return decision, replace(memory, trajectory=safe.trajectory, started=scenario.now)
