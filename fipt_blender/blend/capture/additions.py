"""Surfaces that a scan lacks, as objects of the room before an estimation: found by the engine, which the
artist may keep, edit or delete, or simple solids that the artist draws.
"""

from __future__ import annotations

from dataclasses import dataclass

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...core.run.contents import Matrices, SurveyNote
from ...core.run.documents import read_document
from ...core.run.run_files import read_room
from ...core.run.runfolder import RunFolder
from ..marks import ADDED, DRAWN, all_view_cameras, was_found
from ..outliner import remove_object
from ..room.mesh_arrays import world_bounds
from ..room.panes import add_apart, link_beside
from .importing import room_missing

# Extent of what is drawn where nothing is known, as a share of the room's diagonal.
USUAL_SHARE = 0.08
SEGMENTS = 32  # of a cylinder


@dataclass(frozen=True)
class Place:
    """Where a missing thing may stand."""

    base: np.ndarray  # (3,) middle of its lower side, world
    size: np.ndarray  # (3,) its extents, metres
    facing: np.ndarray  # (3,) unit vector along its least extent, to the cameras


def added_surfaces(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The surfaces that were added to the scene's room."""
    return [item for item in scene.fipt.capture.room_objects(scene) if ADDED in item]


def take_found(scene: bpy.types.Scene, run: RunFolder) -> list[str]:
    """Make objects of what the engine has added to the room in RUN/survey, instead of those found before.

    From then on the scene's room counts as complete.

    Returns:
        Names of the new objects.
    """
    survey = RunFolder(run.survey)
    room = read_room(survey)
    exported = read_document(survey.root / "matrices.json", Matrices, "Look for missing surfaces again.")
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
    """
    room = scene.fipt.capture.room_objects(scene)
    if not room:
        raise room_missing()
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
    item.matrix_world = _matrix(shape, place)
    return item


def _matrix(shape: str, place: Place) -> Matrix:
    size = Vector(place.size)
    if shape != "PANEL":
        return Matrix.LocRotScale(Vector(place.base), None, size)
    rotation = Vector(place.facing).to_track_quat("Z", "Y")
    across = rotation.to_matrix().transposed() @ size
    middle = Vector(place.base) + Vector((0.0, 0.0, 0.5 * size.z))
    return Matrix.LocRotScale(middle, rotation, Vector((abs(across.x), abs(across.y), 1.0)))


def place_at(scene: bpy.types.Scene, location: Vector) -> Place:
    """A place with the usual size."""
    size = np.full(3, USUAL_SHARE * _diagonal(scene.fipt.capture.room_objects(scene)))
    return Place(np.array(location), size, np.array([0.0, 0.0, 1.0]))


def place_of_disagreement(scene: bpy.types.Scene) -> Place | None:
    """Where the photographs show most that the room lacks and the artist has not drawn; None without any."""
    run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
    boxes = read_document(run.survey_json, SurveyNote, "Check the views again.").missing
    drawn = [world_bounds([item]) for item in added_surfaces(scene) if item[ADDED] == DRAWN]
    cameras = np.mean([list(item.matrix_world.translation) for item in all_view_cameras(scene)], axis=0)
    for box in boxes:
        low, high = np.array(box.low), np.array(box.high)
        middle, size = 0.5 * (low + high), high - low
        if any(each is not None and (each[0] < middle).all() and (middle < each[1]).all() for each in drawn):
            continue
        facing = np.where(np.arange(3) == size.argmin(), np.sign(cameras - middle), 0.0)
        return Place(middle - [0.0, 0.0, 0.5 * size[2]], size, facing)
    return None


def _diagonal(objects: list[bpy.types.Object]) -> float:
    bounds = world_bounds(objects)
    return 1.0 if bounds is None else float(np.linalg.norm(bounds[1] - bounds[0]))
