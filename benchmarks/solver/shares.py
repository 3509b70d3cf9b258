"""`python -m benchmarks.solver.shares`: where the time of fgplan's solver goes, at one size."""

from __future__ import annotations

from collections.abc import Mapping
from cProfile import Profile
from pathlib import Path
from pstats import Stats
from time import process_time
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.solver.measure import Size, problems_of
from benchmarks.solver.peers import Native

SIZE, SCENES = Size(10, 30, 3), 20
PARTS: Mapping[str, tuple[str, str]] = {
    "everything": ("peers", "solve"),
    "assembling the density": ("problem", "assemble"),
    "expansions": ("assembly", "expand"),
    "energies along steps": ("solver", "_line_search"),
    "Newton steps": ("assembly", "_solve"),
    "of these, factorising and solving": ("tiles", "solve"),
}
"""What is reported, by the file and the function that does it with all that it calls."""


def shares(size: Size = SIZE, scenes: int = SCENES) -> dict[str, float]:
    """Milliseconds of CPU time of a plan, cold and warm, by part, of those that were met;
    a profiler makes Python's own part longer."""
    peer, profile = Native(), Profile(process_time)
    problems = [p for seed in range(scenes) for p in problems_of(size, seed).values()]
    for problem in problems:
        peer.solve(problem, None)
    profile.enable()
    for problem in problems:
        peer.solve(problem, None)
    profile.disable()
    spent: dict[tuple[str, str], float] = {}
    stats: Any = Stats(profile)
    for (path, _, function), (_, _, _, cumulative, _) in stats.stats.items():
        key = (Path(path).stem, function)
        spent[key] = spent.get(key, 0.0) + 1e3 * cumulative / len(problems)
    return {part: spent[key] for part, key in PARTS.items() if key in spent}


def main() -> None:
    """Print them."""
    found = shares()
    table = Table("part", "ms", "%", box=None, pad_edge=False)
    for part, ms in found.items():
        table.add_row(part, f"{ms:.1f}", f"{100 * ms / found['everything']:.0f}")
    Console(width=80, highlight=False).print(table)


if __name__ == "__main__":
    main()
