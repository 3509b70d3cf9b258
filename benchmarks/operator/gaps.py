"""S6a with corridors that are not alike: does the robot turn back exactly when the density says so?

A doubtful hand (σ = 0.6 m/s as the stick is read) points at the corridor that leads further round.
At each step after the release the choice is compared with the closed form,

    log p(lower) − log p(upper) = Σ_j log p(z_j | lower) / p(z_j | upper) − β (J_lower − J_upper)
                                  ± commitment − (E_lower − E_upper),

each message on the plans that there were when it was said, recorded beside the planner.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.operator import FIRST, LAST, fork, side_of, twins
from fgplan.conditioning import log_likelihood
from fgplan.driving import Settings
from fgplan.inference import Progress
from fgplan.measuring import Reading
from fgplan.mixture import Component, Mixture
from fgplan.shared_control import admit
from fgplan.simulation.driver import Fgplan
from fgplan.simulation.episode import Moment, run
from fgplan.simulation.operators import STICK, Held, Steady
from fgplan.trajectory import Trajectory

SIGMA = 0.6
"""Of the wish, as the stick is read [m/s]."""
GAPS = (0.0, 0.5, 1.0, 2.0, 3.0)
"""How far the lower corridor lies further out [m]."""


@dataclass(frozen=True)
class Doubtful:
    """One run.

    Args:
        data: What the stick says for the lower corridor, at the release [nats].
        price: What the lower one costs more [nats].
        taken: Whether the lower one was driven.
        reversed: Whether the plan left the lower one after the release.
        agrees: Share of the steps after the release at which the choice is that of the closed form.
        error: Largest difference of log weights to the closed form [nats].
    """

    data: float
    price: float
    taken: bool
    reversed: bool
    agrees: float
    error: float


def waver(gap: float, seed: int) -> Doubtful:
    """Drive once."""
    world = fork(seed)
    grid = twins(gap)
    world = replace(world, grid=grid, scenario=world.scenario.replace(grid=grid))
    hand = Steady(float(np.deg2rad(-30.0)), FIRST, LAST)
    rng, period = np.random.default_rng([seed, 1]), world.rules.period
    stick = replace(STICK, sigma=SIGMA)
    world = replace(world, operator=Held(hand, period, rng, dropped=0.2, stick=stick))
    driver = Fgplan()(world)
    settings, beta = Settings(), world.scenario.density.beta
    said: list[Reading] = []
    plans: dict[str, dict[float, Trajectory]] = {}
    steps: list[tuple[float, float, float, float, int]] = []
    followed: list[str | None] = [None]
    since = [0.0]

    def watch(moment: Moment) -> None:
        decision = moment.command.decision
        assert decision is not None
        for name, past in driver.planner.memory.operated.past.of.items():
            plans.setdefault(name, {}).update(past.plans)
        now = world.scenario.replace(now=moment.observation.time)
        heard = admit(moment.observation.operator, now).data  # at most the top speed
        said.extend(r for m in heard for r in m.readings)
        before, followed[0] = followed[0], decision.label
        grown = 1 - np.exp(-(moment.observation.time - since[0]) / settings.deliberation)
        if before != decision.label:
            since[0] = moment.observation.time
        pair = None if decision.mixture is None else _corridors(decision.mixture)
        if pair is None or moment.observation.time < LAST:
            return
        upper, lower = pair
        if decision.label not in (upper.label, lower.label):
            return  # straight on where the stick pointed
        data = _data(said, plans[lower.label]) - _data(said, plans[upper.label])
        price = beta * (lower.cost - upper.cost)
        weight = data - price
        kept = (before == lower.label) - (before == upper.label)
        weight += grown * settings.commitment * kept
        error = abs(weight - (lower.log_prior - upper.log_prior))
        choice = 1 if weight - (lower.energy - upper.energy) < 0 else -1
        steps.append((data, price, error, choice, 1 if decision.label == upper.label else -1))

    episode = run(world, driver, watch)
    found = np.array(steps)
    middle = np.flatnonzero(episode.robot[:, 0] > 7.0)
    taken = bool(len(middle) and side_of(episode.robot[middle[0], :2]) < 0)
    return Doubtful(
        float(found[0, 0]),
        float(found[0, 1]),
        taken,
        bool(np.any(np.diff(found[:, 4]) > 0)),
        float(np.mean(found[:, 3] == found[:, 4])),
        float(found[:, 2].max()),
    )


def _data(said: list[Reading], plans: dict[float, Trajectory]) -> float:
    """log p of all that was said, each on the plan of its time [nats]."""
    starts = np.array(sorted(plans))
    total = 0.0
    for reading in said:
        k = int(np.searchsorted(starts, (reading.said or 0.0) + 1e-6, side="right")) - 1
        total += log_likelihood((reading,), plans[starts[k]], float(starts[k]))
    return total


def _corridors(mixture: Mixture) -> tuple[Component, Component] | None:
    """The plans through the upper and the lower corridor; None where they are no two plans."""
    sides: dict[int, Component] = {}
    for component in mixture.components:
        if component.route is None or "+" in component.label or "," in component.label:
            continue
        at = int(np.argmin(np.abs(component.route[:, 0] - 7.0)))
        if abs(component.route[at, 0] - 7.0) < 0.5:
            sides.setdefault(side_of(component.route[at]), component)
    return (sides[1], sides[-1]) if len(sides) == 2 else None


def gaps(seeds: int, progress: Progress | None = None) -> Iterator[dict[str, Any]]:
    """Yields a row a gap."""
    for gap in GAPS:
        runs = []
        for seed in range(seeds):
            runs.append(waver(gap, seed))
            if progress is not None:
                progress(f"S6a, gap {gap:g} m", seed + 1, seeds)
        yield {
            "case": "S6a-gaps",
            "gap_m": gap,
            "runs": seeds,
            "data_nats": float(np.median([r.data for r in runs])),
            "price_nats": float(np.median([r.price for r in runs])),
            "lower_taken": sum(r.taken for r in runs) / seeds,
            "reversals": sum(r.reversed for r in runs),
            "as_the_closed_form": float(np.mean([r.agrees for r in runs])),
            "weight_error": max(r.error for r in runs),
        }
