"""The engine's tuned numbers: module constants with names in capitals, found in the source of `core/`.

`use` makes modules that are imported afterwards have other values, wherever a constant is used: the number is
replaced in the source that Python compiles, so that names that are imported from the module, and constants
that follow from it, have the new value, too.
"""

from __future__ import annotations

import ast
import importlib.abc
import importlib.machinery
import operator
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import spec_from_file_location
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parent.parent
CORE = ROOT / "fipt_blender" / "core"
# Rooms whose numbers are formats, limits of files and messages, or decide nothing of an estimate.
OTHER_ROOMS = ("run", "report", "device", "capture", "alignment", "depth", "textures")
_NAME = re.compile(r"_?[A-Z][A-Z0-9_]*")
_OPERATORS = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Pow: operator.pow, ast.LShift: operator.lshift,
}  # fmt: skip


@dataclass(frozen=True)
class Constant:
    """A number in capitals.

    Attributes:
        module: below `fipt_blender.core`, such as "completion.torn_parts".
        name: in it.
        value: int or float.
        comment: what the source says of it, "" without.
    """

    module: str
    name: str
    value: float
    comment: str

    @property
    def key(self) -> str:
        """Module and name."""
        return f"{self.module}.{self.name}"

    def scaled(self, factor: float) -> float:
        """The value times a factor; whole numbers stay whole, and change by one at least."""
        if isinstance(self.value, float):
            return self.value * factor
        return max(round(self.value * factor), self.value + 1 if factor > 1.0 else 0)


def all_constants(folder: Path = CORE, skipped: Sequence[str] = OTHER_ROOMS) -> list[Constant]:
    """The constants of all modules below a folder, without the rooms that are skipped."""
    found: list[Constant] = []
    for path in sorted(folder.rglob("*.py")):
        parts = path.relative_to(folder).with_suffix("").parts
        if parts[0] not in skipped:
            found += module_constants(path.read_text(encoding="utf-8"), ".".join(parts))
    return found


def module_constants(source: str, module: str) -> list[Constant]:
    """The constants of one module's source."""
    lines = source.splitlines()
    return [
        Constant(module, name, value, _comment(lines, node))
        for node in ast.parse(source).body
        for name, number in _assigned(node)
        if (value := _value(number)) is not None
    ]


def _assigned(node: ast.stmt) -> Iterator[tuple[str, ast.expr]]:
    """Names in capitals and the expressions that one statement assigns to them."""
    if isinstance(node, ast.AnnAssign) and node.value is not None:
        pairs: list[tuple[ast.expr, ast.expr]] = [(node.target, node.value)]
    elif isinstance(node, ast.Assign) and len(node.targets) == 1:
        target, value = node.targets[0], node.value
        pairs = [(target, value)]
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            pairs = list(zip(target.elts, value.elts, strict=False))
    else:
        return
    for target, value in pairs:
        if isinstance(target, ast.Name) and _NAME.fullmatch(target.id):
            yield target.id, value


def _value(node: ast.expr) -> int | float | None:
    """The number that an expression of literals stands for; None for anything else."""
    if isinstance(node, ast.Constant):
        return node.value if type(node.value) in (int, float) else None
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        inner = _value(node.operand)
        return None if inner is None else -inner
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        left, right = _value(node.left), _value(node.right)
        if left is not None and right is not None:
            return _OPERATORS[type(node.op)](left, right)
    return None


def _comment(lines: Sequence[str], node: ast.stmt) -> str:
    """The comment behind a statement, or the lines of comment above it or above the constants before it."""
    behind = lines[(node.end_lineno or node.lineno) - 1].partition("#")[2].strip()
    if behind:
        return behind
    line = node.lineno - 2
    while line >= 0 and re.match(r"_?[A-Z][A-Z0-9_, ]* =", lines[line]) and "#" not in lines[line]:
        line -= 1
    above: list[str] = []
    while line >= 0 and lines[line].startswith("#"):
        above.insert(0, lines[line].lstrip("# "))
        line -= 1
    return " ".join(above)


class _Numbers(ast.NodeTransformer):
    """Puts numbers in the place of what a module assigns to names."""

    def __init__(self, values: Mapping[str, float]) -> None:
        self._values = dict(values)

    def visit_Module(self, node: ast.Module) -> ast.Module:
        for statement in node.body:
            for name, number in _assigned(statement):
                if name in self._values:
                    new = ast.copy_location(ast.Constant(self._values.pop(name)), number)
                    _replace(statement, number, new)
        if self._values:
            raise KeyError(f"There is no constant {', '.join(self._values)}.")
        return node


def _replace(statement: ast.stmt, old: ast.expr, new: ast.expr) -> None:
    assert isinstance(statement, ast.Assign | ast.AnnAssign)
    if isinstance(statement.value, ast.Tuple) and old in statement.value.elts:
        statement.value.elts[statement.value.elts.index(old)] = new
    else:
        statement.value = new


class _Loader(importlib.machinery.SourceFileLoader):
    """Compiles a module with other constants; the cache of compiled modules is neither read nor written."""

    def __init__(self, name: str, path: str, values: Mapping[str, float]) -> None:
        super().__init__(name, path)
        self._values = values

    def get_code(self, fullname: str):  # type: ignore[no-untyped-def]
        tree = _Numbers(self._values).visit(ast.parse(self.get_data(self.path)))
        return compile(tree, self.path, "exec", dont_inherit=True)


class _Finder(importlib.abc.MetaPathFinder):
    def __init__(self, values: Mapping[str, Mapping[str, float]], folder: Path, package: str) -> None:
        self._values, self._folder, self._package = values, folder, package

    def find_spec(
        self, fullname: str, path: object = None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        module = fullname.removeprefix(f"{self._package}.")
        if module == fullname or module not in self._values:
            return None
        file = self._folder.joinpath(*module.split(".")).with_suffix(".py")
        loader = _Loader(fullname, str(file), self._values[module])
        return spec_from_file_location(fullname, file, loader=loader)


def use(values: Mapping[str, float], folder: Path = CORE, package: str = "fipt_blender.core") -> None:
    """Give constants other values, by "module.NAME", in all modules that are imported from now on.

    Raises:
        ValueError: a module has been imported already.
    """
    by_module: dict[str, dict[str, float]] = {}
    for key, value in values.items():
        module, _, name = key.rpartition(".")
        if f"{package}.{module}" in sys.modules:
            raise ValueError(f"{module} has been imported already.")
        by_module.setdefault(module, {})[name] = value
    if by_module:
        sys.meta_path.insert(0, _Finder(by_module, folder, package))
