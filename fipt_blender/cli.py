# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line, behind `__main__.py` and `blender --command fipt`.

Exit status: 0 success, 1 the job failed (`error: ...` on stderr), 2 wrong usage, 130 stopped.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from .bridge.interpreter import engine_command
from .bridge.process import EngineProcess, Message
from .core.conventions import UP_AXES
from .core.run.errors import FiptError
from .core.run.runfolder import PRODUCT_VERSION, explained_write_errors
from .core.run.settings import PRESETS, make_settings
from .jobs.main_job import make_main_job
from .jobs.options import PARTS, RENDER_KINDS, MainJobOptions
from .jobs.run_job import find_launch

FORMATS = (
    *("auto", "fipt-synthetic", "fipt-real", "scannetpp", "transforms", "colmap", "metashape", "realityscan"),
    *("meshroom", "opensfm", "openmvg", "bundler", "nvm", "polycam", "record3d", "rgbd"),
)
_LINE_SECONDS = 5.0
_REFRESH_SECONDS = 0.2


def make_parser() -> argparse.ArgumentParser:
    """The parser of all commands and options."""
    parser = argparse.ArgumentParser(
        prog="fipt",
        description="Estimate the materials and lights of a room from posed HDR photographs and its mesh.",
    )
    parser.add_argument("--version", action="version", version=f"fipt {PRODUCT_VERSION}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    estimate = commands.add_parser(
        "estimate",
        help="run the whole job on a capture",
        description="Run the whole job: read the capture, estimate materials and lights, write a .blend with"
        " textures and emissive fixtures, Cycles renders and a report.",
    )
    add = estimate.add_argument
    add("capture", type=Path, metavar="CAPTURE", help="the capture's folder or its camera file")
    add("--mesh", type=Path, metavar="FILE", help="the room's mesh (default: the one beside the cameras)")
    add("--output", type=Path, metavar="DIR", help="the run folder (default: ./CAPTURE-fipt)")
    add("--preset", choices=tuple(PRESETS), default="medium", help="quality and duration (default: medium)")
    add("--device", choices=("auto", "cuda", "llvm"), help="GPU (cuda) or CPU (llvm) (default: auto)")
    add("--seed", type=int, metavar="N", help="seed of all random numbers (default: 0)")
    add("--rounds", type=int, metavar="N", help="number of refinements of light and materials")
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="change one constant of the method")
    add("--format", choices=FORMATS, default="auto", help="layout of the capture (default: auto)")
    up_axes = ("auto", *UP_AXES)
    add("--up-axis", choices=up_axes, default="auto", help="up axis of the capture; --up-axis=-y for -y")
    add("--scale", type=float, default=1.0, metavar="S", help="meters per unit of the capture (default: 1)")
    add("--hold-back", type=int, metavar="N", help="hold back every N-th view for comparison; 0 for none")
    add("--images", type=Path, metavar="DIR", help="folder of the HDR photographs")
    add("--views", type=int, default=0, metavar="N", help="use N photographs, evenly spread (default: all)")
    add("--voxel", type=float, metavar="M", help="meters, of a mesh fused from depth images (default: 0.02)")
    add(
        "--close-holes",
        type=float,
        metavar="M",
        help="close holes of a fused mesh up to this width in meters",
    )
    add(
        "--depth-unit", type=float, metavar="M", help="unit of 16-bit depth images in meters (default: 0.001)"
    )
    add("--clamp-negative", action="store_true", help="treat negative radiance in photographs as zero")
    add("--align-mesh", action="store_true", help="align the cameras to a mesh from another program")
    add(
        "--plane-room", action="store_true", help="without a mesh: fit a room of planes to the solve's points"
    )
    add(
        "--undo-applied-transform",
        action="store_true",
        help="transforms.json: the mesh has the coordinates from before nerfstudio's applied_transform",
    )
    add(
        "--parts",
        choices=PARTS,
        default="auto",
        help="how surfaces of the same material are recognized (default: auto)",
    )
    add("--hints", type=Path, metavar="FILE", help="what is known of surfaces (hints.json)")
    add(
        "--hints-again",
        type=Path,
        metavar="FILE",
        help="with --resume: estimate materials again with these hints; the computed light is kept",
    )
    add("--no-renders", action="store_true", help="do not render in Cycles")
    add("--cluster", metavar="ADDRESS", help="a Dask scheduler whose workers share the work on the views")
    add("--render-spp", type=int, default=64, metavar="N", help="Cycles samples per pixel (default: 64)")
    add("--render-view", default="", metavar="NAME", help="the view to render (default: a held-back one)")
    add("--resume", action="store_true", help="keep finished steps of an earlier run in the same folder")

    prepare = commands.add_parser(
        "prepare",
        help="make a capture from a folder of photographs",
        description="Make a capture from photographs: merge brackets to HDR images and solve the cameras. A"
        " command that was stopped goes on where it was when it is started again.",
    )
    add = prepare.add_argument
    add("photographs", type=Path, metavar="PHOTOGRAPHS", help="folder of the photographs")
    add(
        "--output", type=Path, metavar="CAPTURE", help="the capture's folder (default: ./PHOTOGRAPHS-capture)"
    )
    add("--steps", default="", metavar="NAMES", help="only some steps, separated by commas (default: all)")
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="change one setting of prepare.json")

    export = commands.add_parser(
        "export",
        help="write an estimated room as glTF or USD",
        description="Write the room of a .blend file with applied results, such as a run's room.blend, as"
        " glTF or USD. What the format can't hold is said in warnings.",
    )
    add = export.add_argument
    add("blend", type=Path, metavar="BLEND", help="the .blend file")
    add("file", type=Path, metavar="FILE", help="the file to write: .glb, .gltf, .usdc, .usda, .usd or .usdz")

    check = commands.add_parser("check", help="check whether the engine works, and on which device")
    for command in (estimate, prepare, check):
        add = command.add_argument
        add("--engine-python", metavar="PATH", help="Python interpreter with the engine's packages")
    for command in (estimate, prepare, export, check):
        add = command.add_argument
        add("--quiet", action="store_true", help="print only warnings and errors")
        add("--json", action="store_true", help="print the messages as JSON, one per line")
    return parser


