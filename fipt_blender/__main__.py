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
    """The package's name; when run as a file, import it from its parent folder first."""
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
    """The arguments for this command line: those after `--` in Blender, all of them elsewhere."""
    file = Path(__file__).resolve()
    if __package__ or Path(sys.argv[0]).resolve() in (file, file.parent):
        return sys.argv[1:]
    return sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []


def main() -> None:
    """Run the command line and exit with its status."""
    try:
        status = importlib.import_module(".cli", _package()).main(_arguments())
    except Exception:  # Blender would exit with status 0
        traceback.print_exc()
        status = 1
    sys.stdout.flush()
    sys.stderr.flush()
    # Not sys.exit: Blender would keep running, and bpy as a module can hang or crash at exit.
    os._exit(status)


if __name__ == "__main__":
    main()
