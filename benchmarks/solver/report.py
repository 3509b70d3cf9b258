"""Rows → a table, what they say, and a picture."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.scenes import DENSE

Row = dict[str, Any]

REFERENCE = (10, 30, 3)
"""n, T, K at which the ratios are taken, where they were measured."""
COLOURS = {  # Okabe and Ito's, told apart by the colour-blind
    "fgplan": "#0072B2",
    "fgplan.plan": "#56B4E9",
    "fgplan, numpy": "#F0E442",
    "GTSAM LM": "#E69F00",
    "CasADi + IPOPT": "#D55E00",
    "CasADi + IPOPT, gated": "#CC79A7",
    "whitened L-BFGS": "#009E73",
    "floor": "#000000",
    "floor, LAPACK": "#999999",
}


def table(rows: Sequence[Row]) -> Table:
    """All rows, times in ms."""
    headings = ("n", "T", "K", "solver", "start", "p50 ms", "p95 ms", "max ms", "iterations")
    shown = Table(*headings, "energy", "RSS MB", "build ms", "scenes", box=None, pad_edge=False)
    for column in shown.columns:
        column.justify = "left" if column.header in {"solver", "start"} else "right"
        column.no_wrap = True
    for row in rows:
        times = [f"{row[key]:.1f}" for key in ("p50_ms", "p95_ms", "max_ms")]
        size = [str(row[key]) for key in ("n", "T", "K")]
        numbers = [f"{row['iterations_p50']:.0f}", f"{row['energy_mean']:.3f}"]
        rest = [f"{row['rss_mb']:.0f}", f"{row['build_ms']:.0f}", str(row["scenes"])]
        shown.add_row(*size, row["solver"], row["start"], *times, *numbers, *rest)
    return shown


def findings(rows: Sequence[Row]) -> Iterator[str]:
    """Ratios at one size and fitted exponents, in words."""
    sizes = {(row["n"], row["T"], row["K"]) for row in rows if row["solver"] == "floor"}
    if sizes:
        size = REFERENCE if REFERENCE in sizes else max(sizes)
        yield from _ratios(rows, size)
    yield from _exponents(rows)


def _ratios(rows: Sequence[Row], size: tuple[int, int, int]) -> Iterator[str]:
    for row in rows:
        at, name = (row["n"], row["T"], row["K"]), row["solver"]
        if at != size or name not in COLOURS or name == "fgplan":
            continue
        where = f"n={size[0]} T={size[1]} K={size[2]} {row['start']}"
        if name.startswith("floor"):
            yield f"{where}: fgplan / {name} = {1 / row['times_fgplan']:.1f}"
        else:
            yield f"{where}: {name} / fgplan = {row['times_fgplan']:.1f}"


def _exponents(rows: Sequence[Row]) -> Iterator[str]:
    """time ∝ T^a at n = 10 and ∝ n^b at 0.5 people per square metre, both with K = 3."""
    for start in ("cold", "warm"):
        own = [r for r in rows if r["start"] == start and r["K"] == REFERENCE[2]]
        crowded = f"fgplan, {DENSE:g} people/m2"  # and not its floor, which has that name, too
        along_T = [r for r in own if r["solver"] == "fgplan" and r["n"] == REFERENCE[0]]
        dense = [
            r
            for r in own
            if r["T"] == REFERENCE[1]
            and (r["solver"] == crowded or (r["solver"] == "fgplan" and r["n"] > 20))
        ]
        for key, chosen, where in (
            ("T", along_T, f"n={REFERENCE[0]}"),
            ("n", dense, f"T={REFERENCE[1]}, 0.5 people/m2"),
        ):
            if len(chosen) < 2:
                yield f"exponent of {key}, {start}: needs two sizes or more (leave out --only)"
                continue
            time, systems = (exponent(chosen, key, per) for per in (False, True))
            yield f"fgplan {start}, {where}: time ~ {key}^{time:.2f}, per iteration ^{systems:.2f}"


def exponent(rows: Sequence[Row], key: str, per_iteration: bool = False) -> float:
    """Slope of log time over log n (or T), by least squares."""
    ms = np.array([r["p50_ms"] / (r["iterations_p50"] if per_iteration else 1.0) for r in rows])
    return float(np.polyfit(np.log([r[key] for r in rows]), np.log(ms), 1)[0])


def draw(rows: Sequence[Row], path: Path) -> None:
    """Time against n and against T, K = 3: cold drawn through, warm dashed."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    K = REFERENCE[2] if any(row["K"] == REFERENCE[2] for row in rows) else rows[0]["K"]
    with mpl.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(9.5, 4.2), layout="constrained")
        axes = figure.subplots(1, 2, sharey=True)
        _panel(axes[0], [r for r in rows if r["K"] == K], "n", "T", REFERENCE[1])
        _panel(axes[1], [r for r in rows if r["K"] == K], "T", "n", REFERENCE[0])
        axes[0].set_ylabel("median time of a plan [ms]")
        handles, labels = axes[0].get_legend_handles_labels()
        if handles:
            figure.legend(handles, labels, loc="outside right upper", frameon=False)
        figure.suptitle(f"{K} hypotheses; filled: cold; dashed and open: warm", fontsize=10)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=150)


def _panel(axes: Any, rows: Sequence[Row], key: str, other: str, value: int) -> None:
    at = value if any(row[other] == value for row in rows) else max(r[other] for r in rows)
    for solver, colour in COLOURS.items():
        for start, style in (("cold", "-"), ("warm", "--")):
            line = sorted(
                (r[key], r["p50_ms"])
                for r in rows
                if (r[other], r["solver"], r["start"]) == (at, solver, start) and r[key] > 0
            )
            if line:
                label = solver if start == "cold" else None
                axes.plot(
                    *np.transpose(line),
                    style,
                    color=colour,
                    marker="o",
                    mfc=colour if start == "cold" else "white",
                    ms=3.5,
                    lw=1.4,
                    label=label,
                )
    ticks = sorted({r[key] for r in rows if r[key] > 0})
    axes.set(xscale="log", yscale="log")
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.set_xticks([], minor=True)
    axes.grid(True, which="major", color="0.9", lw=0.6)
    axes.set_axisbelow(True)
    unit = f"people n (T = {at} steps)" if key == "n" else f"steps T of 0.2 s (n = {at} people)"
    axes.set_xlabel(unit)
