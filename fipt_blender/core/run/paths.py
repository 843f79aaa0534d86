"""Where a path may lead that stands in a file: the one rule for all readers of captures, meshes and runs.

A path in a file that comes with a capture or a mesh leads only to files inside of that file's folder, or of
folders that the user has named (`leads_outside`). The run's own documents name photographs and meshes where
they lay when they were imported, anywhere on this computer, and nothing else (`foreign_fault`). No path in a
file leads to another computer, to a device or to a pipe. Standard library only.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

# At least those of `capture.suffixes`, which is above this room.
IMAGE_SUFFIXES = (
    *(
        ".exr",
        ".hdr",
        ".pic",
        ".png",
        ".jpg",
        ".jpeg",
        ".jfif",
        ".jpe",
        ".insp",
        ".tif",
        ".tiff",
        ".webp",
        ".jxl",
    ),
    *(".heic", ".heif", ".hif"),
)
MESH_SUFFIXES = (".obj", ".ply", ".stl", ".gltf", ".glb", ".fbx", ".usd", ".usda", ".usdc", ".usdz")


def is_network(path: str) -> bool:
    """Whether a path names another computer or one of Windows' devices, ``\\\\server`` or ``\\\\.\\device``.

    Even looking for such a file reveals the user's name to another computer.
    """
    return path.replace("\\", "/").startswith("//")


def leads_outside(folder: Path, path: str) -> bool:
    """Whether a path, as it is written, leads out of a folder; links within the folder are the user's own."""
    if is_network(path) or "\0" in path:
        return True
    root = os.path.abspath(folder)
    full = os.path.normpath(os.path.join(root, path.replace("\\", "/")))
    return full != root and not full.startswith(root.rstrip(os.sep) + os.sep)


def foreign_fault(path: str) -> str:
    """Why an absolute path in a document of a run, as it is written, is not followed; "" where it may be."""
    if is_network(path):
        return "is on another computer or a device"
    if not path.lower().endswith((*IMAGE_SUFFIXES, *MESH_SUFFIXES)):
        return "is neither an image nor a mesh"
    return "is no file, but a device or a pipe" if is_special(path) else ""


def is_special(path: str | Path) -> bool:
    """Whether a path leads to something that exists and is neither a file nor a folder."""
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):  # missing files have errors of their own; ValueError: no path at all
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))
