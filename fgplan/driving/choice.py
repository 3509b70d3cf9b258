"""Which component of a plan is driven, and what the step is called."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from fgplan.driving.guard import Guarded, Judge, Tier
from fgplan.driving.memory import Memory
from fgplan.driving.observation import Outcome
from fgplan.driving.proposals import route_of
from fgplan.driving.routing import Routes
from fgplan.mixture import Component, Mixture
from fgplan.safety import People

STANDS = 0.05
"""A robot that is to move less than this in the next second waits [m]."""


def chosen(mixture: Mixture, judge: Judge) -> Component:
    """The selected component; where none is safe, the one that is safe longest.

    A route is left for a more probable one, not because the next command on it is not clear while
    another command near it is: else robot and people who meet would flip the route at every step.
    """
    best = mixture.best
    if best is None:
        return max(mixture.components, key=lambda c: c.check.first_contact)
    if best.check.clear or judge.command(best.robot, expected(best, judge)).tier is Tier.AVOIDING:
        return best
    return next((c for c in mixture.components if c.check.clear), best)


def taken(label: str, tier: Tier, followed: str | None, known: Collection[str]) -> str:
    """The route that a step takes; who only gets out of the way takes no other one."""
    if followed is not None and followed in known and tier > Tier.AVOIDING:
        return followed
    return route_of(label, followed)


def expected(component: Component, judge: Judge) -> People:
    """The people of a plan."""
    times, radii = judge.scenario.density.times, judge.belief.radii
    if not component.crowd:
        return People(times, np.zeros((len(times), 0, 4)), radii)
    states = np.stack([person.states for person in component.crowd.values()], axis=1)
    return People(times, states, radii)


def outcome(
    memory: Memory,
    before: Routes,
    component: Component,
    safe: Guarded,
    instead: str,
    label: str,
    stall: float,
) -> tuple[Outcome, str]:
    """How a step ended, and why.

    Args:
        memory: What is known now, with the route that was followed.
        before: The routes before this step.
        component: What is followed.
        safe: What is done.
        instead: What that is, where it is not the component's own command.
        label: Of the route that is taken.
        stall: See `Settings`.
    """
    why = f"hypothesis {component.label}, {component.start}"
    if not component.feasible:
        why = f"no hypothesis is safe ({'; '.join(component.check.problems)})"
    if safe.tier is Tier.LATEST_CONTACT:
        stops = np.linalg.norm(safe.trajectory.velocities[safe.step]) < STANDS
        end = Outcome.STOPPED if stops else Outcome.NO_VALID_CONTROL
        return end, f"{why}; no command is clear of people (in {safe.contact:.1f} s)"
    if safe.tier is Tier.AVOIDING:
        own = "it does not lead on" if component.check.clear else "its command is not clear"
        why += f"; {own}: {instead}"
    if safe.tier is Tier.YIELDING:
        why += f"; no command is clear: at rest before somebody comes in {safe.contact:.1f} s"
    if safe.tier is Tier.PASSING:
        why += "; no stop is clear, but to go on is"
    if memory.followed is not None and label != memory.followed:
        known = any(way.label == memory.followed for way in before.ways)
        gone = not any(way.label == memory.followed for way in memory.routes.ways)
        if known and gone:
            return Outcome.REPLANNING, f"{memory.followed} leads on no longer; {why}"
        return Outcome.SWITCHING, f"from {memory.followed}; {why}"
    soon = component.robot.at(1.0)[:2]
    if np.linalg.norm(soon - memory.scenario.robot.position) < STANDS:
        return Outcome.WAITING, why
    since = memory.progress()[1]
    if memory.scenario.now - since > stall:
        return Outcome.NO_PROGRESS, f"no nearer to the goal for {stall:g} s; {why}"
    return Outcome.FOLLOWING, why
