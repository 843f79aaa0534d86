#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged and hostile inputs for every reader: none may hang, take much memory, crash, or touch other files.

    .venv/bin/python benchmarks/fuzz.py --inputs 10000 --seed 1 [--only colmap-binary transforms]

Each input is a valid sample with a few mutations, read by a child process of its own. A reader passes where
it accepts the input or ends with an error that has a code and a remedy. Failing inputs are kept below
--output.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.fuzz_targets import TARGETS, Target
from fipt_blender.core.run.errors import FiptError

MOST_SECONDS = 20.0
MOST_BYTES = 2_000_000_000
_POLL_SECONDS = 0.002
_TOLD = 500  # inputs between two lines that tell how many were tried
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


@dataclass(frozen=True)
class Verdict:
    """How a reader took an input.

    Attributes:
        outcome: "accepted", "refused" or what went wrong.
        seconds: wall time.
        peak_bytes: memory beyond what the process had before.
    """

    outcome: str
    seconds: float
    peak_bytes: int

    @property
    def passed(self) -> bool:
        """Whether the reader did what it should."""
        return self.outcome in ("accepted", "refused")


# ---------------------------------------------------------------------------------------------- mutations


def mutate(folder: Path, rng: np.random.Generator) -> str:
    """Damage one or two files of a sample; returns what was done."""
    done = []
    for _ in range(int(rng.integers(1, 3))):
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        path = files[int(rng.integers(len(files)))]
        kind = path.suffix.lower()
        if kind in _JSON_FILES and rng.random() < 0.8:
            done.append(f"{path.name}: {_mutate_json(path, rng)}")
        elif kind in _TEXT_FILES and rng.random() < 0.7:
            done.append(f"{path.name}: {_mutate_text(path, rng)}")
        else:
            done.append(f"{path.name}: {_mutate_bytes(path, files, rng)}")
    return "; ".join(done)


def _mutate_bytes(path: Path, files: Sequence[Path], rng: np.random.Generator) -> str:
    data = bytearray(path.read_bytes())
    kind = rng.choice(["cut", "flip", "integer", "remove", "repeat", "empty", "other", "zeros"])
    place = int(rng.integers(len(data) + 1))
    if kind == "cut":
        del data[place:]
    elif kind == "flip":
        for _ in range(int(rng.integers(1, 9))):
            if data:
                data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    elif kind == "integer":
        value = int(rng.choice(np.array(_INTEGERS, np.uint64)))
        layout = "<Q" if rng.random() < 0.5 else "<I"
        value &= 2 ** (8 * struct.calcsize(layout)) - 1
        data[place : place + struct.calcsize(layout)] = struct.pack(layout, value)
    elif kind == "remove":
        del data[place : place + int(rng.integers(1, 65))]
    elif kind == "repeat":
        data[place:place] = data[place : place + int(rng.integers(1, 1025))]
    elif kind == "empty":
        data.clear()
    elif kind == "other":
        data = bytearray(files[int(rng.integers(len(files)))].read_bytes())
    else:
        data[place : place + 64] = bytes(min(64, len(data) - place))
    path.write_bytes(data)
    return f"{kind} at {place}"


def _mutate_text(path: Path, rng: np.random.Generator) -> str:
    if rng.random() < 0.05:
        lines = path.read_bytes().splitlines(keepends=True) or [b""]
        place = int(rng.integers(len(lines)))
        path.write_bytes(b"".join([*lines[:place], lines[place] * _MANY_LINES, *lines[place:]]))
        return f"line {place} {_MANY_LINES} times"
    words = path.read_text(encoding="utf-8", errors="replace").split(" ")
    place, word = int(rng.integers(len(words))), _WORDS[int(rng.integers(len(_WORDS)))]
    words[place] = word
    path.write_bytes(" ".join(words).encode("utf-8", errors="surrogatepass"))
    return f"word {place} is {word[:20]!r}"


