"""The folders of the package, of the user's runs and of the engine's environments. Standard library only.

Blender deletes an extension's folder on upgrade and its user folder on removal, therefore neither is used.
"""

from __future__ import annotations

import os
import re
import sys
import time
from pathlib import Path

from ..core.run.runfolder import explained_write_errors

PACKAGE_FOLDER = Path(__file__).resolve().parent.parent
DATA_VARIABLE = "FIPT_DATA"


def default_data_folder() -> Path:
    """The user's data folder: $FIPT_DATA, or the platform's place for an application's data."""
    if named := os.environ.get(DATA_VARIABLE):
        return Path(named).expanduser().absolute()
    home = Path(os.path.expanduser("~"))  # Path.home() raises an error if there is none
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = home / "Library" / "Application Support"
    else:
        base = Path(os.environ.get("XDG_DATA_HOME") or home / ".local" / "share")
    return base / "fipt_blender"


def runs_folder(data: Path) -> Path:
    """The folder of the runs for which the user has not chosen a folder."""
    return data / "runs"


def new_run_folder(parent: Path, name: str) -> Path:
    """Make a new, empty folder for a run; its name contains `name` and the time, instead of an earlier time.

    Args:
        parent: the folder in which it is made.
        name: by which the user recognises the run, e.g. the name of the .blend file or of the capture.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    name = re.sub(r"-\d{8}-\d{6}(-\d+)?$", "", name)
    slug = re.sub(r"[^\w-]+", "-", name).strip("-_")[:40] or "run"
    stem = f"{slug}-{time.strftime('%Y%m%d-%H%M%S')}"
    folder, number = parent / stem, 1
    with explained_write_errors(folder):
        while True:
            try:
                folder.mkdir(parents=True)
                return folder
            except FileExistsError:
                if not folder.parent.is_dir():
                    raise
                number += 1
                folder = folder.with_name(f"{stem}-{number}")


def environment_python(folder: Path) -> Path:
    """The interpreter of a virtual environment."""
    return folder / "Scripts" / "python.exe" if sys.platform == "win32" else folder / "bin" / "python"
