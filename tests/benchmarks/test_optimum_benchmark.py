"""The best known is found, counted and remembered as the benchmark says."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.optimum.__main__ import main
from benchmarks.optimum.best import MultiStart, Score, best_known, gap, score
from benchmarks.optimum.measure import (
    DEADLINES,
    Known,
    Made,
    best_of_all,
    fingerprint,
    read,
    rows_of,
    summary,
    write,
)
from benchmarks.optimum.scenes import Scene, random_scene, recorded_scenes
from benchmarks.scenes import World, smooth
from fgplan import Scenario, plan
from fgplan.validation import validate
from tests.pedestrians import FOLDER, needs_recordings


def tiny(seed: int = 0) -> Scenario:
    """Two people, five steps, one plan."""
    return World.random(seed, 2).scenario(T=5, K=1)


def test_best_known_is_at_least_as_good_as_the_plan() -> None:
    now = tiny()
    known, _ = best_known(now, seed=0, starts=4)
    assert known.safe >= score(plan(now)).safe - 1e-6


def test_many_starts_give_every_start_an_answer() -> None:
    """The planner gets a solution for each start it asked for, the best of them first."""
    solver = MultiStart(seed=0, starts=3)
    now = tiny(1)
    mixture = plan(now, solver=solver)
    assert mixture.components[0].energy <= plan(now).components[0].energy + 1e-6
    # Where there is one optimum, both optimisers find it.
    alone = MultiStart(seed=0, starts=3)
    plan(World.random(0, 0).scenario(T=5, K=1), solver=alone)
    assert {"second order from given", "L-BFGS from given"} <= set(alone.found_by)


def test_gap_counts_safe_plans_first() -> None:
    assert gap(Score(-3.0, -3.0), Score(-2.0, -1.0)) == 1.0
    assert gap(Score(-np.inf, -1.0), Score(-2.0, -1.0)) == np.inf
    assert gap(Score(-np.inf, -1.5), Score(-np.inf, -1.0)) == 0.5
    assert gap(Score(-2.0, -1.0), Score(-2.0 - 1e-9, -1.0)) == 0.0


def test_starts_are_bent_smoothly_and_not_now() -> None:
    """Velocities are the derivative of positions."""
    times = np.linspace(0, 4, 401)
    shift = smooth(np.random.default_rng(0), times, 1.0)
    assert np.allclose(shift[0], 0)
    assert np.abs(shift[:, :2]).max() > 0.1
    slope = np.gradient(shift[:, :2], times, axis=0)
    assert shift[1:-1, 2:] == pytest.approx(slope[1:-1], abs=1e-3)


def test_rows_and_summary() -> None:
    plans = [
        Made("cold", 0.2, None, Score(-1.0, -1.0), "plan"),
        Made("cold, 50 ms", 0.06, 0.05, Score(-np.inf, -1.0), "stop"),
    ]
    rows = rows_of("random 0", tiny(), plans, Known(Score(-0.97, -0.97), "", ""))
    assert [row["gap"] for row in rows] == [pytest.approx(0.03), None]
    assert rows[1]["late_ms"] == pytest.approx(10.0)
    cold, late = summary(rows)
    assert (cold["scenes"], cold["mode"], cold["close"]) == ("random", "cold", 1.0)
    assert (late["close"], late["gap_p50"], late["stops_in_vain"]) == (0.0, None, 1)
    json.dumps([cold, late], allow_nan=False)


def test_best_known_is_kept_and_used_again(tmp_path: Path) -> None:
    now, cache, ticks = tiny(), tmp_path / "best.csv", []
    better = Known(Score(1e6, 1e6), "a guess", fingerprint(now, 2))
    write(cache, {"a": better, "b": better})
    assert read(cache) == {"a": better, "b": better}
    known = best_of_all({"a": now}, 2, cache, 1, lambda: ticks.append(1))
    assert known == {"a": better}
    # Another effort, or another density, is another question.
    again = best_of_all({"a": now}, 1, cache, 1, lambda: ticks.append(1))
    assert again["a"].score.safe < 1e6
    assert read(cache) == {"a": again["a"], "b": better}
    assert len(ticks) == 2


def test_fingerprint_changes_with_the_density() -> None:
    now = tiny()
    for change in ({"h_c": 0.3}, {"limit_sigma": 5.0}, {"contact_margin": 0.4}):
        other = now.replace(density=replace(now.density, **change))
        assert fingerprint(now, 2) != fingerprint(other, 2)
    slower = now.replace(robot=replace(now.robot, max_acceleration=0.5))
    assert fingerprint(now, 2) != fingerprint(slower, 2)
    assert fingerprint(now, 2) == fingerprint(tiny(), 2)


def one_step_apart(scene: Scene) -> bool:
    """Whether both moments are valid, the second one step after the first, with the robot where it
    is put."""
    state = scene.before.robot.state + np.array([0.3, 0.0, 0.0, 0.0])
    now = scene.then(state)
    validate(scene.before)
    validate(now)
    later = now.now - scene.before.now == pytest.approx(now.density.dt)
    return later and np.array_equal(now.robot.state, state)


def test_random_scenes_are_valid_and_one_step_apart() -> None:
    for seed in range(5):
        assert one_step_apart(random_scene(seed))


@needs_recordings
def test_recorded_scenes_are_valid_and_one_step_apart() -> None:
    few, more = recorded_scenes(FOLDER, 2), recorded_scenes(FOLDER, 3)
    assert [scene.name for scene in few] == [scene.name for scene in more[:2]]
    assert one_step_apart(few[0])


def test_command_prints_strict_json_and_says_what_it_left_out(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    nowhere = ["--recordings", str(tmp_path / "nowhere"), "--csv", str(tmp_path / "o.csv")]
    main(["--short", "--random", "1", "--jobs", "1", "--json", "-", *nowhere])
    captured = capsys.readouterr()

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    rows = json.loads(captured.out, parse_constant=refuse)
    assert len(rows) == 2 * (1 + len(DEADLINES))
    assert {row["scenes"] for row in rows} == {"random"}
    assert "recorded scenes left out" in captured.err
    assert (tmp_path / "o.csv").read_text(encoding="utf-8").startswith("scene,people,mode,gap")
