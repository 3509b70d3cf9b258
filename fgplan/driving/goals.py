"""No goal is known: which of several places the operator is going to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fgplan.conditioning import infer
from fgplan.crowd import Belief, believe
from fgplan.driving.observation import Intent, Observation
from fgplan.driving.operating import Operated
from fgplan.driving.recollection import Recollection
from fgplan.driving.routing import Routes, Routing
from fgplan.errors import NoRoute
from fgplan.hypotheses import hypothesise
from fgplan.hypothesis import Hypothesis
from fgplan.scenario import GivenPlan, Scenario
from fgplan.shared_control import Candidate


class CandidateGoals:
    """A source of hypotheses for a `Planner` without a goal: the way to each candidate.

    All are equally probable before the operator says anything. A way is searched as routes are,
    once a second, and joined to where the robot is in between.

    Args:
        candidates: Given, or found by `fgplan.shared_control.find_candidates`.
        routing: How ways are kept up to date.
    """

    def __init__(
        self,
        candidates: Sequence[Candidate],
        routing: Routing = Routing(),  # noqa: B008 - frozen
    ) -> None:
        self.candidates = tuple(candidates)
        self.routing = routing
        self._routes: dict[str, Routes] = {}

    def __call__(self, scenario: Scenario, belief: Belief) -> Sequence[Hypothesis]:
        found = []
        for candidate in self.candidates:
            towards = scenario.replace(goal=candidate.position, count=1, plans=())
            before = self._routes.get(candidate.label, Routes())
            routes = before.update(towards, self.routing, None)
            self._routes[candidate.label] = routes
            if routes.ways:
                given = GivenPlan(candidate.label, routes.ways[0].path, 1.0)
                try:
                    own = hypothesise(towards.replace(plans=(given,), count=0), belief)
                except NoRoute:
                    continue
                found.append(replace(own[0], log_prior=0.0))
        return found


class GoalInference:
    """Tells where an operator is going who drives by hand: the same density, without a robot's
    plan of its own.

    p(i | z^h) of the ways to the candidates, each datum on the way as it was when the datum came.
    Around a way, a level with a width is integrated out.

    Args:
        scenario: Robot, map and levels; its goal is not used.
        candidates: Places they may be going to.
        routing: How ways are kept up to date.

    Raises:
        ValueError: a level of the scenario has sigma = inf, and so no way that it is around.
    """

    def __init__(
        self,
        scenario: Scenario,
        candidates: Sequence[Candidate],
        routing: Routing = Routing(),  # noqa: B008 - frozen
    ) -> None:
        self.goals = CandidateGoals(candidates, routing)
        self.operated = Operated(past=Recollection())  # candidates keep their names
        self._scenario = scenario.replace(goal=None, tracks=(), data=())
        infer(self._scenario, ())  # refuses a level that it could not weigh
        d = scenario.density
        self._nobody = believe((), scenario.now, d.Qc_people, d.sigma_track, d.sigma_speed)

    def step(self, observation: Observation) -> Intent:
        """What is known after a look at where the robot is and what the operator says.

        Raises:
            NoRoute: nothing leads to any of the candidates.
        """
        robot = replace(
            self._scenario.robot,
            position=np.asarray(observation.position, dtype=float),
            velocity=np.asarray(observation.velocity, dtype=float),
            heading=observation.heading,
        )
        scenario = self._scenario.replace(robot=robot, now=float(observation.time))
        operated, _ = self.operated.hear(observation.operator, scenario)
        scenario = scenario.replace(data=operated.data)
        ways = self.goals(scenario, self._nobody)
        if not ways:
            raise NoRoute("NO_VALID_PATH", "nothing leads to any of the candidates")
        uniform = [replace(way, log_prior=-float(np.log(len(ways)))) for way in ways]
        weighed = infer(scenario, operated.recalled(uniform, scenario.now, None))
        probability = {h.label: float(np.exp(h.log_prior)) for h in weighed}
        operated = operated.note(ways, scenario, None)
        self.operated = operated.conclude(probability, scenario.now)
        best = self.operated.best
        return Intent(probability, None if best is None else best[1], None)
