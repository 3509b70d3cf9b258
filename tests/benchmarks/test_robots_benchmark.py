"""The benchmark of robots with wheels, in short: what it says, not how fast."""

from __future__ import annotations

import json

from hypothesis import example, given, settings
from hypothesis import strategies as st

from benchmarks.robots import MODELS, run, scene
from benchmarks.robots.__main__ import main
from fgplan import plan


def test_optima_hardly_slide_and_what_is_driven_does_not() -> None:
    rows = run(4)
    assert {row.model for row in rows} == set(MODELS)
    for row in rows:
        assert row.converged == row.within == 1
        assert row.slip_optimum_mm < 1
        assert row.slip_driven_mm < 1e-6
        assert row.iterations_p50 <= 25


@given(st.sampled_from(list(MODELS)), st.sampled_from(["along", "reversed"]), st.integers(0, 9999))
@example("car that reverses", "along", 47)  # these five changed direction with turned wheels
@example("car", "reversed", 26)
@example("car that reverses", "reversed", 1)
@example("car that reverses", "reversed", 26)
@example("car that reverses", "reversed", 42)
@settings(max_examples=25, deadline=None)
def test_every_optimum_keeps_the_limits_of_its_robot(name: str, start: str, seed: int) -> None:
    """Whether or not it is safe: among people, from a robot that looks anywhere."""
    scenario = scene(seed, MODELS[name], start)
    mixture = plan(scenario)
    for component in mixture.components:
        assert MODELS[name].problems(scenario.robot, component.robot) == []


def test_it_prints_json_alone(capsys) -> None:
    main(["--scenes", "2", "--json", "-"])
    rows = json.loads(capsys.readouterr().out, parse_constant=lambda name: 1 / 0)
    assert {row["start"] for row in rows} == {"along", "reversed"}
