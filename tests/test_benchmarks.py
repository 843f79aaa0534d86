"""Benchmarks and the examples' scripts follow the names of the engine; figures of speed."""

from __future__ import annotations

import ast
import importlib
import runpy
import sys
from pathlib import Path

import pytest

from benchmarks import speed
from fipt_blender import cli
from fipt_blender.core.__main__ import COMMANDS, run_command
from fipt_blender.core.run.messages import Reporter

ROOT = Path(__file__).resolve().parent.parent
# The scripts of people: all that read a command line, and dev.py.
SCRIPTS = [
    ROOT / "dev.py",
    *(file for room in ("benchmarks", "examples") for file in sorted((ROOT / room).glob("*.py"))
      if "argparse.ArgumentParser(" in file.read_text(encoding="utf-8")),
]  # fmt: skip


def imported(file: Path) -> set[str]:
    """Modules and `module.name`s of the project that a file imports anywhere, functions included."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return {name for name in names if name.startswith(("fipt_blender.", "benchmarks."))}


def exists(name: str) -> bool:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError:
        module, _, last = name.rpartition(".")
        return hasattr(importlib.import_module(module), last)
    return True


def test_scripts_import_only_what_there_is() -> None:
    files = [file for room in ("benchmarks", "examples") for file in sorted((ROOT / room).rglob("*.py"))]
    faults = {}
    for file in files:
        if missing := sorted(name for name in imported(file) if not exists(name)):
            faults[file.name] = missing
    assert len(files) > 20 and not faults, faults


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda file: file.stem)
def test_scripts_print_their_help(
    script: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [str(script), "--help"])
    monkeypatch.setattr(sys, "path", list(sys.path))
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(script), run_name="__main__")
    assert not end.value.code and len(capsys.readouterr().out) > 100


@pytest.mark.parametrize("command", ["", "estimate", "prepare", "export", "check", *(f"core {x}" for x in COMMANDS)])
def test_commands_print_their_help(command, capsys) -> None:
    engine, words = command.startswith("core "), [*command.removeprefix("core ").split(), "--help"]
    with pytest.raises(SystemExit) as end:
        sys.exit(run_command(words, Reporter(sys.stdout)) if engine else cli.main(words))
    assert not end.value.code and "usage: fipt" in capsys.readouterr().out


def test_speed_tells_medians_of_runs_beside_earlier_ones() -> None:
    runs = []
    for seconds, stages in ((9.0, ["pixels"]), (5.0, ["pixels", "training"]), (6.0, ["pixels"])):
        listed = [{"name": name, "seconds": seconds / 2.0} for name in stages]
        costs = {"step_seconds": {"ingest": 1.0}, "statistics": {"stages": listed}, "seconds": seconds}
        runs.append(speed.figures_of({**costs, "peak_memory_gb": 1.5}))
    found = speed.medians(runs)
    assert found == {
        "step ingest": 1.0, "stage pixels": 3.0, "stage training": 2.5, "seconds": 6.0, "memory (GB)": 1.5
    }  # fmt: skip
    lines = speed.format_table(found, {"stage gone": 7.0, "seconds": 8.0}).splitlines()
    assert lines[0].split() == ["stage", "gone", "7.0", "-"] and lines[1].split() == ["seconds", "8.0", "6.0"]
