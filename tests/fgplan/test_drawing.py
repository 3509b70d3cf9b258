"""The factor graph as text and as a drawing: everything is there, whatever it is called."""

from __future__ import annotations

import re

import gtsam
import numpy as np
import pytest

from fgplan import keys
from fgplan.drawing import COLUMN, describe, dot, models, symbol
from fgplan.errors import ScenarioError
from fgplan.model import Model
from fgplan.scenario import Density, GivenPlan, Level, Robot, Scenario, Track


@pytest.fixture(scope="module")
def model() -> Model:
    """Two levels with awkward names, one person, an uncertain robot, a factor of the user's."""
    path = np.array([[0.0, 0.0], [5.0, 0.0]])
    scenario = Scenario(
        Robot(path[0], np.array([0.8, 0.0]), covariance=0.01 * np.eye(4)),
        tracks=(Track("anna", np.array([-0.4, 0.0]), np.array([[3.4, 1.0], [3.0, 1.0]])),),
        plans=(GivenPlan("straight", path),),
        count=0,
        levels=(Level('the "best" <one> & only', sigma=0.3), Level("tactics", sigma=np.inf, h=0.2)),
        density=Density(horizon=2.0),
    )
    noise = gtsam.noiseModel.Isotropic.Sigma(4, 1.0)
    mine = gtsam.PriorFactorVector(keys.robot(2), np.zeros(4), noise)
    return models(scenario, [mine])["straight"]


def test_text_counts_what_the_graph_holds(model: Model) -> None:
    text = describe(model)
    variables, numbers, factors = (int(n) for n in re.findall(r"\d+", text.splitlines()[0]))
    assert factors == model.graph().size()
    assert variables == len(model.keys) == model.values(model.reference).size()
    assert numbers == model.reference.size
    for term in model.terms:
        assert re.search(rf"^{re.escape(term.name)} .* {len(term.steps)} ", text, flags=re.M)
    assert re.search(r"^yours +robot\(2\) ", text, flags=re.M)


def test_every_term_has_its_symbol(model: Model) -> None:
    assert all(symbol(term) for term in model.terms)
    named = {term.name: symbol(term) for term in model.terms}
    assert named["interaction"] == "ψ_int"
    assert named["tactics coupling"] == "ψ(η, ·)"


def test_drawing_has_one_node_a_variable_and_one_a_factor(model: Model) -> None:
    drawing = dot(model)
    assert drawing.count("shape=circle") == len(model.keys)
    assert drawing.count("shape=square") == model.graph().size()
    assert drawing.count("{") == drawing.count("}") == 1


def test_names_cannot_break_out_of_the_drawing(model: Model) -> None:
    drawing = dot(model)
    assert r"the \"best\" <one> & only now 0" in drawing
    assert "the &quot;best&quot; &lt;one&gt; &amp; only now" in drawing  # in the legend's table


def test_time_steps_are_columns_and_no_factor_hides_another(model: Model) -> None:
    found = re.findall(r'"(.+?)" \[pos="(-?[\d.]+),(-?[\d.]+)!"', dot(model))
    places = {name: (float(x), float(y)) for name, x, y in found}
    assert len(set(places.values())) == len(places)
    for (name, k), key in model.keys.items():
        x, y = places[keys.name(key)]
        assert x == pytest.approx(COLUMN * k, abs=0.01)
        assert y == places[keys.name(model.keys[name, 0])][1]


def test_known_state_is_grey() -> None:
    alone = models(Scenario(Robot(np.zeros(2))))["no goal"]
    assert dot(alone).count('fillcolor="#cccccc"') == 1
    assert "robot        4  0..12  known exactly at 0" in describe(alone)


def test_senseless_scenario_is_refused() -> None:
    with pytest.raises(ScenarioError):
        models(Scenario(Robot(np.array([np.nan, 0.0]))))
