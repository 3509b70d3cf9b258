"""What one step of driving leaves for the next one."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from fgplan.driving.deliberation import Deliberation
from fgplan.driving.intake import Refused
from fgplan.driving.news import News
from fgplan.driving.observation import Observation
from fgplan.driving.operating import Operated
from fgplan.driving.pricing import Blockage
from fgplan.driving.routing import Routes
from fgplan.driving.tracking import People
from fgplan.mixture import Mixture
from fgplan.scenario import Scenario
from fgplan.trajectory import Trajectory

NEARER = 0.1
"""Who has so much less to go makes progress [m]."""
NOWHERE = (np.inf, -np.inf)
"""Before there is any progress."""


@dataclass(frozen=True, eq=False)
class Memory:
    """What one step leaves for the next one.

    Args:
        scenario: What was known.
        observation: The last one that was believed; None before the first.
        people: Everybody who is followed.
        routes: The global plans.
        blockages: Where people stood in the way.
        mixture: The last plan, for a warm start.
        trajectory: What is being driven, None before the first observation.
        started: When that began [s].
        clear: Whether the last plan could be driven as it was.
        followed: Name of the hypothesis that is followed.
        deliberation: How much better others have looked of late.
        operated: What the operator said.
        refused: The last observation, if it was not believed.
        news: What was said in observations that were not used.
        nearest: How little was left to go so far on the way that is followed [m], and since when
            [s].
    """

    scenario: Scenario
    observation: Observation | None = None
    people: People = field(default_factory=People)
    routes: Routes = field(default_factory=Routes)
    blockages: tuple[Blockage, ...] = ()
    mixture: Mixture | None = None
    trajectory: Trajectory | None = None
    started: float = 0.0
    clear: bool = True
    followed: str | None = None
    deliberation: Deliberation = Deliberation()  # noqa: RUF009 - frozen
    operated: Operated = field(default_factory=Operated)
    refused: Refused | None = None
    news: News = field(default_factory=News)
    nearest: tuple[float, float] = NOWHERE

    @property
    def jumped(self) -> bool:
        """Whether the last observation was not believed because the robot jumped."""
        return self.refused is not None and self.refused.kind == "jump"

    def on_new_clock(self) -> Memory:
        """What has no time on the old one: people and what is driven begin anew."""
        return Memory(
            self.scenario,
            routes=replace(self.routes, searched=-np.inf),
            followed=self.followed,
            deliberation=Deliberation(self.followed),
            operated=self.operated.on_new_clock(),
            news=self.news.on_new_clock(),
        )

    @property
    def to_go(self) -> float:
        """Along the way that is followed, or else the shortest [m]; inf where there is none."""
        ways = [way for way in self.routes.ways if way.label == self.followed] or self.routes.ways
        return min((way.to_go for way in ways), default=np.inf)

    def progress(self) -> tuple[float, float]:
        """`nearest`, from where the robot is now."""
        scenario = self.scenario
        if (scenario.goal is None and scenario.mission is None) or not self.routes.ways:
            return np.inf, scenario.now
        best, when = self.nearest
        return (self.to_go, scenario.now) if self.to_go < best - NEARER else (best, when)

    def rerouted(self, routes: Routes) -> Memory:
        """With the routes of now. Where a new map makes the way longer, progress begins anew."""
        after = replace(self, routes=routes)
        longer = routes.grid is not self.routes.grid and after.to_go > self.to_go + NEARER
        return replace(after, nearest=NOWHERE) if longer else after

    def following(self, label: str) -> Memory:
        """With the route that is followed from now on; on another one, progress begins anew."""
        return replace(
            self,
            followed=label,
            nearest=self.progress() if label == self.followed else NOWHERE,
            deliberation=self.deliberation.following(label, self.scenario.now),
        )
