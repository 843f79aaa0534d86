"""Damaged and hostile inputs for every reader: none may hang, take much memory, crash, or touch other files.

Each input is a valid sample with a few mutations, chosen by Hypothesis and read by a child process of its
own. A reader passes where it accepts the input or ends with an error that has a code and a remedy. Inputs
that fail are made as small as possible.
"""

from __future__ import annotations

import importlib
import json
import os
import resource
import shutil
import signal
import struct
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import hypothesis
from hypothesis import strategies as st

from fipt_blender.core.capture.mesh_file import read_mesh
from fipt_blender.core.run.errors import FiptError
from samples.fuzz_targets import Target

Draw = Callable[[st.SearchStrategy[Any]], Any]  # `draw` of Hypothesis

MOST_SECONDS = 20.0
MOST_BYTES = 2_000_000_000
_POLL_SECONDS = 0.002
_UNFORESEEN = ("engine-failed", "out-of-memory")
_INTEGERS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1)
_JSON_FILES = (".json", ".sfm", ".gltf")
_TEXT_FILES = (".txt", ".csv", ".xml", ".xmp", ".nvm", ".out", ".obj", ".mtl")
_MANY_LINES = 20_000
_WORDS = (
    "",
    "nan",
    "inf",
    "-1",
    "1e999",
    "9" * 400,
    *("1e308", "-1e308", "1e-308", "1e-5", "300000"),
    *("../../EVIL", "/etc/passwd", "/dev/zero", "//server/share/a.exr", "\\\\server\\share\\a.obj"),
    "a/" * 600 + "a.exr",
    "²",
    "\0",
    "\ud800",
    "a" * 300,
)
_VALUES: tuple[Any, ...] = (
    *(None, True, -1, 0, 0.5, 1e30, 10**30, 1e-320, 2**31),
    *(1e308, -1e308, 1e-308, 1e-5, 10**309, -(10**400), 300_000, float("nan"), float("inf")),
    *([], {}, [1], [[[]]], {"a": 1}, "x"),
    *_WORDS,
)


# ---------------------------------------------------------------------------------------------- mutations


def mutate(folder: Path, draw: Draw) -> str:
    """Damage one or two files of a sample; returns what was done.

    A mesh is read by Blender, which takes a second, and alike for all formats: `options` alone damages its own.
    """
    done = []
    for _ in range(draw(st.integers(1, 2))):
        files = sorted(path for path in folder.rglob("*") if path.is_file() and path != folder / "mesh.obj")
        path, kind = draw(st.sampled_from(files)), draw(st.integers(0, 19))
        if kind == 0:
            other = draw(st.sampled_from(files))
            path.write_bytes(other.read_bytes())
            done.append(f"{path.name} is {other.name}")
            continue
        mutation = _mutate_bytes
        if path.suffix.lower() in _JSON_FILES and kind > 4:
            mutation = _mutate_json
        elif path.suffix.lower() in _TEXT_FILES and kind > 6:
            mutation = _mutate_text
        done.append(f"{path.name}: {mutation(path, draw)}")
    return "; ".join(done)


