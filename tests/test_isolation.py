"""Who may import whom: the engine no bpy, Blender's side no engine package, each floor only those below; and tests."""

from __future__ import annotations

import ast
import functools
import graphlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib.util import resolve_name
from pathlib import Path

import pytest

import matrix
from fipt_blender.core.__main__ import COMMANDS
from fipt_blender.core.run.method import ROOMS

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
PACKAGE = ROOT / "fipt_blender"
CORE = PACKAGE / "core"
PREPARE = PACKAGE / "prepare"  # of the engine, too
HEAVY = "mitsuba drjit torch OpenEXR OpenImageIO pycolmap pyoidn rawpy exifread lensfunpy trimesh".split()
# What Blender's side may import of the engine: the standard library and numpy are enough for these.
SHARED = """
    alignment.pairs alignment.sights alignment.turns capture.averaging capture.files capture.mesh_file
    capture.options capture.suffixes
    conventions device.cuda optics.factorised run.contents run.declared run.documents run.errors run.hints
    run.kinds run.light_size run.lock run.made run.messages run.method run.names run.parts run.paths
    run.process_identity run.result_contents run.run_files run.runfolder run.settings run.shapes run.stage_settings
    run.store run.versions report.comparison report.fixture_names textures.raster textures.write_back
""".split()
SHARED_MODULES = (*(f"core.{name}" for name in SHARED), *("prepare.facts", "prepare.preparation"))
# The rooms from the lowest floor to the highest: each imports only from itself and from rooms before it.
FLOORS = """
    core.run core.conventions core.robust core.device core.alignment core.depth core.capture core.surface
    core.radiometry core.pixels core.parts core.optics core.light core.checks core.photometry
    core.completion core.material core.textures core.report core.estimate prepare core.__main__ core
    bridge machine blend blend.room blend.capture blend.lights blend.results blend.export blend.hints
    blend.insert blend.pictures properties jobs api panels operators cli __main__ __init__
""".split()
LIGHT_MODULES = (*SHARED_MODULES, *(f"core.device.{name}" for name in ("llvm", "variant", "probe", "check")))

BLOCK = """
import importlib, sys
sys.path.insert(0, sys.argv[1])
for name in sys.argv[2].split(","):
    sys.modules[name] = None
for name in sys.argv[3].split(","):
    importlib.import_module(name)
"""


@functools.cache
def imports(file: Path) -> list[ast.Import | ast.ImportFrom]:
    """All import statements of a file, functions included; several tests need them."""
    nodes = statements(ast.parse(file.read_text(encoding="utf-8")))
    return [node for node in nodes if isinstance(node, (ast.Import, ast.ImportFrom))]


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """All statements of a module or statement: quicker than `ast.walk`, which also visits expressions."""
    for name in ("body", "orelse", "finalbody", "handlers", "cases"):
        for each in getattr(node, name, ()):
            yield each
            yield from statements(each)


def imported_modules(file: Path) -> set[str]:
    """Absolute top-level names that a file imports anywhere, functions included."""
    names = set()
    for node in imports(file):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif node.level == 0 and node.module:
            names.add(node.module.partition(".")[0])
    return names


@functools.cache
def relative_targets(file: Path) -> set[str]:
    """Modules below fipt_blender that a file imports relatively, as dotted paths."""
    package = file.relative_to(PACKAGE).with_suffix("").parts[:-1]
    targets = set()
    for node in imports(file):
        if isinstance(node, ast.ImportFrom) and node.level:
            up = node.level - 1
            assert up <= len(package), f"{file} imports from outside the package"
            base = [*package[: len(package) - up], *(node.module or "").split(".")]
            stem = [part for part in base if part]
            for alias in node.names:
                path = PACKAGE.joinpath(*stem, alias.name)
                is_module = path.is_dir() or path.with_suffix(".py").exists()
                targets.add(".".join([*stem, alias.name] if is_module else stem))
    return targets


def module_of(file: Path) -> str:
    """Dotted path of a file below fipt_blender; a package's own file has the package's."""
    parts = file.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if len(parts) > 1 and parts[-1] == "__init__" else parts)


def room_of(module: str) -> str:
    """The floor of a module: the longest name of FLOORS that it starts with."""
    rooms = [room for room in FLOORS if (module + ".").startswith(room + ".")]
    assert rooms, f"{module} lies on no floor: name its room in FLOORS"
    return max(rooms, key=len)


