"""The arguments of the command line, and the options of the whole job from them."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TypeAlias

from ..core.run.declared import add_options, declared, options_of
from ..core.run.errors import FiptError
from ..core.run.runfolder import PRODUCT_VERSION
from ..core.run.settings import Settings, make_settings
from ..jobs.options import MainJobOptions

_Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"


def make_parser() -> argparse.ArgumentParser:
    """The parser of all commands and options."""
    parser = argparse.ArgumentParser(
        prog="fipt",
        description="Estimate the materials and lights of a room from posed photographs and its mesh.",
    )
    parser.add_argument("--version", action="version", version=f"fipt {PRODUCT_VERSION}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    estimate, prepare, export = _add_estimate(commands), _add_prepare(commands), _add_export(commands)
    check = commands.add_parser("check", help="check whether the engine works, and on which device")
    for command in (estimate, prepare, check):
        add = command.add_argument
        add("--engine-python", metavar="PATH", help="Python interpreter with the engine's packages")
    for command in (estimate, prepare, export, check):
        add = command.add_argument
        add("--quiet", action="store_true", help="print only warnings and errors")
        add("--json", action="store_true", help="print the messages as JSON, one per line")
    return parser


def _add_estimate(commands: _Commands) -> argparse.ArgumentParser:
    """The parser of `estimate`."""
    estimate = commands.add_parser(
        "estimate",
        help="run the whole job on a capture",
        description="Run the whole job: read the capture, estimate materials and lights, write a .blend with"
        " textures and emissive fixtures, Cycles renders and a report.",
    )
    add = estimate.add_argument
    add("capture", type=Path, metavar="CAPTURE", help="the capture's folder or its camera file")
    add("--output", type=Path, metavar="DIR", help="the run folder (default: ./CAPTURE-fipt)")
    for name in ("preset", "device", "seed", "rounds"):
        item = declared(Settings)[name]
        add(item.flag, choices=item.option.identifiers or None, help=item.option.text)
    add("--force", action="store_true", default=None, help=declared(Settings)["force"].option.text)
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="change one constant of the method")
    add_options(estimate, MainJobOptions, without=("own_paths", "engine_python"))
    add("--no-renders", action="store_true", help="do not render in Cycles")
    return estimate


def _add_prepare(commands: _Commands) -> argparse.ArgumentParser:
    """The parser of `prepare`."""
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
    text = "layer or part of EXR photographs that have several"
    add("--layer", dest="set", action="append", type="layer={}".format, metavar="NAME", help=text)
    return prepare


def _add_export(commands: _Commands) -> argparse.ArgumentParser:
    """The parser of `export`."""
    export = commands.add_parser(
        "export",
        help="write an estimated room as glTF or USD",
        description="Write the room of a .blend file with applied results, such as a run's room.blend, as"
        " glTF or USD. What the format can't hold is said in warnings.",
    )
    add = export.add_argument
    add("blend", type=Path, metavar="BLEND", help="the .blend file")
    add("file", type=Path, metavar="FILE", help="the file to write: .glb, .gltf, .usdc, .usda, .usd or .usdz")
    add("--texture-size", type=int, default=4096, metavar="N", help="most texels of a side of a texture")
    text = "in glTF, write no lights for lamps, whose surfaces glow (for path tracers)"
    add("--no-lamp-lights", dest="lamp_lights", action="store_false", help=text)
    return export


def make_options(arguments: argparse.Namespace) -> MainJobOptions:
    """The job's options from parsed arguments.

    Raises:
        FiptError: ``setting-unknown``, ``setting-invalid`` or ``option-invalid``.
    """
    changes: dict[str, str | int] = {}
    for text in arguments.set:
        name, equals, value = text.partition("=")
        if not equals:
            raise FiptError("option-invalid.make-options", text=text)
        changes[name.strip()] = value.strip()
    for name in ("device", "seed", "rounds", "force"):
        if getattr(arguments, name) is not None:
            changes[name] = getattr(arguments, name)
    capture = arguments.capture
    folder = capture.parent if capture.is_file() else capture
    return MainJobOptions(
        **options_of(arguments, MainJobOptions),
        capture=capture,
        output=arguments.output or Path.cwd() / f"{folder.absolute().name}-fipt",
        settings=make_settings(arguments.preset or "medium", changes),
        renders=not arguments.no_renders,
    )