def main(argv: Sequence[str]) -> int:
    """Run the command line and return its exit status; never raises SystemExit."""
    try:
        arguments = make_parser().parse_args(list(argv))
    except SystemExit as end:  # argparse; Blender would print a traceback
        return end.code if isinstance(end.code, int) else 2
    commands = {"estimate": _estimate, "prepare": _prepare, "export": _export, "check": _check}
    return commands[arguments.command](arguments)


def make_options(arguments: argparse.Namespace) -> MainJobOptions:
    """The job's options from parsed arguments.

    Raises:
        FiptError: ``setting-unknown``, ``setting-invalid`` or ``option-invalid``.
    """
    changes: dict[str, str | int] = {}
    for text in arguments.set:
        name, equals, value = text.partition("=")
        if not equals:
            raise FiptError("option-invalid", f"'--set {text}' has no '='.", "Write --set NAME=VALUE.")
        changes[name.strip()] = value.strip()
    for name in ("device", "seed", "rounds"):
        if getattr(arguments, name) is not None:
            changes[name] = getattr(arguments, name)
    if arguments.render_spp < 1:
        raise FiptError("option-invalid", f"--render-spp is {arguments.render_spp}.", "Give at least 1.")
    if arguments.hold_back is not None and (arguments.hold_back < 0 or arguments.hold_back == 1):
        raise FiptError(
            "option-invalid", f"--hold-back is {arguments.hold_back}.", "Give 0 for none, or at least 2."
        )
    if not 0.0 < arguments.scale < float("inf"):
        raise FiptError("option-invalid", f"--scale is {arguments.scale}.", "Give a number above 0.")
    capture = arguments.capture
    folder = capture.parent if capture.is_file() else capture
    return MainJobOptions(
        capture=capture,
        output=arguments.output or Path.cwd() / f"{folder.absolute().name}-fipt",
        mesh=arguments.mesh,
        settings=make_settings(arguments.preset, changes),
        format=arguments.format,
        up_axis=arguments.up_axis,
        scale=arguments.scale,
        hold_back=arguments.hold_back,
        images=arguments.images,
        clamp_negative=arguments.clamp_negative,
        align_mesh=arguments.align_mesh,
        plane_room=arguments.plane_room,
        views=arguments.views,
        voxel=arguments.voxel,
        close_holes=arguments.close_holes,
        depth_unit=arguments.depth_unit,
        undo_applied_transform=arguments.undo_applied_transform,
        parts=arguments.parts,
        renders=() if arguments.no_renders else RENDER_KINDS,
        render_view=arguments.render_view,
        render_spp=arguments.render_spp,
        resume=arguments.resume,
        engine_python=arguments.engine_python,
        cluster=arguments.cluster,
        hints=arguments.hints,
        hints_again=arguments.hints_again,
    )


