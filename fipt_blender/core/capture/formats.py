# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The registry of capture formats: a format is one module with NAME, LOOKS_FOR, detect and read."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

from ..job.errors import FiptError
from . import colmap, fipt_real, fipt_synthetic, transforms
from .rig import ReadOptions, Rig

# Order decides where a folder fits several: nerfstudio keeps a COLMAP model beside its transforms.json.
FORMATS: dict[str, ModuleType] = {
    module.NAME: module for module in (fipt_synthetic, fipt_real, transforms, colmap)
}


def detect_format(path: Path) -> str:
    """The name of the first format that fits a capture.

    Raises:
        FiptError: ``capture-missing`` or ``format-unknown``.
    """
    if not path.exists():
        raise FiptError("capture-missing", f"The capture {path} does not exist.", "Correct the path.")
    for name, module in FORMATS.items():
        if module.detect(path):
            return name
    sought = "; ".join(f"{name}: {module.LOOKS_FOR}" for name, module in FORMATS.items())
    raise FiptError(
        "format-unknown",
        f"{path} is no capture that can be read. Looked for {sought}.",
        "Point to the folder that holds these files, or export the capture in one of these formats.",
    )


def read_rig(path: Path, name: str, options: ReadOptions) -> Rig:
    """Read a capture in a format of `FORMATS`, or "auto".

    Raises:
        FiptError: ``capture-missing``, ``format-unknown``, or one of the reader's.
    """
    detected = detect_format(path) if name == "auto" else name
    module = FORMATS[detected]
    if name != "auto":
        if not path.exists():
            raise FiptError("capture-missing", f"The capture {path} does not exist.", "Correct the path.")
        if not module.detect(path):
            raise FiptError(
                "format-unknown",
                f"{path} is no capture of the format {name}: there is no {module.LOOKS_FOR}.",
                "Leave the format to be found, or point to another folder.",
            )
    return module.read(path, options)
