"""The README keeps its promises: its code runs, its commands exist, its numbers are printed."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from fgplan import cli
from fgplan.inference import Inference

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def commands() -> list[list[str]]:
    """Lines of the shell blocks that run fgplan, without their comments."""
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    return [shlex.split(line, comments=True)[1:] for line in lines if line.startswith("fgplan ")]


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the repository's data, so that nothing is written into it."""
    (tmp_path / "data").symlink_to(ROOT / "data")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_python_blocks_run_one_after_the_other(
    elsewhere: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names: dict[str, object] = {}
    assert len(blocks("python")) == 2
    for block in blocks("python"):
        exec(compile(block, "README.md", "exec"), names)
    printed = capsys.readouterr().out.splitlines()
    assert [line[:8] for line in printed[:2]] == ["A: P = 0", "B: P = 0"]
    assert printed[2].startswith("drive [")
    slowed = names["mixture"].trajectory.velocities[5, 0]  # type: ignore[attr-defined]
    assert slowed == pytest.approx(0.4, abs=0.05)


@pytest.mark.parametrize("command", commands(), ids=" ".join)
def test_commands_run(command: list[str], elsewhere: Path) -> None:
    if {"FOLDER", "ID"} & set(command):  # placeholders: the options must exist
        listed = CliRunner().invoke(cli.app, [command[0], "--help"], env={"COLUMNS": "200"})
        assert all(word in listed.stdout for word in command if word.startswith("--"))
        return
    result = CliRunner().invoke(cli.app, command)
    assert result.exit_code == 0, result.output


def numbers_by_label(text: str) -> dict[str, list[float]]:
    """Rows of the tables: scenario's title and label → w, energy, evidence, P, P, separations."""
    rows, title = {}, ""
    for line in text.splitlines():
        titled = re.match(r"(\S.*) \(\d+ ms\)", line)
        title = titled[1] if titled else title
        words = line.replace("*", " ").split()
        if words[-1:] == ["yes"]:
            rows[f"{title} {words[0]}"] = [float(w) for w in words[1:8] if w != "–"]
    return rows


def test_demo_prints_what_the_readme_shows(elsewhere: Path) -> None:
    shown = blocks("text")[0]
    printed = CliRunner().invoke(cli.app, ["demo"]).stdout
    expected, got = numbers_by_label(shown), numbers_by_label(printed)
    assert len(expected) == 6
    assert list(got) == list(expected)
    for row, numbers in expected.items():
        assert got[row] == pytest.approx(numbers, abs=0.02), row
    corridors = r"Without people corridor (\w+) .* it is (\w+) "
    assert re.findall(corridors, printed) == re.findall(corridors, shown)


def test_the_table_of_inference_is_that_of_its_benchmark() -> None:
    """Its form and its names; what has an exact reference, two modes, is measured once more."""
    from benchmarks.inference import SEEDS, measure, methods, table
    from benchmarks.inference.cases import reference, two_modes

    known: dict[str, list[tuple[Inference, bool]]] = {}
    for name, method, solves in methods(False):
        known.setdefault(name, []).append((method, solves))
    case = two_modes()
    truth = reference(case, False)

    def errors(name: str, what: str) -> list[float]:
        rows = [measure(case, truth, name, *each, SEEDS) for each in known[name]]
        return [getattr(row, what) for row in rows]

    shown = README.split("<!-- printed by: python -m benchmarks.inference -->\n")[1].split("\n\n")[
        0
    ]
    head, rule, *lines = shown.splitlines()
    assert [head, rule] == table([])
    cases = set()
    for line in lines:
        of, budget, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        cases.add(of)
        assert float(budget.removesuffix(" s")) > 0
        for cell, what in zip(cells, ("mean_error", "evidence_error"), strict=True):
            if cell == "–":  # MAP is alone within the budget, and gives no evidence
                assert (what, cells[0].partition(": ")[0]) == ("evidence_error", "MAP")
                continue
            name, _, error = cell.partition(": ")
            assert name in known
            if of == "two modes":
                found = errors(name, what)
                assert any(e == pytest.approx(float(error), rel=0.1, abs=1e-6) for e in found)
    assert {"two modes", "three corridors, crowd", "recorded crowd"} == cases


def test_linked_files_exist() -> None:
    targets = [t for t in re.findall(r"\]\(([^)]+)\)", README) if not t.startswith("http")]
    assert "docs/five_people.png" in targets
    assert not [target for target in targets if not (ROOT / target).is_file()]
    assert (ROOT / "docs" / "five_people.png").stat().st_size < 300_000


def test_citation_names_the_paper() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    preferred = citation["preferred-citation"]
    assert preferred["title"] == "Integrating High Level and Low Level Planning"
    assert preferred["identifiers"][0]["value"] == "arXiv:1611.08767"