def _estimate(arguments: argparse.Namespace) -> int:
    try:
        options = make_options(arguments)
    except FiptError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    try:
        job = make_main_job(options)
    except FiptError as error:
        return _report_error(arguments, error)
    run_log = options.output / "log.txt"
    with _private_stdout(run_log) as stream, _interrupts() as interrupts:
        display = _Display(stream, arguments.json, arguments.quiet)

        def show(message: Message) -> None:
            if message["type"] == "stage":
                interrupts(not message["name"].startswith("render-"))
            display.show(message)

        try:
            succeeded = job.run(show)
        except KeyboardInterrupt:
            display.end_line()
            print("stopped; to continue, add --resume to the same command.", file=sys.stderr)
            return 130
    return 0 if succeeded else 1


def _prepare(arguments: argparse.Namespace) -> int:
    photographs = arguments.photographs.absolute()
    capture = (arguments.output or Path.cwd() / f"{photographs.name}-capture").absolute()
    options = [f"--steps={arguments.steps}", *(f"--set={text}" for text in arguments.set)]
    try:
        with explained_write_errors(capture):
            capture.mkdir(parents=True, exist_ok=True)
    except FiptError as error:
        return _report_error(arguments, error)
    display = _Display(sys.stdout, arguments.json, arguments.quiet)
    command = ["prepare", *options, "--", str(photographs), str(capture)]
    return _run_engine(arguments, command, capture / "log.txt", display.show)[0]


def _export(arguments: argparse.Namespace) -> int:
    import bpy

    from .blend.export.exporting import export_room

    display = _Display(sys.stdout, arguments.json, arguments.quiet)
    blend = arguments.blend.absolute()
    try:
        if not blend.is_file():
            raise FiptError("file-missing", f"{blend} does not exist.", "Give a .blend file with results.")
        try:
            bpy.ops.wm.open_mainfile(filepath=str(blend), load_ui=False)
        except RuntimeError as error:
            text = f"{blend} can't be opened ({str(error).strip()})."
            raise FiptError("file-damaged", text, "Give a .blend file with results.") from None
        exported = export_room(bpy.context.scene, arguments.file.absolute())
    except FiptError as error:
        return _report_error(arguments, error)
    for warning in exported.warnings:
        display.show(warning)
    display.show({"type": "done", "files": [str(exported.path)], "data": {"objects": exported.objects}})
    return 0


def _check(arguments: argparse.Namespace) -> int:
    display = _Display(sys.stdout, arguments.json, arguments.quiet)

    def show(message: Message) -> None:
        display.show(message)
        if message["type"] == "done" and not arguments.json and not arguments.quiet:
            for name, value in message.get("data", {}).items():
                if isinstance(value, dict):
                    value = ", ".join(f"{key} {item or 'missing'}" for key, item in value.items())
                print(f"{name.replace('_', ' ')}: {'none' if value is None else value}")

    status, done = _run_engine(arguments, ["check"], Path(os.devnull), show)
    return status if status or (done and done["data"].get("ready", True)) else 1


def _run_engine(
    arguments: argparse.Namespace, command: list[str], log: Path, show: Callable[[Message], None]
) -> tuple[int, Message | None]:
    """Run one engine command; returns the exit status and its message `done`."""
    try:
        engine = find_launch(arguments.engine_python)
        process = EngineProcess(engine_command(engine.python, *command), log, engine.environment)
    except FiptError as error:
        return _report_error(arguments, error), None
    except OSError as error:
        explained = FiptError(
            "engine-missing",
            f"The engine's Python can't be started ({error}).",
            "Choose another interpreter (--engine-python).",
        )
        return _report_error(arguments, explained), None
    try:
        return (0 if process.run_blocking(show) else 1), process.done
    except KeyboardInterrupt:
        return 130, None


def _report_error(arguments: argparse.Namespace, error: FiptError) -> int:
    message = {"type": "error", "code": error.code, "text": error.text, "remedy": error.remedy}
    _Display(sys.stdout, arguments.json, arguments.quiet).show(message)
    return 1


