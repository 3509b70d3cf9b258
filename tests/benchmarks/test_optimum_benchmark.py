"""The best known is found, counted and remembered as the benchmark says."""

from __future__ import annotations

import json
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
from fgplan import plan
from fgplan.validation import validate
from tests.pedestrians import FOLDER, needs_recordings


def tiny(seed: int = 0) -> Scene:
    """Two people, five steps, one plan."""
    world = World.random(seed, 2)
    before, now = (w.scenario(T=5, K=1) for w in (world, world.moved(world.robot)))
    return Scene(f"random {seed}", before, now)


def test_best_known_is_at_least_as_good_as_the_plan() -> None:
    scene = tiny()
    known, found_by = best_known(scene.now, seed=0, starts=4)
    assert gap(score(plan(scene.now)), known) == pytest.approx(
        known.safe - score(plan(scene.now)).safe, abs=1e-6
    )
    assert "second order" in found_by or "L-BFGS" in found_by


def test_many_starts_give_every_start_an_answer() -> None:
    """The planner gets a solution for each start it asked for, the best of them first."""
    solver = MultiStart(seed=0, starts=3)
    scene = tiny(1)
    mixture = plan(scene.now, solver=solver)
    assert mixture.components[0].energy <= plan(scene.now).components[0].energy + 1e-6
    assert sum(solver.found_by.values()) >= 1


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
    rows = rows_of(tiny(), plans, Known(Score(-0.97, -0.97), "", ""))
    assert [row["gap"] for row in rows] == [pytest.approx(0.03), None]
    assert rows[1]["late_ms"] == pytest.approx(10.0)
    cold, late = summary(rows)
    assert (cold["scenes"], cold["mode"], cold["close"]) == ("random", "cold", 1.0)
    assert (late["close"], late["gap_p50"], late["stops_in_vain"]) == (0.0, None, 1)
    json.dumps([cold, late], allow_nan=False)


def test_best_known_is_kept_and_used_again(tmp_path: Path) -> None:
    scene, cache, ticks = tiny(), tmp_path / "best.csv", []
    better = Known(Score(1e6, 1e6), "a guess", fingerprint(scene.now, 2))
    write(cache, {scene.name: better})
    assert read(cache) == {scene.name: better}
    known = best_of_all([scene], 2, cache, 1, lambda: ticks.append(1))
    assert known[scene.name] == better
    # Another effort, or another density, is another question.
    again = best_of_all([scene], 1, cache, 1, lambda: ticks.append(1))
    assert again[scene.name].score.safe < 1e6
    assert read(cache)[scene.name].fingerprint == fingerprint(scene.now, 1)
    assert len(ticks) == 2


def test_random_scenes_are_valid_and_one_step_apart() -> None:
    for seed in range(5):
        scene = random_scene(seed)
        validate(scene.before)
        validate(scene.now)
        assert scene.now.now - scene.before.now == pytest.approx(scene.now.density.dt)


@needs_recordings
def test_recorded_scenes_are_valid_and_one_step_apart() -> None:
    for scene in recorded_scenes(FOLDER, 2):
        validate(scene.now)
        assert scene.now.now - scene.before.now == pytest.approx(scene.now.density.dt)


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
