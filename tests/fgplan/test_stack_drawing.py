"""The stack as text and as a picture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from fgplan import Level, Mission, Region, Robot, Scenario
from fgplan.cli import app
from fgplan.factorisation import factorise
from fgplan.stack_drawing import SHOWN, describe, draw
from fgplan.tactical import Deadline

DATA = Path(__file__).parents[2] / "data" / "scenarios"
TREE = (
    Level("mission", sigma=0.5, h=0.5),
    Level("left $x$", sigma=np.inf, Qc=0.5, h=0.2, every=2),
    Level("right", sigma=np.inf, h=0.3, follows="mission"),
)


@pytest.fixture(scope="module")
def tree() -> Scenario:
    gate = Region.disc("gate", (2.0, 0.0), 0.5)
    goal = np.array([4.0, 0.0])
    data = (Deadline(gate, 3.0, on="right"),)
    return Scenario(Robot(np.zeros(2)), goal, levels=TREE, regions=(gate,), data=data)


def test_text_has_a_row_a_level_and_a_row_a_coupling(tree: Scenario) -> None:
    text = describe(tree, factorise(tree))
    for said in (
        "3 levels above the robot",
        "left $x$  mission, h 0.5 m²",
        "flat",
        "every 0.8 s",
        "Deadline gate",
        "· ψ(mission, left $x$) · ψ(mission, right) · ψ(left $x$, robot) · ψ(right, robot)",
        "mission – left $x$",
        "right – robot",
    ):
        assert said in text


def test_picture_shows_every_variable_and_every_level(tree: Scenario, tmp_path: Path) -> None:
    picture = tmp_path / "new" / "stack.png"
    left, right = draw(tree, picture).axes
    assert picture.stat().st_size > 10_000
    said = [text.get_text() for text in left.texts]
    for level in TREE:
        assert any(text.startswith(level.name) for text in said)
    assert {"h 0.5 m²", "h 0.2 m²", "h 0.3 m²", "Deadline gate"} <= set(said)
    drawn = {text.get_text() for text in right.texts}
    for k in range(SHOWN):
        assert {f"η0,{k}", f"η1,{k}", f"η2,{k}", f"r{k}"} <= drawn
    legend = right.get_legend()
    assert legend is not None
    terms = " ".join(text.get_text() for text in legend.get_texts())
    assert "mission to right coupling" in terms


def test_no_factor_hides_another() -> None:
    _, right = draw(Scenario.load(DATA / "delivery.toml")).axes
    squares = [
        tuple(np.round(one.get_offsets()[0], 3))  # type: ignore[index]
        for one in right.collections
        if len(one.get_paths()) and len(one.get_paths()[0].vertices) == 5
    ]
    assert len(squares) > 20
    assert len(set(squares)) == len(squares)


def test_a_mission_shows_its_formula_and_what_it_forbids() -> None:
    robot, wet = Robot(np.zeros(2)), Region.disc("wet", (2.0, 0.0), 0.5)
    levels = (Level("mission", sigma=0.5), Level("tactics", sigma=np.inf, h=0.2))
    goal = Region.disc("desk", (4.0, 0.0), 0.4)
    mission = Mission("F desk & G !wet")
    asked = Scenario(robot, regions=(wet, goal), mission=mission, levels=levels)
    text = describe(asked, factorise(asked))
    assert "3 best of F desk & G !wet" in text
    assert "KeepOut wet" in text


def test_an_infinite_divergence_is_explained() -> None:
    """In the hall people push the robot off A, where the mission holds it."""
    asked = Scenario.load(DATA / "hall.toml")
    report = factorise(asked)
    (coupling,) = report.couplings
    assert (coupling.divergence, coupling.divergence_robot) == (np.inf, np.inf)
    text = describe(asked, report)
    assert "inf of the robot: only the coupling makes this plan an optimum" in text
    assert "not of the robot" not in text
    spare = replace(report, couplings=(replace(coupling, divergence_robot=0.0),))
    assert "inf, but not of the robot: only the coupling holds a level" in describe(asked, spare)
    plain = replace(report, couplings=(replace(coupling, divergence=1.0, divergence_robot=0.5),))
    assert "inf" not in describe(asked, plain)


def test_command_prints_and_draws(tmp_path: Path) -> None:
    picture = tmp_path / "stack.svg"
    file = str(DATA / "three_levels.toml")
    done = CliRunner().invoke(app, ["stack", file, "--out", str(picture)])
    assert done.exit_code == 0, done.output
    assert "3 levels above the robot" in done.output
    assert picture.read_text(encoding="utf-8").count("<path") > 50


def test_command_refuses_a_hypothesis_that_does_not_exist(tmp_path: Path) -> None:
    file = str(DATA / "three_levels.toml")
    done = CliRunner().invoke(app, ["stack", file, "--hypothesis", "Z"])
    assert done.exit_code == 2
    assert "is none of" in done.output


def test_the_page_shows_what_is_printed() -> None:
    page = (DATA.parents[1] / "docs" / "stacks.md").read_text(encoding="utf-8")
    block = page.partition("```text\n")[2].partition("```")[0]
    asked = Scenario.load(DATA / "three_levels.toml")
    assert block.strip() in describe(asked, factorise(asked))
