# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Benchmarks and the examples' scripts follow the names of the engine."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


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