def _mutate_json(path: Path, rng: np.random.Generator) -> str:
    try:
        data = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        return "not JSON any more"
    places: list[tuple[Any, Any]] = []

    def collect(value: Any) -> None:
        keys = (
            list(value) if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
        )
        for key in keys:
            places.append((value, key))
            collect(value[key])

    collect(data)
    kind = rng.choice(["value", "value", "value", "remove", "deep", "many"])
    if kind == "deep":
        path.write_text("[" * 50_000 + "]" * 50_000)
        return "deep"
    if not places:
        return "empty"
    holder, key = places[int(rng.integers(len(places)))]
    if kind == "remove":
        del holder[key]
    elif kind == "many":
        holder[key] = [holder[key]] * 3
    else:
        holder[key] = _VALUES[int(rng.integers(len(_VALUES)))]
    path.write_bytes(json.dumps(data).encode("utf-8", errors="surrogatepass"))
    return f"{kind} at {key!r}"


# ------------------------------------------------------------------------------------------------- running


def judge(target: Target, sample: Path, base: Path) -> Verdict:
    """Let a child process read a sample.

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
    seconds, peak = time.monotonic() - started, max(usage.ru_maxrss * 1024 - own_bytes, 0)
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        outcome = "hung" if number == signal.SIGKILL else f"signal {signal.Signals(number).name}"
    elif peak > MOST_BYTES:
        outcome = "memory"
    elif _snapshot(base) != before:
        outcome = "touched other files"
    else:
        outcome = said or f"status {os.WEXITSTATUS(status)}"
    return Verdict(outcome, seconds, peak)


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


def run_inputs(targets: Sequence[Target], inputs: int, seed: int, keep: Path | None) -> list[dict[str, Any]]:
    """The failures among `inputs` mutated samples; see `tries`."""
    return [failure for failure in tries(targets, inputs, seed, keep) if failure]


def tries(
    targets: Sequence[Target], inputs: int, seed: int, keep: Path | None
) -> Iterator[dict[str, Any] | None]:
    """Try `inputs` mutated samples, the targets taking turns; yields each failure, or None.

    Args:
        targets: the readers.
        inputs: how many inputs altogether.
        seed: of the mutations; input i of a seed is always the same.
        keep: where failing inputs are copied to.
    """
    with tempfile.TemporaryDirectory(prefix="fipt-fuzz-") as temporary:
        samples = {target.name: Path(temporary) / target.name for target in targets}
        for target in targets:
            samples[target.name].mkdir()
            target.write(samples[target.name])
            for name in target.modules:  # here, so that not each child imports them
                importlib.import_module(name)
        for index in range(inputs):
            target = targets[index % len(targets)]
            base = Path(temporary) / "case"
            shutil.copytree(samples[target.name], base / "sample")
            (base / "out").mkdir()
            what = mutate(base / "sample", np.random.default_rng([seed, index]))
            verdict = judge(target, base / "sample", base)
            if not verdict.passed and keep is not None:
                shutil.copytree(base / "sample", keep / f"{target.name}-{index}", dirs_exist_ok=True)
            shutil.rmtree(base)
            failed = {"input": index, "target": target.name, "what": what, **vars(verdict)}
            yield None if verdict.passed else failed


def main(argv: Sequence[str] | None = None) -> int:
    """Run the inputs and print the failures, the same ones together; 1 where there are any."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="end after this time")
    parser.add_argument("--only", nargs="*", default=[target.name for target in TARGETS])
    parser.add_argument("--output", type=Path, help="keep failing inputs here")
    options = parser.parse_args(argv)
    chosen = [target for target in TARGETS if target.name in options.only]
    started = time.monotonic()
    failures: list[dict[str, Any]] = []
    tried = 0
    for failure in tries(chosen, options.inputs, options.seed, options.output):
        tried += 1
        failures += [failure] if failure else []
        if tried % _TOLD == 0:
            print(f"{tried} inputs, {len(failures)} failures", file=sys.stderr, flush=True)
        if time.monotonic() - started > options.seconds:
            break
    by_outcome: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for failure in failures:
        by_outcome.setdefault((failure["target"], failure["outcome"]), []).append(failure)
    for (target, outcome), same in sorted(by_outcome.items(), key=lambda item: -len(item[1])):
        print(f"{len(same):5d}  {target}: {outcome}   (input {same[0]['input']}: {same[0]['what']})")
    seconds = time.monotonic() - started
    print(f"{tried} inputs, {len(failures)} failures, {seconds:.0f} s")
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
