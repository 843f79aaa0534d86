#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The GUI test's command: builds and installs the extension, opens a window, drives it (see README.md)."""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.path[:0] = [str(HERE), str(ROOT)]

import chapters  # noqa: E402
import story  # noqa: E402
from window import Window  # noqa: E402

import dev  # noqa: E402


def look(window: Window, sections: list[str]) -> None:
    """Open sections one by one and take a screenshot of each."""
    for label in sections or window.sections():
        window.open_section(label)
        window.shot(f"section_{label.lower()}")


def main(argv: list[str]) -> int:
    """Run the test, or only take screenshots; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--blender", default="blender", help="Blender's executable")
    parser.add_argument("--shots", type=Path, required=True, help="folder of the pictures")
    parser.add_argument("--look", nargs="*", metavar="SECTION", help="only open sections and picture them")
    parser.add_argument("--open", type=Path, metavar="BLEND", help="a file to open first")
    parser.add_argument("--before", type=Path, metavar="PY", help="with --look: a script to run first")
    parser.add_argument(
        "--engine", type=Path, metavar="PYTHON", help="interpreter with the engine's packages"
    )
    parser.add_argument("--capture", type=Path, default=ROOT / "examples" / "room", help="the capture")
    parser.add_argument("--fast", action="store_true", help="few rays and steps: for work on the test itself")
    names = [chapter.name for chapter in story.CHAPTERS]
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument("--only", type=_names, default=[], metavar="CHAPTER,...", help=", ".join(names))
    chosen.add_argument("--from", dest="first", choices=names, help="a chapter and all after it")
    options = parser.parse_args(argv)
    if options.look is None and options.engine is None:
        parser.error("--engine is needed, or --look")
    if not shutil.which("xvfb-run"):
        print("xvfb-run is needed for a window without a screen.", file=sys.stderr)
        return 2
    if options.look is not None:
        arguments = [str(options.open.resolve())] if options.open else []
        arguments += ["--python", str(options.before.resolve())] if options.before else []
        return _drive(options, arguments, lambda window: look(window, options.look))
    only = names[names.index(options.first) :] if options.first else options.only
    options.shots.mkdir(parents=True, exist_ok=True)
    start, rest = chapters.plan(
        story.CHAPTERS, only, lambda name: (options.shots / f"{name}.blend").is_file()
    )
    arguments = []
    if start:
        arguments = [str(options.shots.resolve() / f"{start}.blend")]
    else:
        shutil.rmtree(options.shots / "data", ignore_errors=True)
    told = chapters.Options(options.capture.resolve(), options.engine, options.fast)
    return _drive(options, arguments, lambda window: chapters.act(window, told, rest))


def _names(text: str) -> list[str]:
    """Names of chapters, of a list with commas."""
    names = text.split(",")
    if unknown := set(names) - {chapter.name for chapter in story.CHAPTERS}:
        raise argparse.ArgumentTypeError(f"there is no chapter {', '.join(sorted(unknown))}")
    return names


def _drive(
    options: argparse.Namespace,
    arguments: list[str],
    act: Callable[[Window], None],
) -> int:
    """Open a window with the extension and act in it; the exit status."""
    data = options.shots.resolve() / "data"  # the run and the saved preferences
    with tempfile.TemporaryDirectory() as folder:
        extension = dev.build_extension(Path(folder))
        try:
            with Window(
                options.blender,
                options.shots,
                extension=extension,
                inside=[HERE / "inside.py"],
                arguments=arguments,
                environment={"FIPT_DATA": str(data)},
            ) as window:
                act(window)
        except AssertionError as error:
            print(f"FAILED: {error}", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
