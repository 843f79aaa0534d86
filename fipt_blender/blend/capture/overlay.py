"""Colours over the room in the 3D views, one per triangle: coverage, parts.

They are drawn after Blender's own drawing, and no mesh, material or shading of the artist's is changed. An
overlay belongs to a scene by name; opening another file or disabling the add-on removes it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...core.run.run_files import RoomMesh
from ..room.mesh_arrays import transform_points
from .look import redraw_views

if TYPE_CHECKING:
    import gpu

_TOWARD = (
    1e-3  # offset towards the eye, as a share of the distance, so that the room does not hide the colours
)
_LIGHT = np.array([0.32, 0.24, 0.92])  # direction of the light that shades the colours


@dataclass
class Part:
    """The triangles of one object in its own space."""

    name: str  # name of the object
    positions: np.ndarray  # (3 T, 3) f32
    colors: np.ndarray  # (3 T, 4) f32 rgba
    # The GPU batch, made when it is first drawn
    batch: gpu.types.GPUBatch | None = field(default=None, repr=False)


@dataclass(frozen=True)
class _Shown:
    scene_name: str
    run_folder: str
    kind: str
    parts: list[Part]
    handle: object  # of the draw handler


_shown: _Shown | None = None


def show(scene: bpy.types.Scene, kind: str, parts: list[Part]) -> None:
    """Draw coloured triangles over the room in every 3D view of the scene, instead of an earlier overlay.

    Args:
        scene: the overlay's scene.
        kind: "coverage" or "parts".
        parts: result of `object_parts`.
    """
    global _shown
    hide()
    handle = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")
    _shown = _Shown(scene.name, scene.fipt.run_folder, kind, parts, handle)
    redraw_views()


def hide() -> None:
    """Remove the overlay, if there is one."""
    global _shown
    if _shown is None:
        return
    bpy.types.SpaceView3D.draw_handler_remove(_shown.handle, "WINDOW")
    _shown = None
    redraw_views()


def shown(scene: bpy.types.Scene) -> str:
    """What is drawn over the scene's room: "coverage", "parts" or ""."""
    if _shown is None or (_shown.scene_name, _shown.run_folder) != (scene.name, scene.fipt.run_folder):
        return ""
    return _shown.kind


def object_parts(
    room: RoomMesh, colors: np.ndarray, matrices: Mapping[str, Sequence[Sequence[float]]]
) -> list[Part]:
    """A room's coloured triangles by object, so that they follow the objects when these are moved.

    Args:
        room: the room, in world space.
        colors: (T, 3) rgb of its triangles.
        matrices: 4x4 world matrix of each object, by name, when the room was exported.
    """
    corners = room.vertices.astype(np.float64)[room.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    shade = 0.6 + 0.4 * np.abs(normal @ _LIGHT)
    tinted = np.ones((len(colors), 4), np.float32)
    tinted[:, :3] = colors * shade[:, None]
    parts = []
    for index, name in enumerate(room.objects):
        of_object = room.triangle_object == index
        inverse = np.linalg.pinv(np.array(matrices.get(name, np.eye(4)), np.float64))
        points = transform_points(corners[of_object].reshape(-1, 3), inverse)
        parts.append(Part(name, points.astype(np.float32), np.repeat(tinted[of_object], 3, axis=0)))
    return parts


def _draw() -> None:
    import gpu
    from gpu_extras.batch import batch_for_shader

    context = bpy.context
    if _shown is None or not shown(context.scene) or context.region_data is None:
        return
    shader = gpu.shader.from_builtin("FLAT_COLOR")
    toward = _toward_eye(context.region_data)
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.depth_mask_set(True)
    gpu.state.face_culling_set("BACK" if context.space_data.shading.show_backface_culling else "NONE")
    try:
        for part in _shown.parts:
            item = context.scene.objects.get(part.name)
            if item is None or not len(part.positions) or not item.visible_get():
                continue
            if part.batch is None:
                content = {"pos": part.positions, "color": part.colors}
                part.batch = batch_for_shader(shader, "TRIS", content)
            with gpu.matrix.push_pop():
                gpu.matrix.multiply_matrix(toward @ item.matrix_world)
                part.batch.draw(shader)
    finally:
        gpu.state.depth_test_set("NONE")
        gpu.state.depth_mask_set(False)
        gpu.state.face_culling_set("NONE")


def _toward_eye(region: bpy.types.RegionView3D) -> Matrix:
    """World to world: a little nearer to the eye, at the same place on the screen."""
    view = region.view_matrix
    if region.is_perspective:
        nearer = Matrix.Diagonal(Vector((1.0 - _TOWARD,) * 3)).to_4x4()
    else:
        nearer = Matrix.Translation((0.0, 0.0, _TOWARD * region.view_distance))
    return view.inverted() @ nearer @ view
