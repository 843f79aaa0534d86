#!/usr/bin/env python3
"""Run the tests of the pure-Blender part on each supported Blender: python3 tests/matrix.py [VERSION ...]

Each version gets a small environment below out/matrix/, with bpy and of the engine what baking textures needs. Where
Mitsuba finds no LLVM that works, set DRJIT_LIBLLVM_PATH.
Python 3.11 and 3.13 must be there (on the search path, from pyenv, or named: --python 3.13=PATH).
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "out" / "matrix"
sys.path.insert(0, str(ROOT))

from fipt_blender.bridge.pins import read_pins  # noqa: E402

# bpy by version, and the Python that it is built for; 4.2 is the oldest that is supported.
VERSIONS = {"4.2.23": "3.11", "4.5.15": "3.11", "5.0.1": "3.11", "5.2.3": "3.13"}
# What the tests need besides bpy; the versions are those pinned for the engine.
PACKAGES = "numpy scipy drjit mitsuba OpenEXR OpenImageIO exifread pillow jinja2 psutil pytest".split()
# Sockets, colour spaces, exported files, UVs, cameras, write-back, revert.
TESTS = (
    "test_blend_atlas.py",
    "test_blend_capture.py",
    "test_blend_export.py",
    "test_blend_export_light.py",
    "test_blend_results.py",
    "test_blend_room.py",
    "test_blend_scene_cameras.py",
    "test_operators_materials.py",
    "test_operators_modelling.py",
    "test_operators_textures.py",
    "test_textures_write_back.py",
)
# Tests that compare Cycles with the engine's BRDF.
NEEDS_ENGINE = "test_cycles_agrees"


def find_python(version: str, named: dict[str, str]) -> str:
    """An interpreter of a version.

    Raises:
        SystemExit: there is none.
    """
    candidates = [named.get(version), shutil.which(f"python{version}")]
    candidates += map(str, sorted(Path.home().glob(f".pyenv/versions/{version}*/bin/python{version}")))
    if sys.version_info[:2] == tuple(map(int, version.split("."))):
        candidates.insert(1, sys.executable)
    code = "import sys, venv; print('.'.join(map(str, sys.version_info[:2])))"
    for python in filter(None, candidates):
        result = subprocess.run([python, "-c", code], capture_output=True, text=True, check=False)
        if result.stdout.strip() == version:
            return python
    raise SystemExit(f"No Python {version} was found: install it, or name it by --python {version}=PATH.")


def requirements(bpy: str) -> list[str]:
    """Packages of an environment."""
    pins = read_pins()
    wanted = [pin for pin in pins["engine"] + pins["dev"] if pin.partition("==")[0] in PACKAGES]
    return [f"bpy=={bpy}", *wanted]


def make_environment(bpy: str, python: str) -> Path:
    """Make a version's environment unless it exists; returns its interpreter."""
    folder = FOLDER / bpy
    wanted, stamp = requirements(bpy), folder / "installed.json"
    interpreter = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    if stamp.exists() and json.loads(stamp.read_text(encoding="utf-8")) == wanted:
        return interpreter
    shutil.rmtree(folder, ignore_errors=True)
    subprocess.run([python, "-m", "venv", str(folder)], check=True)
    command = [str(interpreter), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*command, *wanted], check=True)
    stamp.write_text(json.dumps(wanted), encoding="utf-8")
    return interpreter


def main(argv: list[str]) -> int:
    """Run all versions, or those named; returns 0 if all pass."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("versions", nargs="*", metavar="VERSION", help=f"of {', '.join(VERSIONS)}")
    parser.add_argument("--python", action="append", default=[], metavar="3.13=PATH", help="an interpreter")
    options, extra = parser.parse_known_args(argv)
    if unknown := set(options.versions) - set(VERSIONS):
        parser.error(f"unknown: {', '.join(unknown)}")
    named = dict(item.split("=", 1) for item in options.python)
    files = [str(ROOT / "tests" / name) for name in TESTS]
    failed = []
    for bpy in options.versions or VERSIONS:
        interpreter = make_environment(bpy, find_python(VERSIONS[bpy], named))
        print(f"bpy {bpy}, Python {VERSIONS[bpy]}", flush=True)
        start = time.monotonic()
        options_given = ["-q", "-p", "no:cacheprovider", "-k", f"not {NEEDS_ENGINE}", *extra]
        command = [str(interpreter), "-m", "pytest", *options_given, *files]
        status = subprocess.call(command, cwd=ROOT, env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"})
        print(f"bpy {bpy}: status {status}, {time.monotonic() - start:.0f} s", flush=True)
        if status:
            failed.append(bpy)
    print(f"failed: {', '.join(failed)}" if failed else "all passed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
