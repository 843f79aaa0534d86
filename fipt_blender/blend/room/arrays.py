# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The arrays of room.npz and the names of room.json: one triangle soup in world space with ids.

docs/run_folder.md describes the arrays.
"""

from __future__ import annotations

import filecmp
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...core.run.contents import RoomNames
from ...core.run.errors import FiptError
from ...core.run.kinds import Matrix
from ...core.run.run_files import ROOM_ARRAYS, read_room_files
from ...core.run.runfolder import RunFolder, atomic_path, write_json


@dataclass
class Room:
    """The triangles of all objects of the room, in world space.

    Attributes:
        vertices: (V,3) f32, metres.
        triangles: (T,3) i32 vertex indices, wound counter-clockwise seen from outside.
        corner_normals: (T,3,3) f32 unit shading normals.
        triangle_object: (T,) i32 index into `objects`.
        triangle_material: (T,) i32 index into `materials`, -1 without a material.
        triangle_polygon: (T,) i32 index of the polygon in its object's evaluated mesh.
        objects, materials: names.
        object_ids: by which the objects are found when they have other names.
        matrices: 4x4 of each object to the world when it was exported; not of those of the engine.
        triangle_exact: (T,) bool, those that are no scan, whatever the others are; None without any.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    corner_normals: np.ndarray
    triangle_object: np.ndarray
    triangle_material: np.ndarray
    triangle_polygon: np.ndarray
    objects: Sequence[str]
    materials: Sequence[str]
    object_ids: Sequence[str] = ()
    matrices: Sequence[Matrix] = ()
    triangle_exact: np.ndarray | None = None

    @property
    def mesh(self) -> dict[str, np.ndarray]:
        """What the cleaned copy of a scan is made of, for `run_files.mesh_digest`."""
        exact = {} if self.triangle_exact is None else {"triangle_exact": self.triangle_exact}
        return {"vertices": self.vertices, "triangles": self.triangles, **exact}


def write_room(room: Room, run: RunFolder, parts: str, completed: bool = False) -> None:
    """Write room.npz and room.json; results of another room are deleted.

    Args:
        room: with at least one triangle.
        run: the run folder.
        parts: source of the part labels, of `core.capture.options.PART_SOURCES`.
        completed: the engine adds nothing to a scan.

    Raises:
        FiptError: ``mesh-empty`` for a room without triangles; the run folder's write errors.
    """
    if not len(room.triangles):
        raise FiptError("mesh-empty.write-room")
    with atomic_path(run.room_npz) as temporary:
        np.savez(temporary, **{name: getattr(room, name) for name in ROOM_ARRAYS} | room.mesh)
        if run.room_npz.is_file() and not filecmp.cmp(temporary, run.room_npz, shallow=False):
            run.drop_results()
    names = {key: getattr(room, key) for key in ("objects", "materials", "object_ids", "matrices")}
    write_json(run.room_json, RoomNames(**names, parts=parts, completed=completed))


def read_room(run: RunFolder) -> Room:
    """Read what `write_room` wrote.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    arrays, names = read_room_files(run)
    return Room(
        **{name: arrays[name] for name in ROOM_ARRAYS},
        objects=names.objects,
        materials=names.materials,
        object_ids=names.ids,
        matrices=names.matrices,
        triangle_exact=arrays.get("triangle_exact"),
    )
