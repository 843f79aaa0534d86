# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where things lie: the package, the user's runs and the engine's environments. Standard library only.

Blender deletes an extension's folder on upgrade and its user folder on removal, so neither holds any of it.
"""

from __future__ import annotations

import os
import re
import sys
import time
from pathlib import Path

from ..core.job.runfolder import explained_write_errors

PACKAGE_FOLDER = Path(__file__).resolve().parent.parent
DATA_VARIABLE = "FIPT_DATA"
_RUN_NAME_LENGTH = 40


def default_data_folder() -> Path:
    """The user's data folder: $FIPT_DATA, or the platform's place for an application's data."""
    if named := os.environ.get(DATA_VARIABLE):
        return Path(named).expanduser().absolute()
    home = Path(os.path.expanduser("~"))  # Path.home() raises where there is none
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = home / "Library" / "Application Support"
    else:
        base = Path(os.environ.get("XDG_DATA_HOME") or home / ".local" / "share")
    return base / "fipt_blender"


def runs_folder(data: Path) -> Path:
    """Where runs lie that the user gave no folder of their own."""
    return data / "runs"


def new_run_folder(data: Path, name: str) -> Path:
    """Make a fresh, empty folder for a run, named after what it is about and when.

    Args:
        data: the data folder.
        name: what the user will recognise it by, e.g. the name of the .blend or of the capture.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    slug = re.sub(r"[^\w-]+", "-", name).strip("-_")[:_RUN_NAME_LENGTH] or "run"
    stem = f"{slug}-{time.strftime('%Y%m%d-%H%M%S')}"
    folder, number = runs_folder(data) / stem, 1
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
    """The interpreter inside a virtual environment's folder."""
    return folder / "Scripts" / "python.exe" if sys.platform == "win32" else folder / "bin" / "python"


def site_packages(folder: Path) -> Path:
    """Where a virtual environment keeps its packages; it exists."""
    if sys.platform == "win32":
        return folder / "Lib" / "site-packages"
    return next((folder / "lib").glob("python3*")) / "site-packages"
