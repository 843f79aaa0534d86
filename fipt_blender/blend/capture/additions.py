# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces that a scan lacks, as objects of the room before an estimation: found by the engine, which the
artist may keep, edit or delete, or simple solids that the artist draws.
"""

from __future__ import annotations

from dataclasses import dataclass

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...core.run.documents import read_json
from ...core.run.errors import FiptError
from ...core.run.runfolder import RunFolder
from ...core.run.shapes import MATRICES
from ..marks import ADDED, DRAWN, all_view_cameras, was_found
from ..outliner import remove_object
from ..room.arrays import Room, read_room
from ..room.mesh_arrays import world_bounds
from ..room.panes import add_apart, link_beside
from .survey import Survey, survey_of

# Where photographs disagree is looked for in cells of this share of the room's diagonal; what is drawn there
# has at least this share of it, and where nothing is known.
CELL_SHARE, LEAST_SHARE, USUAL_SHARE = 0.08, 0.03, 0.08
# Disagreement below which a surface does not count.
DISAGREES = 0.25
SEGMENTS = 32  # of a cylinder
GAP_SHARE = 0.002  # by which a panel stands off the surface behind it, as a share of the diagonal


@dataclass(frozen=True)
class Place:
    """Where a missing thing may stand.

    Attributes:
        base: (3,) middle of its lower side, world.
        size: (3,) its extents, metres.
        facing: (3,) unit vector from the surface behind it to the cameras.
    """

    base: np.ndarray
    size: np.ndarray
    facing: np.ndarray


def added_surfaces(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The surfaces that were added to the scene's room."""
    return [item for item in scene.fipt.capture.room_objects(scene) if ADDED in item]