def _mutate_bytes(path: Path, draw: Draw) -> str:
    data = bytearray(path.read_bytes())
    kind = draw(st.sampled_from(["cut", "flip", "integer", "remove", "repeat", "empty", "zeros"]))
    place = draw(st.integers(0, len(data)))
    if kind == "cut":
        del data[place:]
    elif kind == "flip" and data:
        for bit in draw(st.lists(st.integers(0, 8 * len(data) - 1), min_size=1, max_size=8)):
            data[bit // 8] ^= 1 << bit % 8
    elif kind == "integer":
        layout = draw(st.sampled_from(["<I", "<Q"]))
        value = draw(st.sampled_from(_INTEGERS)) & 2 ** (8 * struct.calcsize(layout)) - 1
        data[place : place + struct.calcsize(layout)] = struct.pack(layout, value)
    elif kind == "remove":
        del data[place : place + draw(st.integers(1, 64))]
    elif kind == "repeat":
        data[place:place] = data[place : place + draw(st.integers(1, 1024))]
    elif kind == "empty":
        data.clear()
    else:
        data[place : place + 64] = bytes(min(64, len(data) - place))
    path.write_bytes(data)
    return f"{kind} at {place}"


def _mutate_text(path: Path, draw: Draw) -> str:
    if draw(st.integers(0, 19)) == 19:
        lines = path.read_bytes().splitlines(keepends=True) or [b""]
        place = draw(st.integers(0, len(lines) - 1))
        path.write_bytes(b"".join([*lines[:place], lines[place] * _MANY_LINES, *lines[place:]]))
        return f"line {place} {_MANY_LINES} times"
    words = path.read_text(encoding="utf-8", errors="replace").split(" ")
    place, word = draw(st.integers(0, len(words) - 1)), draw(st.sampled_from(_WORDS))
    words[place] = word
    path.write_bytes(" ".join(words).encode("utf-8", errors="surrogatepass"))
    return f"word {place} is {word[:20]!r}"


def _mutate_json(path: Path, draw: Draw) -> str:
    try:
        data = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        return "not JSON any more"
    places: list[tuple[Any, Any]] = []

    def collect(value: Any) -> None:
        keys = list(value) if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
        for key in keys:
            places.append((value, key))
            collect(value[key])

    collect(data)
    kind = draw(st.sampled_from(["value", "value", "value", "remove", "deep", "many"]))
    if kind == "deep":
        path.write_text("[" * 50_000 + "]" * 50_000)
        return "deep"
    if not places:
        return "empty"
    holder, key = places[draw(st.integers(0, len(places) - 1))]
    if kind == "remove":
        del holder[key]
    elif kind == "many":
        holder[key] = [holder[key]] * 3
    else:
        holder[key] = draw(st.sampled_from(_VALUES))
    path.write_bytes(json.dumps(data).encode("utf-8", errors="surrogatepass"))
    return f"{kind} at {key!r}"


# ------------------------------------------------------------------------------------------------- running


def judge(target: Target, sample: Path, base: Path) -> str:
    """Let a child process read a sample; returns "accepted", "refused" or what went wrong.

    Args:
        target: the reader.
        sample: the folder that it reads.
        base: holds `sample` and an empty folder "out"; nothing else in it may change.
    """
    before = _snapshot(base)
    started, own_bytes = time.monotonic(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        _work(target, sample, base / "out", writer)
    os.close(writer)
    status, usage = _wait(child, started)
    with os.fdopen(reader, "rb") as pipe:
        said = pipe.read().decode("utf-8", errors="replace")
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        return "hung" if number == signal.SIGKILL else f"signal {signal.Signals(number).name}"
    if usage.ru_maxrss * 1024 - own_bytes > MOST_BYTES:
        return "memory"
    if _snapshot(base) != before:
        return "touched other files"
    return said or f"status {os.WEXITSTATUS(status)}"


def _work(target: Target, sample: Path, out: Path, pipe: int) -> None:
    """The child: read, say how it went, and end without any clean-up of the parent's."""
    outcome = "accepted"
    try:
        sink = os.open(os.devnull, os.O_RDWR)
        for descriptor in (0, 1, 2):
            os.dup2(sink, descriptor)
        limit = _virtual_bytes() + 2 * MOST_BYTES  # far more than MOST_BYTES, which is judged afterwards
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        try:
            target.read(sample, out)
        except FiptError as error:
            whole = error.code and error.text and error.remedy and error.code not in _UNFORESEEN
            outcome = "refused" if whole else f"{error.code}: {error.text}"
        except BaseException as error:
            frames = traceback.extract_tb(error.__traceback__)
            place = next((f for f in reversed(frames) if "fipt_blender" in f.filename), frames[-1])
            outcome = f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}: {error}"[:300]
        os.write(pipe, outcome.encode("utf-8", errors="replace"))
    finally:
        os._exit(0)


def _wait(child: int, started: float) -> tuple[int, resource.struct_rusage]:
    while True:
        done, status, usage = os.wait4(child, os.WNOHANG)
        if done:
            return status, usage
        if time.monotonic() - started > MOST_SECONDS:
            os.kill(child, signal.SIGKILL)
            _, status, usage = os.wait4(child, 0)
            return status, usage
        time.sleep(_POLL_SECONDS)


def _virtual_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


def _snapshot(base: Path) -> set[tuple[str, int]]:
    """Names and sizes of what lies beside the reader's own output."""
    paths = (path for path in base.rglob("*") if (base / "out") not in (path, *path.parents))
    return {(str(path.relative_to(base)), path.stat().st_size if path.is_file() else -1) for path in paths}


def try_target(target: Target, inputs: int, seed: int) -> None:
    """Try mutated samples of a reader.

    Args:
        inputs: how many samples at most.
        seed: of the mutations.

    Raises:
        AssertionError: what was done to the smallest sample that failed, and how it failed.
    """
    for name in target.modules:  # here, so that not each child imports them
        importlib.import_module(name)
    with tempfile.TemporaryDirectory(prefix="fipt-fuzz-") as temporary:
        sample, base = Path(temporary) / "sample", Path(temporary) / "case"
        sample.mkdir()
        target.write(sample)
        for mesh in sample.rglob("mesh.obj"):
            read_mesh(mesh)  # known to the children by conftest.py, unless it is damaged

        @hypothesis.seed(seed)
        @hypothesis.settings(
            max_examples=inputs, database=None, deadline=None, suppress_health_check=list(hypothesis.HealthCheck)
        )
        @hypothesis.given(st.data())
        def each_passes(data: st.DataObject) -> None:
            shutil.rmtree(base, ignore_errors=True)
            shutil.copytree(sample, base / "sample")
            (base / "out").mkdir()
            what = mutate(base / "sample", data.draw)
            outcome = judge(target, base / "sample", base)
            assert outcome in ("accepted", "refused"), f"{target.name}: {outcome}   ({what})"

        each_passes()
