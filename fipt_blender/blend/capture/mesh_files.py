# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks mesh files before Blender's importers read them, by what the engine reads them with.

Blender's PLY importer crashes at damaged headers, counts and indices, and the artist's unsaved work is lost.
"""

from __future__ import annotations

from pathlib import Path

from ...core.alignment.gltf_document import read_document, scene_roots
from ...core.alignment.obj_file import read_obj
from ...core.alignment.ply_file import read_ply
from ...core.run.errors import FiptError
from .mesh_names import check_named_files


def check_mesh_file(path: Path) -> None:
    """Check a mesh file whose importer does not survive damage, or opens whatever files it names.

    Raises:
        FiptError: ``mesh-unreadable``.
    """
    checks = {".ply": read_ply, ".obj": read_obj, ".glb": _check_scene, ".gltf": _check_scene}
    check = checks.get(path.suffix.lower())
    try:
        check_named_files(path)
        if check is not None:
            check(path)
    except (OSError, ValueError) as error:
        raise FiptError(
            "mesh-unreadable",
            f"The mesh {path} can't be used: {error}.",
            "Copy or export the file again, or choose another mesh.",
        ) from None


def _check_scene(path: Path) -> None:
    scene_roots(read_document(path)[0])
