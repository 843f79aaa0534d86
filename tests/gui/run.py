#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The GUI test's command: builds and installs the extension, opens a window, drives it (see README.md)."""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.path[:0] = [str(HERE), str(ROOT)]

import chapters  # noqa: E402
import story  # noqa: E402
from window import Window  # noqa: E402

import dev  # noqa: E402


def main(argv: list[str]) -> int:
    """Run the test, or some of its chapters; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--blender", default="blender", help="Blender's executable")
    parser.add_argument("--shots", type=Path, required=True, help="folder of the pictures")
    parser.add_argument(
        "--engine", type=Path, required=True, metavar="PYTHON", help="interpreter with the engine's packages"
    )
    parser.add_argument("--capture", type=Path, default=ROOT / "examples" / "room", help="the capture")
    parser.add_argument("--fast", action="store_true", help="few rays and steps: for work on the test itself")
    names = [chapter.name for chapter in story.CHAPTERS]
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument("--only", nargs="+", choices=names, metavar="CHAPTER", help=", ".join(names))
    chosen.add_argument("--from", dest="first", choices=names, metavar="CHAPTER", help="and all after it")
    options = parser.parse_args(argv)
    if not shutil.which("xvfb-run"):
        print("xvfb-run is needed for a window without a screen.", file=sys.stderr)
        return 2
    only = options.only or names[names.index(options.first or names[0]) :]
    acted = [chapter for chapter in story.CHAPTERS if chapter.name in only]
    options.shots.mkdir(parents=True, exist_ok=True)
    arguments = []
    if start := acted[0].after:
        arguments = [str(options.shots.resolve() / f"{start}.blend")]
        if not Path(arguments[0]).is_file():
            parser.error(f"{arguments[0]} is missing: act the chapter {start} first")
    else:
        shutil.rmtree(options.shots / "data", ignore_errors=True)
    told = chapters.Options(options.capture.resolve(), options.engine, options.fast)
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
                chapters.act(window, told, acted)
        except AssertionError as error:
            print(f"FAILED: {error}", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
