"""Who may import whom, and which names have one home."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# Modules of fgplan from the bottom up: each imports only lower lines; modules of one line do not
# import each other. A new module must be given its place here.
RANKS = [
    {"deadline", "errors", "labels", "tables"},
    {"trajectory", "keys", "block_tridiagonal", "shear"},
    {"hypothesis", "timing", "map_file", "regions", "robots"},
    {"holonomic", "wheeled"},
    {"occupancy"},
    {"roadmap"},
    {"smoothing"},
    {"routes"},
    {"mission"},
    {"measuring", "scenario"},
    {"stack"},
    {"validation"},
    {"crowd"},
    {"tactical"},
    {"obeying", "task_file"},
    {"scenario_table", "structure"},
    {"scenario_file"},
    {"safety"},
    {"starts", "mixture", "recordings"},
    {"hypotheses"},
    {"products"},
    {"conditioning", "gating"},
    {"shared_control"},
    {"model"},
    {"entries"},
    {"wiring"},
    {"systems"},
    {"compiled"},
    {"backend"},
    {"assembly"},
    {"sparse"},
    {"solver"},
    {"inference", "sketch"},
    {"search"},
    {"components"},
    {"selection"},
    {"planner"},
    {"drawing", "driving", "peers"},
    {"factorisation"},
    {"canvas", "terminal"},
    {"legend", "simulation"},
    {"plotting", "printing", "stack_drawing"},
    {"cli", "web"},
    {"__main__"},
]
# Lazy on purpose: `Scenario.load` is where users look for it, pydantic only where a file is read.
LAZY = {("scenario", "scenario_file")}
HEAVY = ["matplotlib", "skimage", "networkx", "numba", "pydantic", "typer"]


def sources(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def imports(path: Path) -> Iterator[str]:
    """Dotted names that a file imports, inside functions too, but not for type checkers."""
    tree = ast.parse(path.read_text(encoding="utf-8"), str(path))
    hidden = {
        id(node)
        for block in ast.walk(tree)
        if isinstance(block, ast.If) and "TYPE_CHECKING" in ast.dump(block.test)
        for statement in block.body
        for node in ast.walk(statement)
    }
    for node in ast.walk(tree):
        if id(node) in hidden:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            # `from fgplan import keys` names the module, not the package.
            named = node.module or ""
            yield from (f"{named}.{alias.name}" for alias in node.names)


def module_name(path: Path) -> str:
    """The module of fgplan that a file belongs to; a subpackage counts as one module."""
    return path.relative_to(ROOT / "fgplan").with_suffix("").parts[0]


def used_of_gtsam(path: Path) -> set[str]:
    """What a file uses of gtsam; strings and comments do not count."""
    tree = ast.parse(path.read_text(encoding="utf-8"), str(path))
    attributes = {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "gtsam"
    }
    return attributes | {name.split(".")[1] for name in imports(path) if name.startswith("gtsam.")}


def homes_of(used: set[str]) -> list[str]:
    return [
        str(path.relative_to(ROOT))
        for package in ("factors", "fgplan")
        for path in sources(package)
        if used & used_of_gtsam(path)
    ]


@pytest.mark.parametrize("path", sources("factors"), ids=lambda p: p.stem)
def test_factors_import_gtsam_and_numpy_only(path: Path) -> None:
    allowed = {"factors", "gtsam", "numpy"} | sys.stdlib_module_names
    used = {name.partition(".")[0] for name in imports(path)}
    assert used <= allowed, f"{path.name} imports {sorted(used - allowed)}"


def test_every_module_of_fgplan_has_a_rank() -> None:
    ranked = set().union(*RANKS)
    assert sum(map(len, RANKS)) == len(ranked), "a module has two ranks"
    present = {module_name(path) for path in sources("fgplan")} - {"__init__"}
    assert present <= ranked, f"give {sorted(present - ranked)} a rank"


@pytest.mark.parametrize("path", sources("fgplan"), ids=lambda p: str(p.relative_to(ROOT)))
def test_nothing_in_fgplan_imports_upward(path: Path) -> None:
    module = module_name(path)
    if module == "__init__":  # the front door shows all rooms
        return
    rank = {name: height for height, line in enumerate(RANKS) for name in line}
    for dotted in imports(path):
        top, *rest = dotted.split(".")
        assert top not in {"notebooks", "benchmarks", "tests"}, f"{module} imports {dotted}"
        if top != "fgplan" or rest[0] == module or (module, rest[0]) in LAZY:
            continue
        assert rest[0] in rank, f"{module} imports {dotted}: import modules, not the package"
        assert rank[rest[0]] < rank[module], f"{module} imports {rest[0]}, which stands above it"


def test_custom_factor_has_one_home() -> None:
    assert homes_of({"CustomFactor"}) == ["factors/residual.py"]


def test_keys_are_spelled_in_one_place() -> None:
    spellers = {"symbol", "Symbol", "LabeledSymbol", "mrsymbol", "symbol_shorthand"}
    assert homes_of(spellers) == ["fgplan/keys.py"]


def test_gtsam_is_never_star_imported() -> None:
    """gtsam.Scenario exists."""
    for package in ("factors", "fgplan", "benchmarks", "tests"):
        for path in sources(package):
            assert not [name for name in imports(path) if name.endswith(".*")], path


def test_import_of_fgplan_is_light() -> None:
    program = f"import sys, fgplan; print([m for m in {HEAVY!r} if m in sys.modules])"
    command = [sys.executable, "-W", "error", "-c", program]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "[]"), done.stderr


def test_rules_would_notice(tmp_path: Path) -> None:
    """The reader sees lazy imports, skips those for type checkers, and tells use from mention."""
    source = tmp_path / "example.py"
    source.write_text(
        "from typing import TYPE_CHECKING\n"
        "if TYPE_CHECKING:\n    import hidden\n"
        "def f(symbol):\n    '''gtsam.CustomFactor'''\n    from fgplan import planner\n"
        "    from gtsam.symbol_shorthand import X\n    return gtsam.Symbol(symbol)\n",
        encoding="utf-8",
    )
    names = {"typing.TYPE_CHECKING", "fgplan.planner", "gtsam.symbol_shorthand.X"}
    assert set(imports(source)) == names
    assert used_of_gtsam(source) == {"symbol_shorthand", "Symbol"}
