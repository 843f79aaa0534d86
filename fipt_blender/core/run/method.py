"""A digest of the engine's source code, so that a run resumed after an update never mixes two methods.

Settings hold what a user varies; many more constants are defined beside the code that uses them. Therefore
keys contain this digest: those of stages that of the code that they may run, others and the check of a
cluster's workers that of all. Standard library only.
"""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

_CORE = Path(__file__).resolve().parent.parent
# The rooms whose code determines the results of an estimation; the others only start, watch or show it
# (tests/test_isolation.py follows the imports).
ROOMS = (
    *("alignment", "depth", "capture", "surface", "radiometry", "pixels", "parts", "optics", "light"),
    *("checks", "photometry", "completion", "material", "estimate", "textures"),
    *("conventions.py", "robust.py"),
)


def digest(*values: Any, default: Callable[[Any], Any] | None = None) -> str:
    """A hexadecimal text that differs for different values (JSON, or what `default` makes of others)."""
    return hashlib.sha256(json.dumps(values, sort_keys=True, default=default).encode()).hexdigest()[:24]


@cache
def method_digest(core: Path = _CORE, rooms: Sequence[str] = ROOMS) -> str:
    """Hexadecimal digest of the source files that determine the results of an estimation.

    Args:
        core: the engine's folder.
        rooms: folders and files in it.
    """
    code = hashlib.sha256()
    for room in rooms:
        path = core / room
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            code.update(f"{file.relative_to(core).as_posix()}\0".encode())
            code.update(file.read_bytes())
    return code.hexdigest()[:24]


@cache
def code_digest(module: str, core: Path = _CORE, rooms: Sequence[str] = ROOMS) -> str:
    """Hexadecimal digest of the source files that a module may run: its own, and those that it imports.

    Stages whose code did not change are not done again when others' did.

    Args:
        module: its full name; modules outside of the engine may run everything.
    """
    start = core.joinpath(*module.rpartition(f".{core.name}.")[2].split(".")).with_suffix(".py")
    if not start.is_file():
        return method_digest(core, rooms)
    found, left = set[Path](), [start]
    while left:
        file = left.pop()
        if file not in found and file.is_file() and file.relative_to(core).parts[0] in rooms:
            found.add(file)
            left += imported_files(file)
    texts = sorted((file.relative_to(core).as_posix(), file.read_text(encoding="utf-8")) for file in found)
    return digest(texts)


@cache
def imported_files(file: Path) -> tuple[Path, ...]:
    """Files that may be the modules that a file imports from its own package, anywhere in it."""
    paths = []
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            folder = file.parents[node.level - 1].joinpath(*(node.module or "").split("."))
            paths += [folder.with_suffix(".py"), *(folder / f"{name.name}.py" for name in node.names)]
    return tuple(paths)
