#!/usr/bin/env python3
"""The commands of the project, which include the set-up: python3 dev.py COMMAND [ARGUMENT ...]

  demo      run the main job on the example capture
  test      run the tests
  run       run the command line, e.g. run estimate CAPTURE --output FOLDER
  accuracy  run the engine on a capture with ground truth and print its accuracy
  scoreboard  whole jobs on modelled and real rooms, compared with the commit measured before
  speed     seconds and memory of the main job, stage by stage
  lock      write engine.lock from the pins in pyproject.toml
  lint      run ruff, its formatter as a check, and mypy
  build     make the extension's zip in dist/, and validate it with Blender's own tool
  index     build, and make dist/ a repository of extensions that a web server can offer to Blender
  release   build for the tag v + VERSION, with checksums and notes of the changelog in dist/
  docs      write the documentation site to out/site; a broken link is an error
  results   write the tables of docs/results.md from docs/measurements/ (--add: with a new measurement)
  setup     only set up

Standard library only. The set-up creates the virtual environment .venv with the packages pinned in
pyproject.toml and finds or fetches an LLVM. Nothing outside this folder is changed, except for caches.
"""

from __future__ import annotations

import hashlib
import json
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

SUPPORTED_PYTHONS = ((3, 11), (3, 13))  # for these, bpy exists
ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
VENV_PYTHON = VENV / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
PRODUCT = ROOT / "fipt_blender" / "__main__.py"
DEVELOPMENT_GROUPS = ("engine", "blender", "dev", "cluster", "heif", "markers")
DEMO = ("estimate", "examples/room", "--output", "out/demo", "--preset", "draft")


class SetupError(Exception):
    """Set-up has failed; the text says what to do."""


class Terminal:
    """Prints the progress of set-up to stderr; stdout is for the command itself."""

    def __init__(self) -> None:
        self._last = ""

    def stage(self, name: str, text: str) -> None:
        """Begin the next stage."""
        self.detail(text)

    def detail(self, text: str) -> None:
        """Describe what the current stage is doing."""
        if text != self._last:
            print(f"set-up: {text}", file=sys.stderr, flush=True)
        self._last = text

    def progress(self, stage_fraction: float) -> None:
        """Not printed; the texts are sufficient."""

    def warning(self, code: str, text: str, remedy: str) -> None:
        """Report a problem that does not stop set-up."""
        self.detail(f"warning: {text} {remedy}")

    def log(self, line: str) -> None:
        """Print those of pip's lines that may be important."""
        if line.startswith(("ERROR", "WARNING")):
            print(line, file=sys.stderr, flush=True)


def setup_key(pins: dict[str, list[str]], folder: Path = VENV) -> str:
    """A key that changes when set-up must be repeated: other pins, another Python, a moved checkout."""
    from fipt_blender.bridge.plan import plan_key

    return plan_key(pins, sys.version_info[:2], str(folder))


def child_environment() -> dict[str, str]:
    """Environment variables of all child processes: the engine's, with the libraries of set-up."""
    from fipt_blender.bridge.interpreter import engine_environment

    return engine_environment(VENV_PYTHON)


def set_up() -> None:
    """Create or complete the environment; does nothing if it is complete.

    Raises:
        SetupError: with what to do.
    """
    from fipt_blender.bridge import environment
    from fipt_blender.bridge.pins import is_set_up, read_pins
    from fipt_blender.bridge.plan import ENGINE_MODULES, Plan
    from fipt_blender.core.run.errors import FiptError

    started = time.monotonic()
    try:
        pins = read_pins()
        key = setup_key(pins)
        if is_set_up(VENV, key):
            return
        plan = Plan(
            folder=VENV,
            base=Path(sys.executable),
            requirements=[pin for group in DEVELOPMENT_GROUPS for pin in pins[group]],
            modules=("bpy", *ENGINE_MODULES),
            llvm=pins["llvm"],
            pip=pins["pip"],
            lock=pins["lock"],
            key=key,
        )
        environment.set_up(plan, Terminal())
    except FiptError as error:
        raise SetupError(f"{error.text}\n{error.remedy}") from error
    print(f"set-up: done in {time.monotonic() - started:.0f} seconds", file=sys.stderr, flush=True)


def read_versions() -> dict[str, str]:
    """The version of the product in each file that contains it."""
    import tomllib

    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    code = (ROOT / "fipt_blender/core/run/runfolder.py").read_text(encoding="utf-8")
    product = re.search(r'^PRODUCT_VERSION = "(.+)"$', code, re.MULTILINE)
    log = re.search(r"^## (\d\S*)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    return {
        "blender_manifest.toml": manifest["version"],
        "pyproject.toml": project["version"],
        "runfolder.PRODUCT_VERSION": product.group(1) if product else "",
        "CHANGELOG.md": log.group(1) if log else "",
    }


