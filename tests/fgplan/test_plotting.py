"""Pictures: they exist, show what they should, and leave no global state."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

from fgplan.canvas import HYPOTHESES
from fgplan.inference import MAP
from fgplan.mixture import Mixture
from fgplan.occupancy import OccupancyGrid
from fgplan.planner import plan
from fgplan.plotting import draw_plan, draw_plans
from fgplan.scenario import FieldOfView, GivenPlan, Robot, Scenario, Track

START, GOAL = np.array([0.0, 0.0]), np.array([8.0, 0.0])


def standing(name: str, x: float, y: float) -> Track:
    """Somebody seen standing for two seconds."""
    times = np.linspace(-2.0, 0.0, 6)
    return Track(name, times, np.tile([x, y], (6, 1)))


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    """Two given plans past one person; another person is behind the robot and not seen."""
    return Scenario(
        Robot(START, np.array([0.8, 0.0])),
        goal=GOAL,
        tracks=(standing("a$b$", 3.0, 0.1), standing("behind", -1.0, 0.0)),
        field_of_view=FieldOfView(range=5.0, angle=2.0),
        plans=(
            GivenPlan("left", np.array([START, [4.0, 1.0], GOAL]), 1.0),
            GivenPlan("right", np.array([START, [4.0, -2.0], GOAL]), 0.5),
        ),
        count=0,
        name="one <in> the $way$",
    )


@pytest.fixture(scope="module")
def mixture(scenario: Scenario) -> Mixture:
    return plan(scenario)


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.findobj(Text)]


def test_picture_is_saved_with_content(
    mixture: Mixture, scenario: Scenario, tmp_path: Path
) -> None:
    path = tmp_path / "plan.png"
    draw_plan(mixture, scenario, path)
    with Image.open(path) as image:
        pixels = np.asarray(image.convert("RGB")).reshape(-1, 3)
    assert len(pixels) > 300_000
    for colour in (*HYPOTHESES[:2], "#0072b2"):  # both plans and the robot are there
        rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
        assert np.count_nonzero(np.abs(pixels - rgb).max(axis=1) < 12) > 100


def test_picture_says_what_is_selected(mixture: Mixture, scenario: Scenario) -> None:
    best = mixture.best
    assert best is not None
    shown = texts(draw_plan(mixture, scenario))
    title = f"{scenario.name}: selected {best.label} (P = {mixture.probability_height[0]:.2f}"
    assert any(text.startswith(title) for text in shown)
    assert {"x [m]", "y [m]", "1 s", "2 s", "3 s", "4 s", "a$b$", "behind"} <= set(shown)
    assert {"person not in view", "field of view"} <= set(shown)


def test_a_long_title_stays_above_its_map(scenario: Scenario, tmp_path: Path) -> None:
    given = (replace(scenario.plans[0], label="pharmacy>laboratory>ward_b"), scenario.plans[1])
    named = scenario.replace(plans=given, name="a round among people, as it was asked")
    figure = draw_plan(plan(named), named, tmp_path / "laid_out.png")
    axes = figure.axes[0]
    (title,) = (t for t in figure.findobj(Text) if t.get_text().startswith(named.name))
    assert title.get_window_extent().x1 <= axes.get_window_extent().x1
    assert "\n(P = " in title.get_text()


def test_a_label_hides_neither_the_goal_nor_the_robot(tmp_path: Path) -> None:
    """Just before the goal there is no room on the route."""
    near = Scenario(Robot(START, np.array([0.5, 0.0])), goal=np.array([1.2, 0.0]))
    figure = draw_plan(plan(near), near, tmp_path / "laid_out.png")
    (label,) = (t for t in figure.findobj(Text) if t.get_text() == "A  1.00")
    patch = label.get_bbox_patch()
    assert patch is not None
    for place in figure.axes[0].transData.transform(np.linspace(START, [1.2, 0.0], 20)):
        assert not patch.get_window_extent().contains(*place)


def test_where_nobody_has_evidence_mass_is_not_shown(scenario: Scenario) -> None:
    unweighed = plan(scenario, inference=MAP())
    assert unweighed.probability_mass.tolist() == [0.0, 0.0]
    assert not [text for text in texts(draw_plan(unweighed, scenario)) if "mass" in text]


def test_axes_are_equal_and_in_metres(mixture: Mixture, scenario: Scenario) -> None:
    axes = draw_plan(mixture, scenario).axes[0]
    assert axes.get_aspect() == 1
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    assert x0 < START[0] < GOAL[0] < x1
    assert y0 < -2.0 < 1.0 < y1


def test_no_hypothesis_is_safe(tmp_path: Path) -> None:
    """A robot too fast to stop before the people around it: the picture says that it stops."""
    ring = 0.9 * np.exp(1j * np.pi / 4 * np.arange(8))
    people = tuple(standing(str(i), p.real, p.imag) for i, p in enumerate(ring))
    boxed = Scenario(
        Robot(START, np.array([1.0, 0.0])), goal=GOAL, tracks=people, crowd="predicted"
    )
    stopped = plan(boxed)
    assert stopped.selected is None
    shown = texts(draw_plan(stopped, boxed, tmp_path / "stop.png"))
    assert "scenario: stops, no hypothesis is safe" in shown
    assert any("refused" in text for text in shown)
    assert "planned with the robot" not in shown  # they are held at their prediction


def test_the_title_says_when_the_stop_is_not_clear() -> None:
    wall = OccupancyGrid.from_polygons([[(2, -3), (3, -3), (3, 3), (2, 3)]], (-2, -4, 8, 4), 0.1)
    fast = Scenario(Robot(START, np.array([9.0, 0.0])), goal=np.array([6.0, 0.0]), grid=wall)
    assert "scenario: stops, no hypothesis is safe, and the stop is NOT CLEAR" in texts(
        draw_plan(plan(fast), fast)
    )


def test_without_goal_people_and_map() -> None:
    alone = Scenario(Robot(START, np.array([0.8, 0.0])))
    shown = texts(draw_plan(plan(alone), alone))
    assert "goal" not in shown
    assert "person now" not in shown
    assert "no goal  1.00" in shown


def test_map_is_drawn_where_it_is() -> None:
    """A rotated map: the picture's corners are the map's."""
    data = np.zeros((40, 60), dtype=np.int8)
    grid = OccupancyGrid(data, 0.2, np.array([-2.0, -4.0, 0.3]))
    scene = Scenario(Robot(START), goal=np.array([2.0, 1.0]), grid=grid)
    figure = draw_plan(plan(scene), scene)
    figure.canvas.draw()
    axes = figure.axes[0]
    image = axes.images[0]
    corners = np.array([[0, 0], [60, 0], [60, 40], [0, 40]], dtype=float)
    shown = axes.transData.inverted().transform(image.get_transform().transform(corners))
    expected = grid.cell_to_world(corners[:, ::-1] - 0.5)
    assert shown == pytest.approx(expected, abs=1e-9)


def test_several_plans_share_one_figure(
    mixture: Mixture, scenario: Scenario, tmp_path: Path
) -> None:
    figure = draw_plans([(mixture, scenario), (mixture, scenario)], tmp_path / "two.png")
    assert sum(axes.get_xlabel() == "x [m]" for axes in figure.axes) == 2


def test_pyplot_is_not_used() -> None:
    import subprocess

    program = "import sys, fgplan.plotting; print('matplotlib.pyplot' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parents[2],
    )
    assert done.stdout.strip() == "False"
