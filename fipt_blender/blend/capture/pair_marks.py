"""Marks of the picked pairs in the 3D views: crosses on the mesh or, in a view, on its photograph.

In a view, a line leads from the picked place to where the mesh's point appears: the pair's error.
Imported while Blender starts: needs bpy alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import bpy

if TYPE_CHECKING:
    from mathutils import Vector

_PICKED = (1.0, 0.65, 0.0, 1.0)
_ACTIVE = (1.0, 1.0, 1.0, 1.0)
_OFF = (0.9, 0.1, 0.3, 1.0)

_handles: list[object] = []


def register() -> None:
    """Draw the marks in every 3D view; nothing in background."""
    if not bpy.app.background:
        _handles.append(bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL"))


def unregister() -> None:
    """Stop drawing."""
    while _handles:
        bpy.types.SpaceView3D.draw_handler_remove(_handles.pop(), "WINDOW")


def _draw() -> None:
    context = bpy.context
    settings = context.scene.fipt.alignment
    if not settings.show_marks or not settings.pairs or context.region_data is None:
        return
    from bpy_extras.view3d_utils import location_3d_to_region_2d
    from mathutils import Vector

    from .cameras import camera_geometry
    from .pairs import camera_view, mesh_point

    region, data, scene = context.region, context.region_data, context.scene
    view = camera_view(scene.camera) if data.view_perspective == "CAMERA" else ""
    geometry = camera_geometry(scene, scene.camera) if view else None
    for index, pair in enumerate(settings.pairs):
        if pair.name not in scene.objects:
            continue
        color = _ACTIVE if index == settings.active_pair else _PICKED
        place = location_3d_to_region_2d(region, data, Vector(mesh_point(scene, pair)))
        sight = next((sight for sight in pair.sights if sight.name == view), None)
        if geometry is None:
            if place is not None:
                _cross(place, color)
                _number(place, str(index + 1), color)
        elif sight is not None:
            origin, direction = geometry.ray(*sight.pixel)
            picked = location_3d_to_region_2d(region, data, Vector(origin + direction))
            if picked is None:
                continue
            if place is not None:
                _lines([picked, place], _OFF)
            _cross(picked, color)
            _number(picked, str(index + 1), color)


def _cross(place: Vector, color: tuple[float, ...]) -> None:
    from mathutils import Vector

    size = 7.0 * bpy.context.preferences.system.ui_scale  # half the length of a cross, in pixels
    ends = [(-1, -1), (1, 1), (-1, 1), (1, -1)]
    for grown, tint in ((1.0, (0.0, 0.0, 0.0, 1.0)), (0.0, color)):
        _lines([place + Vector(end) * (size + grown) for end in ends], tint, 3.0 if grown else 1.5)


def _lines(points: Sequence[Sequence[float]], color: tuple[float, ...], width: float = 1.5) -> None:
    import gpu
    from gpu_extras.batch import batch_for_shader

    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    batch = batch_for_shader(shader, "LINES", {"pos": [(point[0], point[1], 0.0) for point in points]})
    shader.bind()
    shader.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
    shader.uniform_float("lineWidth", width * bpy.context.preferences.system.ui_scale)
    shader.uniform_float("color", color)
    batch.draw(shader)


def _number(place: Sequence[float], text: str, color: tuple[float, ...]) -> None:
    import blf

    scale = bpy.context.preferences.system.ui_scale
    blf.size(0, 14.0 * scale)
    blf.color(0, *color)
    blf.enable(0, blf.SHADOW)
    blf.shadow(0, 3, 0.0, 0.0, 0.0, 1.0)
    blf.position(0, place[0] + 10.0 * scale, place[1] + 6.0 * scale, 0.0)
    blf.draw(0, text)
    blf.disable(0, blf.SHADOW)