def test_light_modules_import_without_the_engines_packages() -> None:
    """And the engine's command line without bpy; no other module of the engine may name it (below)."""
    modules = [f"fipt_blender.{name}" for name in (*LIGHT_MODULES, "core.__main__")]
    arguments = [str(ROOT), ",".join([*HEAVY, "bpy"]), ",".join(modules)]
    result = subprocess.run([sys.executable, "-I", "-c", BLOCK, *arguments], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    blocked = subprocess.run([sys.executable, "-I", "-c", BLOCK, ".", "json", "json"], capture_output=True, text=True)
    assert blocked.returncode != 0 and "json" in blocked.stderr


def test_engine_commands_choose_the_variant_before_they_import_what_needs_it() -> None:
    commands = [resolve_name(module, "fipt_blender.core") for module, _ in COMMANDS.values()]
    arguments = [str(ROOT), "mitsuba,drjit,torch,bpy", ",".join(commands)]
    result = subprocess.run([sys.executable, "-I", "-c", BLOCK, *arguments], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


def forbidden(file: Path) -> set[str]:
    """What a file imports that its side must not."""
    top, targets = imported_modules(file), relative_targets(file)
    if CORE in file.parents or PREPARE in file.parents:
        outside = {target for target in targets if not (target + ".").startswith(("core.", "prepare."))}
        return top & {"bpy", "bmesh", "mathutils", "fipt_blender"} | outside
    heavy = {target for target in targets if target.startswith(("core", "prepare"))} - set(SHARED_MODULES)
    return top & {*HEAVY, "fipt_blender"} | heavy


def from_above(file: Path) -> set[str]:
    """The rooms above its own that a file imports from."""
    floor = FLOORS.index(room_of(module_of(file)))
    rooms = {room_of(target) for target in relative_targets(file) if target}
    return {room for room in rooms if FLOORS.index(room) > floor}


@pytest.mark.parametrize("faults_of", [forbidden, from_above])
def test_every_file_imports_only_what_its_side_and_floor_may(faults_of: Callable[[Path], set[str]]) -> None:
    found = {module_of(file): sorted(faults_of(file)) for file in sorted(PACKAGE.rglob("*.py"))}
    faults = {module: names for module, names in found.items() if names}
    assert len(found) > 100 and not faults, faults


def test_dev_py_needs_the_standard_library_only() -> None:
    assert imported_modules(ROOT / "dev.py") - set(sys.stdlib_module_names) == {"fipt_blender"}
    for file in (*sorted((PACKAGE / "bridge").glob("*.py")), CORE / "device" / "llvm.py"):
        assert imported_modules(file) <= set(sys.stdlib_module_names), file


def test_no_module_imports_itself_by_a_detour() -> None:
    graph = {module_of(file): relative_targets(file) for file in PACKAGE.rglob("*.py")}
    # A package's own file lists its modules; a module does not need it.
    packages = {module_of(file) for file in PACKAGE.rglob("__init__.py")}
    graph = {module: targets - packages - {module} for module, targets in graph.items()}
    list(graphlib.TopologicalSorter(graph).static_order())  # CycleError names the modules


def test_the_digest_of_the_method_covers_all_rooms_that_an_estimation_uses() -> None:
    files = [file for file in CORE.rglob("*.py") if file.relative_to(CORE).parts[0] in ROOMS]
    used = {room_of(target).removeprefix("core.") for file in files for target in relative_targets(file)}
    rooms = {name.removesuffix(".py") for name in ROOMS}
    # Settings are parts of the keys by themselves; the other two decide where it runs and how it is shown.
    assert used - rooms == {"run", "device", "report"}


def test_every_floor_exists() -> None:
    rooms = {room_of(module_of(file)) for file in PACKAGE.rglob("*.py")}
    assert rooms == set(FLOORS)


_TIMES = ("monotonic", "elapsed")
_CLOCKS = ("process_time", "thread_time", "perf_counter", "process_time_ns", "perf_counter_ns")


def is_private(name: str) -> bool:
    last = name.rpartition(".")[2]
    return last.startswith("_") and not last.startswith("__")


def name_of(node: ast.AST) -> str:
    return getattr(node, "attr", getattr(node, "id", ""))


def imported_test_modules(tree: ast.Module) -> set[str]:
    modules = set()
    for node in statements(tree):
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
            if names & {*_TIMES}:
                yield ast.unparse(node.test)


def test_tests_stand_alone_use_public_names_and_assert_no_times() -> None:
    faults = {}
    for file in sorted(TESTS.rglob("*.py")):
        text = file.read_text(encoding="utf-8")
        tree = ast.parse(text)
        # Move what is shared to tests/samples; test the public function, or make the name public.
        found = [*imported_test_modules(tree), *private_names(tree)]
        if any(word in text for word in (*_CLOCKS, *_TIMES)):
            found += measured_times(tree)
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
