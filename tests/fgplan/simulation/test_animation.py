"""Films, where there is little to show."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from fgplan.simulation.animation import film
from fgplan.simulation.peers import Straight
from fgplan.simulation.world import Event, Rules, World
from tests.fgplan.simulation.worlds import Breaks, Stands, passer, world


def last(path: Path) -> np.ndarray:
    """The last picture of a film."""
    with Image.open(path) as pictures:
        pictures.seek(pictures.n_frames - 1)
        return np.asarray(pictures.convert("RGB"))


def test_a_run_that_ends_before_a_step_is_one_picture(tmp_path: Path) -> None:
    episode = film(world([passer(1.0, 1.0, 0.0, 1.0)]), Breaks(), tmp_path / "run.gif")
    assert episode.end == "error"
    with Image.open(tmp_path / "run.gif") as pictures:
        assert pictures.n_frames == 1


def test_a_world_without_map_and_goal_is_shown(tmp_path: Path) -> None:
    made = world()
    made = replace(made, scenario=made.scenario.replace(goal=None))
    film(made, Stands(), tmp_path / "run.gif")
    assert last(tmp_path / "run.gif").size > 0


def test_the_goal_stays_where_it_is_when_facts_alone_change(tmp_path: Path) -> None:
    def pictured(*events: Event) -> np.ndarray:
        made: World = world(rules=Rules(time_limit=1.0), events=events)
        film(made, Straight(made), tmp_path / "run.gif")
        return last(tmp_path / "run.gif")

    elsewhere = Event(0.2, np.array([2.0, 0.0]))
    assert np.array_equal(pictured(Event(0.5, facts={"shut": True})), pictured())
    assert not np.array_equal(pictured(elsewhere), pictured())