def build_extension(folder: Path = ROOT / "dist") -> Path:
    """Make the extension's zip, with the manifest, the licence, the guide and the package's files.

    The zip is reproducible: the same files give the same bytes.

    Raises:
        SetupError: the versions in `read_versions` differ.
    """
    from fipt_blender.bridge.pins import ENGINE_GROUPS, PINS_NAME, read_pins

    versions = read_versions()
    if len(set(versions.values())) != 1:
        listed = "\n".join(f"  {place}: {version}" for place, version in versions.items())
        raise SetupError(f"The versions differ:\n{listed}\nMake them equal.")
    package = ROOT / "fipt_blender"
    contents = {name: (ROOT / name).read_bytes() for name in ("blender_manifest.toml", "LICENSE")}
    contents |= _guide_pages()
    contents[PINS_NAME] = json.dumps({name: read_pins()[name] for name in ENGINE_GROUPS}, indent=1).encode()
    for path in package.rglob("*"):
        parts = path.relative_to(package).parts
        hidden = any(part.startswith(".") or part == "__pycache__" for part in parts)
        if path.is_file() and not hidden and path.suffix != ".pyc":
            contents["/".join(parts)] = path.read_bytes()
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / f"fipt_blender-{versions['blender_manifest.toml']}.zip"
    temporary = target.with_suffix(".part")
    with zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in sorted(contents):
            info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            info.create_system = 3  # otherwise it depends on the platform
            info.external_attr = 0o644 << 16
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, contents[name])
    temporary.replace(target)
    return target


def _guide_pages() -> dict[str, bytes]:
    """The guide as HTML pages."""
    with tempfile.TemporaryDirectory() as folder:
        script = str(ROOT / "docs" / "hooks" / "offline.py")
        subprocess.run([str(VENV_PYTHON), script, folder], check=True)
        pages = [path for path in Path(folder).rglob("*") if path.is_file()]
        return {f"guide/{path.relative_to(folder).as_posix()}": path.read_bytes() for path in pages}


def extension_tool(*arguments: str) -> int:
    """Run Blender's own command for extensions, which is part of bpy."""
    return call(str(next(VENV.rglob("bl_pkg/cli/blender_ext.py"))), *arguments)


def build(folder: Path = ROOT / "dist") -> int:
    """Make the zip and validate it."""
    return extension_tool("validate", str(build_extension(folder)))


def index_extensions(folder: Path = ROOT / "dist") -> int:
    """Make the zip, and write an index of all zips in the folder."""
    build_extension(folder)
    return extension_tool("server-generate", f"--repo-dir={folder}", "--html")


