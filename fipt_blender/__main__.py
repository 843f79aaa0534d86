# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line as a file to run.

`blender --background --python fipt_blender/__main__.py -- ARGS`, or with a Python that has bpy
`python fipt_blender/__main__.py ARGS` and `python -m fipt_blender ARGS`.
"""

from __future__ import annotations

import importlib
import os
import sys
import traceback
from pathlib import Path


def _package() -> str:
    """The package's name; run as a file there is none, so its parent folder is made importable."""
    if __package__:
        return __package__
    folder = Path(__file__).resolve().parent
    sys.path.insert(0, str(folder.parent))
    try:
        importlib.import_module(folder.name)
    finally:
        sys.path.remove(str(folder.parent))
    return folder.name


def _arguments() -> list[str]:
    """Our part of the command line: behind `--` in Blender, all of it elsewhere."""
    file = Path(__file__).resolve()
    if __package__ or Path(sys.argv[0]).resolve() in (file, file.parent):
        return sys.argv[1:]
    return sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []


def main() -> None:
    """Run the command line and leave with its exit status."""
    try:
        status = importlib.import_module(".cli", _package()).main(_arguments())
    except Exception:  # after a script's exception Blender would end with status 0
        traceback.print_exc()
        status = 1
    sys.stdout.flush()
    sys.stderr.flush()
    # Not sys.exit: Blender goes on after a script's end, and bpy as a module can hang or crash while it ends.
    os._exit(status)


if __name__ == "__main__":
    main()
