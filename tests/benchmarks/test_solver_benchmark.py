"""The solver benchmark compares what it says it compares."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from benchmarks.scenes import APART, ROOM, World
from benchmarks.solver import whitened
from benchmarks.solver.__main__ import main
from benchmarks.solver.ipopt import Program
from benchmarks.solver.measure import DENSE, NAMED, TWELVE, Size, asked, sizes, twelve
from benchmarks.solver.peers import FLOORS, PEERS, floor
from benchmarks.solver.problem import Problem, cold, warm
from benchmarks.solver.report import _panel, exponent, findings
from benchmarks.solver.shares import PARTS, shares
from fgplan import OccupancyGrid, SecondOrder
from fgplan.validation import validate

KEYS = ["n", "T", "K", "solver", "start", "p50_ms", "p95_ms", "max_ms", "iterations_p50"]
KEYS += ["energy_mean", "rss_mb"]


def small(n: int = 4, K: int = 2, seed: int = 0, **changes: Any) -> tuple[World, Problem]:
    world = World.random(seed, n)
    return world, cold(world.scenario(T=6, K=K, **changes))


def noisy(problem: Problem, scale: float) -> Any:
    """A random state near the first start."""
    rng = np.random.default_rng(1)
    state = problem.initial[0] + scale * rng.standard_normal(problem.initial[0].shape)
    state[0, :4] = problem.initial[0, 0, :4]
    return state


@pytest.mark.parametrize("gated", [False, True])
@pytest.mark.parametrize(("n", "crowd"), [(0, "joint"), (6, "joint"), (6, "predicted")])
def test_casadi_expression_has_fgplan_energy(n: int, crowd: Any, gated: bool) -> None:
    _, problem = small(n, crowd=crowd)
    program = Program.build(problem, gated)
    for scale in (0.0, 0.05, 0.5):
        for which in range(2):
            assert program.disagreement(noisy(problem, scale), which) < 1e-8


def test_casadi_expression_has_people_out_of_reach_too() -> None:
    world = World.random(3, 12, density=0.1)
    problem = cold(world.scenario(T=6, K=1))
    gate = problem.assembly.models[0].gate
    assert gate is not None
    assert len(gate.held) > 0
    assert len(gate.planned) > 1
    assert Program.build(problem).disagreement(noisy(problem, 0.3), 0) < 1e-8


def test_casadi_expression_refuses_what_it_leaves_out() -> None:
    grid = OccupancyGrid.from_polygons([], (-5, -5, 5, 5), 0.5)
    _, problem = small(grid=grid)
    with pytest.raises(ValueError, match="no map"):
        Program.build(problem)


def test_whitening_is_inverted_by_its_coordinates() -> None:
    _, problem = small()
    white, state = whitened.Whitening(problem.assembly, 1), noisy(problem, 0.3)
    assert white.state(white.coordinates(state)) == pytest.approx(state, abs=1e-10)


def test_whitened_prior_is_white() -> None:
    """Without potentials the energy rises by half the square of the coordinates."""
    _, problem = small(n=0)
    white = whitened.Whitening(problem.assembly, 0)
    state = problem.assembly.reference[0]
    q = problem.assembly.expand(state[None], np.zeros(1, dtype=np.intp))
    y = 1e-3 * np.random.default_rng(0).standard_normal(state.size)
    y[:4] = 0  # the robot's first state is given
    here, there = (problem.assembly.energy(white.state(v), np.array(0)) for v in (0 * y, y))
    slope = float(white.gradient(q.gradient[0]) @ y)
    assert float(there - here) == pytest.approx(slope + 0.5 * float(y @ y), rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_whitened_lbfgs_ends_at_a_stationary_point(seed: int) -> None:
    _, problem = small(seed=seed)
    end, _ = whitened.minimise(problem.assembly, problem.initial[0], 0)
    solution = SecondOrder().solve(problem.assembly, end[None], problem.which[:1])[0]
    assert solution.energy == pytest.approx(problem.assembly.energy(end, np.array(0)), abs=1e-6)


def test_all_peers_find_the_one_optimum_of_open_space() -> None:
    _, problem = small(n=0)
    ends = [peer.solve(problem, peer.prepare(problem))[0] for peer in PEERS]
    lowest = problem.energies(ends[0])
    for end in ends[1:]:
        assert problem.energies(end) == pytest.approx(lowest, abs=1e-7)


def test_every_part_of_a_plan_is_met() -> None:
    pytest.importorskip("numba")
    found = shares(Size(3, 8, 2), scenes=1)
    assert set(found) == set(PARTS)
    assert 0 < min(found.values()) < max(found.values()) == found["everything"]


def test_floor_is_the_least_time_of_a_few() -> None:
    _, problem = small()
    end = SecondOrder().solve(problem.assembly, problem.initial[:1], problem.which[:1])[0]
    for backend in FLOORS.values():
        ticks = iter([0.0, 5.0, 7.0, 9.5, 20.0, 24.0])  # three that take 5, 2.5 and 4 s
        which = int(problem.which[0])
        assert floor(problem, end.state, which, backend, ticks.__next__, repeat=3) == 2.5


def test_scenes_are_valid_and_repeat() -> None:
    for n in (0, 1, 30):
        world, again = World.random(7, n), World.random(7, n)
        assert np.array_equal(world.people, again.people)
        after = world.moved(world.robot), again.moved(again.robot)
        assert np.array_equal(after[0].seen[1], after[1].seen[1])
        validate(world.scenario(T=5, K=5))
        validate(after[0].scenario(T=5, K=5))
        distance = np.linalg.norm(world.people[:, None, :2] - world.people[None, :, :2], axis=-1)
        assert (distance + 9 * np.eye(n) > APART).all()
        assert (np.linalg.norm(world.people[:, :2], axis=1) > ROOM).all()


def test_warm_problem_begins_where_the_robot_is() -> None:
    world, before = small(n=5)
    solutions = SecondOrder().solve(before.assembly, before.initial, before.which)
    states = np.stack([s.state for s in solutions])
    after = warm(world, before, states, T=6, K=2)
    assert after.scenario.now == pytest.approx(0.2)
    assert after.initial[:, 0, :4] == pytest.approx(
        np.tile(before.best(states)[1, :4], (2, 1)), abs=1e-12
    )
    # One step on, a plan is nearly optimal again: far better than the plan's own path.
    fresh = after.assembly.models[0].initial(after.hypotheses[0].starts[0])
    assert after.energies(after.initial)[0] < after.assembly.energy(fresh, np.array(0)) + 50


def test_twelve_starts_are_twelve() -> None:
    world = World.random(0, 10)
    problem = twelve(cold(world.scenario(T=8, K=1, crowd="predicted")), seed=0)
    assert problem.initial.shape == (TWELVE, 9, 4)
    assert len({state.tobytes() for state in problem.initial}) == TWELVE


def test_all_sizes_of_the_issue_are_measured() -> None:
    every = sizes()
    for n in (0, 5, 10, 20, 50, 100):
        for T in (20, 30, 50):
            for K in (1, 3, 5):
                assert Size(n, T, K) in every


def test_the_exponent_of_n_is_fitted_to_one_density() -> None:
    assert {size.density for size in NAMED["dense"]} == {DENSE}
    assert len({size.n for size in NAMED["dense"]}) == len(NAMED["dense"]) == 4
    assert sizes(only=asked("dense")) == NAMED["dense"]
    assert sizes(only=asked("7,20,2")) == (Size(7, 20, 2),)


def test_json_alone_on_standard_output(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    picture = tmp_path / "solver.png"
    only = ["--short", "--only", "2,5,2", "--scenes", "2"]
    main([*only, "--json", "-", "--picture", str(picture)])
    captured = capsys.readouterr()

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    rows = json.loads(captured.out, parse_constant=refuse)
    names = {peer.name for peer in PEERS} | {*FLOORS, "fgplan.plan"}
    assert {(row["solver"], row["start"]) for row in rows} == {
        (name, start) for name in names for start in ("cold", "warm")
    }
    for row in rows:
        assert list(row)[: len(KEYS)] == KEYS
        assert (row["n"], row["T"], row["K"]) == (2, 5, 2)
        assert all(math.isfinite(row[key]) for key in KEYS[5:])
        assert row["p50_ms"] <= row["p95_ms"] <= row["max_ms"]
    assert picture.stat().st_size > 0
    assert "fgplan / floor" in captured.err


def test_predicted_people_have_rows_of_their_own(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    arguments = ["--only", "predicted", "--scenes", "1", "--picture", str(tmp_path / "p.png")]
    main([*arguments, "--json", str(tmp_path / "rows.json")])
    rows = json.loads((tmp_path / "rows.json").read_text(encoding="utf-8"))
    assert [(row["solver"], row["start"]) for row in rows[:2]] == [
        ("fgplan predicted x12", "cold"),
        ("fgplan predicted x12", "warm"),
    ]
    assert "predicted x12" in capsys.readouterr().out


@pytest.mark.parametrize("size", ["3", "1,2", "a,b,c", "-1,20,1", "5,0,1", "5,20,9"])
def test_bad_sizes_are_refused(size: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([f"--only={size}"])
    assert "got" in capsys.readouterr().err


def test_exponents_are_slopes() -> None:
    rows = [
        {"n": 10, "T": T, "K": 3, "solver": "fgplan", "start": "cold", "p50_ms": 2.0 * T**1.5}
        for T in (20, 30, 50)
    ]
    for row in rows:
        row["iterations_p50"] = 4.0
    assert exponent(rows, "T") == pytest.approx(1.5)
    assert "fgplan cold, n=10: time ~ T^1.50, per iteration ^1.50" in list(findings(rows))


def test_the_exponent_of_n_is_of_one_density_and_of_one_solver() -> None:
    shared = {"T": 30, "K": 3, "start": "warm", "iterations_p50": 4.0}
    rows = [
        {"n": n, "solver": name, "p50_ms": 3.0 * n, **shared}
        for n, name in (
            (10, "fgplan, 0.5 people/m2"), (20, "fgplan, 0.5 people/m2"), (50, "fgplan")
        )
    ]  # fmt: skip
    rows += [
        {"n": n, "solver": name, "p50_ms": 7.0, **shared}
        for n in (0, 5, 10)
        for name in ("fgplan, numpy", "floor, 0.5 people/m2", "floor, LAPACK, 0.5 people/m2")
    ]
    said = "fgplan warm, T=30, 0.5 people/m2: time ~ n^1.00, per iteration ^1.00"
    assert said in list(findings(rows))


def test_a_cold_plan_is_drawn_filled_and_a_warm_one_open() -> None:
    """Of one size there are no lines that would tell them apart."""
    rows = [
        {"n": 10, "T": 30, "K": 3, "solver": "fgplan", "start": start, "p50_ms": ms}
        for start, ms in (("cold", 10.0), ("warm", 8.0))
    ]
    axes = Figure().subplots()
    _panel(axes, rows, "n", "T", 30)
    drawn = {float(line.get_ydata()[0]): line.get_markerfacecolor() for line in axes.lines}
    assert drawn[10.0] == axes.lines[0].get_color()
    assert drawn[8.0] == "white"