def release(tag: str, folder: Path = ROOT / "dist") -> int:
    """Make the files of a release: the zip, SHA256SUMS, and NOTES.md, the version's chapter of the changelog.

    Raises:
        SetupError: the tag is not that of the version.
    """
    version = read_versions()["CHANGELOG.md"]
    if tag != f"v{version}":
        raise SetupError(f"The tag {tag} is not v{version}, the newest version in CHANGELOG.md.")
    archive = build_extension(folder)
    checksum = hashlib.sha256(archive.read_bytes()).hexdigest()
    (folder / "SHA256SUMS").write_text(f"{checksum}  {archive.name}\n", encoding="utf-8")
    chapters = re.split(r"^## .*\n", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    (folder / "NOTES.md").write_text(chapters[1].strip() + "\n", encoding="utf-8")
    return extension_tool("validate", str(archive))


def call(*arguments: str) -> int:
    """Run the environment's Python; returns its exit status as a shell does (128 + signal)."""
    child = subprocess.Popen([str(VENV_PYTHON), *arguments], cwd=ROOT, env=child_environment())
    while True:
        try:
            status = child.wait()
        except KeyboardInterrupt:  # the child gets it too and ends by itself
            continue
        return status if status >= 0 else 128 - status


def lint() -> int:
    """Run ruff, its formatter as a check, and mypy, each even if one before finds something."""
    checks = (("ruff", "check", "."), ("ruff", "format", "--check", "."), ("mypy",))
    return max([call("-m", *check) for check in checks])


def lock() -> int:
    """Write engine.lock: every package that the engine needs on any platform, with its files' hashes.

    PyTorch, and what only its CUDA builds need, is left out: which build is installed depends on the machine.
    Those of pip and LLVM come last, which set-up checks by itself. Extras have lists of their own.
    """
    from fipt_blender.bridge.pins import LOCK_NAME, TOOL_GROUPS, parse_lock, read_pins, without_hashes
    from fipt_blender.core.run.extras import EXTRAS, install_list

    pins = read_pins()
    name = re.compile(r"[A-Za-z0-9_.-]+")
    compiler = [str(VENV_PYTHON), "-m", "uv", "pip", "compile", "-", "--universal"]
    options = ["--python-version", "3.11", "--only-binary", ":all:", "--generate-hashes"]
    options += ["--no-header", "--no-annotate", "--quiet"]

    def compiled(requirements: list[str], *more: str) -> str:
        text = "\n".join(requirements)
        child = subprocess.run([*compiler, *options, *more], input=text, capture_output=True, text=True)
        if child.returncode:
            raise SetupError(child.stderr.strip())
        return child.stdout

    def names(text: str) -> set[str]:
        return {name.match(without_hashes(line)).group() for line in parse_lock(text)}

    without_torch = [pin for pin in pins["engine"] if not pin.startswith("torch==")]
    everything = names(compiled(pins["engine"]))
    cuda = {each for each in everything if each.startswith(("nvidia-", "cuda-")) or each == "triton"}
    left_out = [f"--no-emit-package={each}" for each in sorted({"torch", *cuda})]
    text = compiled(pins["engine"], *left_out)
    missing = {name.match(pin).group().lower() for pin in without_torch} - names(text)
    if missing:
        raise SetupError(f"The lock lacks {', '.join(sorted(missing))}.")
    header = "# The engine's packages with hashes; written by python3 dev.py lock from pyproject.toml.\n"
    tools = [without_hashes(pin) for group in TOOL_GROUPS for pin in pins[group]]
    text += "# Not installed with the others; set-up checks these before pip runs and LLVM is unpacked.\n"
    text += compiled(tools, "--no-deps")
    (ROOT / LOCK_NAME).write_text(header + text, encoding="utf-8")
    print(ROOT / LOCK_NAME)
    for extra in EXTRAS:  # what they need beside the engine's packages
        lines = parse_lock(compiled([*pins[extra], *pins["engine"]]))
        added = [line for line in lines if name.match(line).group() not in everything]
        install_list(extra).write_text("\n".join(added) + "\n", encoding="utf-8")
        print(install_list(extra))
    return 0


# A file's tests share what its fixtures make, therefore they run in one process. The files come in the order
# of their names: by default those of few tests come last, which take the longest, and one process waits.
TEST_PROCESSES = ("--numprocesses=logical", "--maxprocesses=4", "--dist=loadfile", "--no-loadscope-reorder")
COMMANDS = {
    "demo": lambda extra: call(str(PRODUCT), *DEMO, *extra),
    "test": lambda extra: call("-m", "pytest", "-q", *TEST_PROCESSES, *extra),
    "run": lambda extra: call(str(PRODUCT), *extra),
    "accuracy": lambda extra: call(str(ROOT / "benchmarks" / "accuracy.py"), *extra),
    "scoreboard": lambda extra: call(str(ROOT / "benchmarks" / "scoreboard.py"), *extra),
    "speed": lambda extra: call(str(ROOT / "benchmarks" / "speed.py"), *extra),
    "lint": lambda extra: lint(),
    "lock": lambda extra: lock(),
    "docs": lambda extra: call("-m", "mkdocs", "build", "--strict", *extra),
    "build": lambda extra: build(),
    "index": lambda extra: index_extensions(),
    "release": lambda extra: release(*extra[:1] or [""]),
    "results": lambda extra: call(str(ROOT / "benchmarks" / "results.py"), *extra),
    "setup": lambda extra: 0,
}


def other_python() -> str | None:
    """A supported Python on the search path, or None."""
    for major, minor in SUPPORTED_PYTHONS:
        found = shutil.which(f"python{major}.{minor}")
        code = f"import sys; sys.exit(sys.version_info[:2] != ({major}, {minor}))"
        if found and subprocess.call([found, "-c", code], stderr=subprocess.DEVNULL) == 0:
            return found
    return None


def main(argv: list[str]) -> int:
    """Run one command; returns its exit status."""
    if not argv or argv[0] not in COMMANDS:
        print(__doc__.strip())
        return 0 if argv and argv[0] in ("-h", "--help") else 2
    if sys.version_info[:2] not in SUPPORTED_PYTHONS:
        if python := other_python():
            return subprocess.call([python, __file__, *argv])
        wanted = " or ".join(f"{major}.{minor}" for major, minor in SUPPORTED_PYTHONS)
        print(f"This is Python {platform.python_version()}; Python {wanted} is needed.", file=sys.stderr)
        return 1
    try:
        set_up()
        return COMMANDS[argv[0]](argv[1:])
    except SetupError as error:
        print(f"dev.py: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    sys.exit(main(sys.argv[1:]))
