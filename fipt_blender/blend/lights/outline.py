# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The list of lights and the 3D viewport: the active row's light is outlined, and a light that is selected in
the viewport becomes the active row. Imported while Blender starts: needs bpy alone.

Blender's lists do not report over which row the pointer is, therefore the active row is shown.
"""

from __future__ import annotations

import math

import bpy

from ..marks import FIXTURE_LIGHT

_COLOR, _SHADE = (0.2, 0.9, 1.0, 1.0), (0.0, 0.0, 0.0, 0.6)
_CIRCLE = 32
_TAB = "FIPT"

_handles: list[object] = []
_owner = object()  # of the subscription
# Lines of a fixture's mesh in its own space, by the mesh's name and size.
_lines: dict[tuple[str, int, int], list[tuple[float, float, float]]] = {}


def register() -> None:
    """Draw the outline in 3D views and watch the active object; nothing in background."""
    if bpy.app.background:
        return
    _handles.append(bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW"))
    _subscribe()
    bpy.app.handlers.load_post.append(_after_loading)


def unregister() -> None:
    """Stop drawing and watching."""
    if not _handles:
        return
    bpy.types.SpaceView3D.draw_handler_remove(_handles.pop(), "WINDOW")
    bpy.msgbus.clear_by_owner(_owner)
    bpy.app.handlers.load_post.remove(_after_loading)
    _lines.clear()


def _subscribe() -> None:
    bpy.msgbus.subscribe_rna(
        key=(bpy.types.LayerObjects, "active"), owner=_owner, args=(), notify=follow_selection
    )


@bpy.app.handlers.persistent
def _after_loading(*_: object) -> None:
    _lines.clear()
    bpy.msgbus.clear_by_owner(_owner)
    _subscribe()


def follow_selection() -> None:
    """Make the row of the active object, or of the fixture that it stands for, the active one."""
    context = bpy.context
    item = context.view_layer.objects.active if context.view_layer else None
    if item is not None and FIXTURE_LIGHT in item:
        item = item.parent
    settings = context.scene.fipt.lights
    for index, row in enumerate(settings.lights):
        if item is not None and row.object == item and index != settings.active:
            from ..capture.look import redraw_views

            settings.active = index
            redraw_views()


def _draw() -> None:
    context = bpy.context
    settings = context.scene.fipt.lights
    if not settings.show_outline or not settings.lights or not _is_wanted(context):
        return
    row = settings.active_light()
    if row is None or not row.object.visible_get():
        return
    import gpu
    from gpu_extras.batch import batch_for_shader

    points = outline(row.object)
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    batch = batch_for_shader(shader, "LINES", {"pos": points})
    scale = context.preferences.system.ui_scale
    gpu.state.blend_set("ALPHA")
    try:
        with gpu.matrix.push_pop():
            gpu.matrix.multiply_matrix(row.object.matrix_world)
            for color, width in ((_SHADE, 4.0), (_COLOR, 2.0)):
                shader.bind()
                shader.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
                shader.uniform_float("lineWidth", width * scale)
                shader.uniform_float("color", color)
                batch.draw(shader)
    finally:
        gpu.state.blend_set("NONE")


def _is_wanted(context: bpy.types.Context) -> bool:
    """Whether overlays are on and the sidebar shows our tab."""
    if context.area is None or not context.space_data.overlay.show_overlays:
        return False
    sidebar = next((region for region in context.area.regions if region.type == "UI"), None)
    if sidebar is None or sidebar.width <= 1:
        return False
    return getattr(sidebar, "active_panel_category", _TAB) == _TAB


def outline(item: bpy.types.Object) -> list[tuple[float, float, float]]:
    """The ends of lines around a light in its own space: a mesh's border, or all edges of a closed one."""
    if item.type != "MESH":
        return _light_outline(item.data)
    mesh = item.data
    key = (mesh.name, len(mesh.vertices), len(mesh.edges))
    if key not in _lines:
        if len(mesh.edges) > 4000:  # of a fixture's mesh; the box of a larger one is drawn
            _lines[key] = _box([tuple(corner) for corner in item.bound_box])
        else:
            _lines[key] = _mesh_lines(mesh)
    return _lines[key]


def _mesh_lines(mesh: bpy.types.Mesh) -> list[tuple[float, float, float]]:
    uses: dict[tuple[int, int], int] = {}
    for polygon in mesh.polygons:
        for edge in polygon.edge_keys:
            uses[edge] = uses.get(edge, 0) + 1
    border = [edge for edge, count in uses.items() if count == 1]
    places = [tuple(vertex.co) for vertex in mesh.vertices]
    return [places[index] for edge in border or uses for index in edge]


def _light_outline(light: bpy.types.Light) -> list[tuple[float, float, float]]:
    """The shape of an area light, or a circle of the light's size in all three planes."""
    if light.type == "AREA":
        width = light.size
        height = light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else light.size
        if light.shape in ("SQUARE", "RECTANGLE"):
            x, y = 0.5 * width, 0.5 * height
            corners = [(-x, -y, 0.0), (x, -y, 0.0), (x, y, 0.0), (-x, y, 0.0)]
            return [corners[index % 4] for start in range(4) for index in (start, start + 1)]
        return _circle(0.5 * width, 0.5 * height, 2)
    radius = max(getattr(light, "shadow_soft_size", 0.1), 0.05)
    return [end for axis in range(3) for end in _circle(radius, radius, axis)]


def _circle(width: float, height: float, axis: int) -> list[tuple[float, float, float]]:
    """The ends of lines along an ellipse across an axis."""
    points = []
    for step in range(_CIRCLE):
        angle = 2.0 * math.pi * step / _CIRCLE
        point = [width * math.cos(angle), height * math.sin(angle)]
        point.insert(axis, 0.0)
        points.append((point[0], point[1], point[2]))
    return [points[index % _CIRCLE] for start in range(_CIRCLE) for index in (start, start + 1)]


def _box(corners: list[tuple[float, float, float]]) -> list[tuple[float, float, float]]:
    """The ends of a box's edges, from its corners in Blender's order."""
    edges = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))
    return [corners[index] for edge in edges for index in edge]