class _Display:
    """Shows messages: as one updated line on a terminal, as a line every few seconds elsewhere, as JSON."""

    def __init__(self, stream: IO[str], as_json: bool, quiet: bool) -> None:
        self._stream = stream
        self._json = as_json
        self._quiet = quiet
        self._terminal = stream.isatty() and not as_json
        self._text = ""
        self._last = -1e9
        self._line_open = False

    def show(self, message: Message) -> None:
        """Show one message."""
        kind = message["type"]
        if self._json:
            self._stream.write(json.dumps(message) + "\n")
            self._stream.flush()
        if kind in ("warning", "error"):
            self.end_line()
            print(f"{kind}: {message['text']} {message['remedy']}", file=sys.stderr, flush=True)
        if self._json or self._quiet:
            return
        if kind == "stage":
            self._text = message["text"]
            self._last = -1e9
        elif kind == "progress":
            self._progress(message)
        elif kind == "done":
            self.end_line()
            self._files(message["files"])

    def end_line(self) -> None:
        """End the updated line, so that other output starts on a new one."""
        if self._line_open:
            self._stream.write("\n")
            self._stream.flush()
            self._line_open = False

    def _progress(self, message: Message) -> None:
        now = time.monotonic()
        if now - self._last < (_REFRESH_SECONDS if self._terminal else _LINE_SECONDS):
            return
        self._last = now
        line = f"{100 * message['fraction']:3.0f} %  {self._text}"
        if message.get("remaining_seconds") is not None:
            line += f", {format_seconds(message['remaining_seconds'])} left"
        if self._terminal:
            width = _terminal_width(self._stream)
            self._stream.write(f"\r{line[: width - 1]}\x1b[K")
            self._line_open = True
        else:
            self._stream.write(line + "\n")
        self._stream.flush()

    def _files(self, files: Sequence[str]) -> None:
        for name in files:
            try:
                size = format_size(os.path.getsize(name))
            except OSError:
                size = "?"
            self._stream.write(f"{size:>9}  {name}\n")
        self._stream.flush()


def format_seconds(seconds: float) -> str:
    """A duration in one or two units: "45 s", "3 min 20 s", "1 h 5 min"."""
    rounded = int(seconds + 0.5)
    if rounded < 60:
        return f"{rounded} s"
    if rounded < 3600:
        return f"{rounded // 60} min {rounded % 60} s"
    return f"{rounded // 3600} h {rounded % 3600 // 60} min"


def format_size(size: int) -> str:
    """A file size in B, kB, MB or GB (powers of 1000)."""
    value = float(size)
    for unit in ("B", "kB", "MB", "GB"):
        if value < 1000 or unit == "GB":
            break
        value /= 1000
    return f"{value:.0f} {unit}" if unit == "B" else f"{value:.1f} {unit}"


def _terminal_width(stream: IO[str]) -> int:
    try:
        return os.get_terminal_size(stream.fileno()).columns or 80
    except OSError:
        return 80


@contextmanager
def _private_stdout(log: Path) -> Iterator[IO[str]]:
    """A stream to stdout for the display alone; Blender's own output goes to the log meanwhile.

    Blender prints in C, so the file descriptor itself is redirected, and restored at the end.
    """
    sys.stdout.flush()
    try:
        saved = os.dup(1)
        with open(log, "ab") as file:
            os.dup2(file.fileno(), 1)
    except OSError:  # no console (Windows), or a full disk: share stdout
        yield sys.stdout
        return
    stream = os.fdopen(saved, "w", encoding="utf-8", errors="replace", buffering=1)
    try:
        yield stream
    finally:
        sys.stdout.flush()
        if sys.platform != "win32":
            ctypes.CDLL(None).fflush(None)  # flushes the output of Blender's C code
        stream.flush()
        os.dup2(saved, 1)
        stream.close()


@contextmanager
def _interrupts() -> Iterator[Callable[[bool], None]]:
    """Turn Ctrl-C and SIGTERM into KeyboardInterrupt, also where Blender has installed its own handler.

    Yields a switch: off, the signals end the process at once. That is for renders, during which Python
    handles no signals; no engine runs then, and all finished work is on the disk.
    """
    numbers = (signal.SIGINT, signal.SIGTERM)

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    def switch(on: bool) -> None:
        for number in numbers:
            signal.signal(number, interrupt if on else signal.SIG_DFL)

    handlers = [signal.getsignal(number) for number in numbers]
    switch(True)
    try:
        yield switch
    finally:
        for number, handler in zip(numbers, handlers, strict=True):
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
