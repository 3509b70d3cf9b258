"""What is drawn in a picture of a film."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

from fgplan.canvas import ROBOT
from fgplan.regions import Region
from fgplan.simulation import animation
from fgplan.simulation.file import FromFile
from fgplan.simulation.planners import named
from fgplan.simulation.world import Rules
from tests.fgplan.simulation.worlds import world

HOSPITAL = Path(__file__).parents[3] / "data" / "scenarios" / "hospital.toml"


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Those that a film is made of."""
    drawn: list[Figure] = []

    def canvas(figure: Figure) -> Any:
        drawn.append(figure)
        return FigureCanvasAgg(figure)  # type: ignore[no-untyped-call]

    monkeypatch.setattr(animation, "FigureCanvasAgg", canvas)
    return drawn


def test_axes_have_units_and_regions_their_names(figures: list[Figure], tmp_path: Path) -> None:
    shelf = Region.box("shelf", 1.0, -1.0, 3.0, 1.0)
    far = Region.disc("far", (50.0, 0.0), 1.0)
    made = world(rules=Rules(time_limit=0.4))
    made = replace(made, scenario=made.scenario.replace(regions=(shelf, far)))
    animation.film(made, named("fgplan")(made), tmp_path / "run.gif")
    for figure in figures:
        above, below = figure.axes
        assert (above.get_xlabel(), above.get_ylabel()) == ("x [m]", "y [m]")
        assert above.get_aspect() == 1
        assert below.get_xlabel() == "time since the start [s]"
        assert below.get_ylabel() == "probability by height"
        said = [text.get_text() for text in figure.findobj(Text)]
        assert "shelf" in said
        assert "far" not in said  # it is not in the picture
        assert any("the one that is followed" in text for text in said)


def test_small_things_keep_their_colour(tmp_path: Path) -> None:
    """A picture of a GIF has few colours; that of the robot's small disc is among them."""
    made = FromFile(HOSPITAL, (("world.time_limit", "0.4"),))(0)
    animation.film(made, named("fgplan")(made), tmp_path / "run.gif")
    with Image.open(tmp_path / "run.gif") as film:
        pixels = np.asarray(film.convert("RGB")).reshape(-1, 3).astype(int)
    robot = [int(ROBOT[i : i + 2], 16) for i in (1, 3, 5)]
    assert np.count_nonzero(np.abs(pixels - robot).max(axis=1) < 8) > 40