def take_found(scene: bpy.types.Scene, run: RunFolder) -> list[str]:
    """Make objects of what the engine has added to the room in RUN/survey, instead of those of an earlier search.

    From then on the scene's room counts as complete.

    Returns:
        Names of the new objects.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    survey = RunFolder(run.survey)
    room = read_room(survey)
    exported = read_json(survey.root / "matrices.json", MATRICES, "Look for missing surfaces again.")
    settings = scene.fipt.capture
    for item in settings.room_objects(scene):
        if was_found(item):
            remove_object(item)
    beside = settings.room_objects(scene)[0]
    added = [index for index, name in enumerate(room.objects) if name not in exported]
    objects = [item for index in added for item in add_apart(room, index, beside)]
    settings.completed = True
    return [item.name for item in objects]


def draw_surface(scene: bpy.types.Scene, shape: str, place: Place) -> bpy.types.Object:
    """Add a simple solid to the scene's room, as the artist's exact surface.

    Args:
        shape: "BOX", "CYLINDER" or "PANEL".
        place: where it stands; a panel faces the cameras.

    Raises:
        FiptError: ``room-missing``.
    """
    room = scene.fipt.capture.room_objects(scene)
    if not room:
        raise FiptError(
            "room-missing", "The room has no meshes.", "Import or choose a mesh of the room first."
        )
    mesh = bpy.data.meshes.new(f"FIPT {shape.title()}")
    solid = bmesh.new()
    upright = Matrix.Translation((0.0, 0.0, 0.5))
    if shape == "BOX":
        bmesh.ops.create_cube(solid, size=1.0, matrix=upright)
    elif shape == "CYLINDER":
        bmesh.ops.create_cone(
            solid, cap_ends=True, segments=SEGMENTS, radius1=0.5, radius2=0.5, depth=1.0, matrix=upright
        )
        for face in solid.faces:
            face.smooth = len(face.verts) == 4
            for edge in () if face.smooth else face.edges:
                edge.smooth = False
    else:
        bmesh.ops.create_grid(solid, x_segments=1, y_segments=1, size=0.5)
    solid.to_mesh(mesh)
    solid.free()
    item = bpy.data.objects.new(mesh.name, mesh)
    item[ADDED] = DRAWN
    link_beside(item, room[0])
    item.matrix_world = _matrix(shape, place, _diagonal(room))
    return item


def _matrix(shape: str, place: Place, diagonal: float) -> Matrix:
    size = Vector(place.size)
    if shape != "PANEL":
        return Matrix.LocRotScale(Vector(place.base), None, size)
    normal = Vector(place.facing)
    rotation = normal.to_track_quat("Z", "Y")
    extent = sorted(abs(value) for value in rotation.inverted() @ size)
    middle = Vector(place.base) + Vector((0.0, 0.0, 0.5 * size.z))
    behind = middle - normal * (0.5 * abs(normal.dot(size)) - GAP_SHARE * diagonal)
    return Matrix.LocRotScale(behind, rotation, Vector((extent[-1], extent[-2], 1.0)))


def place_at(scene: bpy.types.Scene, location: Vector) -> Place:
    """A place with the usual size."""
    size = np.full(3, USUAL_SHARE * _diagonal(scene.fipt.capture.room_objects(scene)))
    return Place(np.array(location), size, np.array([0.0, 0.0, 1.0]))


def place_of_disagreement(scene: bpy.types.Scene) -> Place | None:
    """The place where photographs disagree most, on the side of the cameras; None without such a place.

    Where the artist has drawn a surface already does not count.

    Raises:
        FiptError: ``survey-missing``.
    """
    run, survey = survey_of(scene)
    room = read_room(RunFolder(run.survey))
    drawn = [item for item in added_surfaces(scene) if item[ADDED] == DRAWN]
    cameras = [item.matrix_world.translation for item in all_view_cameras(scene)]
    middle = np.mean([list(place) for place in cameras], axis=0) if cameras else np.zeros(3)
    boxes = [bounds for item in drawn if (bounds := world_bounds([item])) is not None]
    objects = scene.fipt.capture.room_objects(scene)
    return strongest_place(room, survey, middle, boxes, _diagonal(objects))


def strongest_place(
    room: Room,
    survey: Survey,
    cameras: np.ndarray,
    boxes: list[tuple[np.ndarray, np.ndarray]],
    diagonal: float,
) -> Place | None:
    """The place where photographs disagree on most of the surface.

    Args:
        cameras: (3,) mean place of the cameras. boxes: lowest and highest corners of what does not count.
        diagonal: of the room, metres.
    """
    corners = room.vertices.astype(np.float64)[room.triangles]
    middle = corners.mean(axis=1)
    doubt = np.nan_to_num(survey.disagreement)
    weight = np.where(doubt >= DISAGREES, doubt * survey.areas, 0.0)
    cell = CELL_SHARE * diagonal
    for low, high in boxes:
        weight[((middle > low - cell) & (middle < high + cell)).all(axis=1)] = 0.0
    if not weight.any():
        return None
    numbers = np.unique(np.floor(middle / cell).astype(np.int64), axis=0, return_inverse=True)[1].ravel()
    strongest = int(np.bincount(numbers, weight).argmax())
    centre = np.average(middle[numbers == strongest], axis=0, weights=weight[numbers == strongest])
    near = np.flatnonzero((np.linalg.norm(middle - centre, axis=1) < 2.0 * cell) & (weight > 0.0))
    centre = np.average(middle[near], axis=0, weights=weight[near])
    spread = np.sqrt(np.average((middle[near] - centre) ** 2, axis=0, weights=weight[near]))
    # The extents of a surface that is evenly covered.
    size = np.maximum(np.sqrt(12.0) * spread, LEAST_SHARE * diagonal)
    cross = np.cross(corners[near, 1] - corners[near, 0], corners[near, 2] - corners[near, 0])
    toward = np.sign(np.einsum("nc,nc->n", cross, cameras - middle[near]))
    facing = (cross * (toward * doubt[near])[:, None]).sum(axis=0)
    length = float(np.linalg.norm(facing))
    facing = facing / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    if abs(facing[2]) > np.sqrt(0.5):  # it stands on what is behind it, or hangs below
        base = centre if facing[2] > 0.0 else centre - [0.0, 0.0, size[2]]
    else:
        base = centre + facing * [0.5, 0.5, 0.0] * size - [0.0, 0.0, 0.5 * size[2]]
    return Place(base, size, facing)


def _diagonal(objects: list[bpy.types.Object]) -> float:
    bounds = world_bounds(objects)
    return 1.0 if bounds is None else float(np.linalg.norm(bounds[1] - bounds[0]))
