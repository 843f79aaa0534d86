# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What tests may import: no other test module, and no private name of what they test."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import matrix

TESTS = Path(__file__).resolve().parent
_CLOCKS = ("process_time", "thread_time", "perf_counter", "process_time_ns", "perf_counter_ns")


def is_private(name: str) -> bool:
    last = name.rpartition(".")[2]
    return last.startswith("_") and not last.startswith("__")


def name_of(node: ast.AST) -> str:
    return getattr(node, "attr", getattr(node, "id", ""))


def imported_test_modules(tree: ast.Module) -> set[str]:
    modules = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            modules |= {node.module or "", *(alias.name for alias in node.names)}
    return {name for name in modules if name.startswith("test_") or name == "conftest"}


def private_names(tree: ast.Module) -> Iterator[str]:
    """Private names of other modules and objects: imported, read as attributes, or set by monkeypatch."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            yield from (alias.name for alias in node.names if is_private(alias.name))
        elif isinstance(node, ast.Attribute) and is_private(node.attr):
            if not (isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")):
                if ast.unparse(node) != "os._exit":  # Python documents it
                    yield ast.unparse(node)
        elif isinstance(node, ast.Call) and name_of(node.func) in ("setattr", "getattr"):
            names = [argument.value for argument in node.args[:2] if isinstance(argument, ast.Constant)]
            yield from (name for name in names if isinstance(name, str) and is_private(name))


def measured_times(tree: ast.Module) -> Iterator[str]:
    """Assertions on seconds, which fail on a busy machine: count what the time is for. And processor time."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr in _CLOCKS:
            yield ast.unparse(node)
        elif isinstance(node, ast.Assert):
            names = {name_of(each) for each in ast.walk(node.test)}
            if names & {"monotonic", "elapsed"}:
                yield ast.unparse(node.test)


def test_tests_stand_alone_use_public_names_and_assert_no_times() -> None:
    faults = {}
    for file in sorted(TESTS.rglob("*.py")):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        # Move what is shared to tests/samples; test the public function, or make the name public.
        found = [*imported_test_modules(tree), *private_names(tree), *measured_times(tree)]
        if found:
            faults[str(file.relative_to(TESTS))] = found
    assert not faults, faults


def test_the_check_finds_what_it_forbids() -> None:
    statement, clock = "time.monotonic() - k < 5.0", "time.process_time"
    tree = ast.parse(
        "from test_a import b\n"
        "from fipt_blender.cli import _c\n"
        "d._e(self._f, g.__name__)\n"
        "monkeypatch.setattr(h, '_i', 1)\n"
        "monkeypatch.setattr('fipt_blender.cli._j', 1)\n"
        f"assert {statement}\n"
        f"began = {clock}()\n"
    )
    assert imported_test_modules(tree) == {"test_a"}
    assert set(private_names(tree)) == {"_c", "d._e", "_i", "fipt_blender.cli._j"}
    assert list(measured_times(tree)) == [statement, clock]


def test_the_tests_of_the_matrix_are_there() -> None:
    assert [name for name in matrix.TESTS if not (TESTS / name).is_file()] == []
