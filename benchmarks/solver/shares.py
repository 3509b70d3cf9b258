"""`python -m benchmarks.solver.shares [n,T,K]`: where the time of fgplan's solver goes, at one
size."""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Mapping
from cProfile import Profile
from pathlib import Path
from pstats import Stats
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.solver.measure import Size, asked, problems_of
from benchmarks.solver.peers import Native

SIZE, SCENES = Size(10, 30, 3), 20
PARTS: Mapping[str, tuple[tuple[str, str], ...]] = {
    "everything": (("peers", "solve"),),
    "assembling the density": (("problem", "assemble"),),
    "expansions": (("assembly", "expand"), ("sparse", "__init__")),
    "the search along steps, most expansions with it": (("solver", "_line_search"),),
    "Newton steps": (("assembly", "_solve"), ("sparse", "_solved")),
    "of these, solving systems": (("tiles", "solve"), ("conjugate", "newton")),
}
"""What is reported, by the files and functions that do it with all that they call: the first for
few people, the second for many."""


def shares(size: Size = SIZE, scenes: int = SCENES) -> dict[str, float]:
    """Milliseconds of a plan, cold and warm, by part, of those that were met; a profiler makes
    Python's own part longer, and one that counts CPU time twice as long."""
    peer, profile = Native(), Profile()
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
    times = {part: sum(spent.get(key, 0.0) for key in keys) for part, keys in PARTS.items()}
    return {part: ms for part, ms in times.items() if ms > 0}


def main() -> None:
    """Print them."""
    parser = ArgumentParser(prog="python -m benchmarks.solver.shares", description=__doc__)
    parser.add_argument("size", metavar="n,T,K", nargs="?", type=asked, default=(SIZE,))
    for size in parser.parse_args().size:
        found = shares(size)
        table = Table(f"n={size.n} T={size.T} K={size.K}", "ms", "%", box=None, pad_edge=False)
        for part, ms in found.items():
            table.add_row(part, f"{ms:.1f}", f"{100 * ms / found['everything']:.0f}")
        Console(width=80, highlight=False).print(table)


if __name__ == "__main__":
    main()
