# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Comparison of a view's photograph with its render or with the viewport, and the divider to drag."""

from __future__ import annotations

import bpy

from ..blend.marks import VIEW
from ..properties.check import COMPARISONS
from .polls import all_of, needs
from .reporting import reports_errors

_GRIP = 8.0  # pixels on both sides of the divider
_LINE, _DRAGGED = (1.0, 1.0, 1.0, 0.8), (1.0, 0.65, 0.0, 1.0)


class FIPT_OT_compare(bpy.types.Operator):
    """Wipe the photograph of the current view beside its render or the viewport"""

    bl_idname = "fipt.compare"
    bl_label = "Compare with Photograph"
    bl_options = {"REGISTER"}

    mode: bpy.props.EnumProperty(
        name="Compare",
        description="What the photograph is compared with",
        items=COMPARISONS,
        default="VIEWPORT",
    )
    toggle: bpy.props.BoolProperty(
        name="Toggle", description="End a comparison that is shown", options={"SKIP_SAVE"}
    )
    window: bpy.props.BoolProperty(
        name="Image Editor",
        description="Show the comparison in an Image Editor as well; opens a new window if there is none",
        options={"SKIP_SAVE"},
    )

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        return next(text for name, _, text, *_ in COMPARISONS if name == properties.mode)

    poll = all_of(
        needs(
            lambda context: context.scene.camera is not None and VIEW in context.scene.camera,
            "Click a view in the section Capture first",
        )
    )

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.capture import compare
        from ..blend.capture.look import enter_camera

        scene = context.scene
        settings = scene.fipt.check
        mode = "OFF" if self.toggle and settings.compare != "OFF" else self.mode
        if mode == "OFF":
            compare.end(scene)
        else:
            image = compare.start(scene, mode)
            enter_camera(context, scene)
            if self.window and not bpy.app.background:
                from ..blend.pictures.check_pictures import open_editor

                open_editor(context, image)
            elif mode == "RENDER":
                from ..blend.pictures.check_pictures import show_in_editors

                show_in_editors(context, image)
        return {"FINISHED"}


class FIPT_GT_divider(bpy.types.Gizmo):
    """The divider of a comparison, over the camera's frame or over the picture"""

    bl_idname = "FIPT_GT_divider"
    __slots__ = ("before",)

    def draw(self, context: bpy.types.Context) -> None:
        frame = frame_of(context)
        if frame is None:
            return
        import gpu
        from gpu_extras.batch import batch_for_shader

        left, bottom, right, top = frame
        x = left + context.scene.fipt.check.divider * (right - left)
        middle, arm = 0.5 * (bottom + top), _GRIP * context.preferences.system.ui_scale
        points = [(x, bottom), (x, top)]
        for side in (-1.0, 1.0):  # two arrows
            tip = (x + 1.6 * side * arm, middle)
            points += [(x + 0.7 * side * arm, middle - arm), tip, tip, (x + 0.7 * side * arm, middle + arm)]
        shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
        batch = batch_for_shader(shader, "LINES", {"pos": [(*point, 0.0) for point in points]})
        gpu.state.blend_set("ALPHA")
        shader.bind()
        shader.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
        shader.uniform_float("lineWidth", 2.0 * context.preferences.system.ui_scale)
        shader.uniform_float("color", _DRAGGED if self.is_highlight or self.is_modal else _LINE)
        batch.draw(shader)
        gpu.state.blend_set("NONE")

    def test_select(self, context: bpy.types.Context, location: tuple[float, float]) -> int:
        frame = frame_of(context)
        if frame is None:
            return -1
        left, bottom, right, top = frame
        x = left + context.scene.fipt.check.divider * (right - left)
        near = abs(location[0] - x) < _GRIP * context.preferences.system.ui_scale
        return 0 if near and bottom <= location[1] <= top else -1

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.before = context.scene.fipt.check.divider
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event, tweak: set[str]) -> set[str]:
        frame = frame_of(context)
        if frame is not None and event.type == "MOUSEMOVE":
            left, _, right, _ = frame
            share = (event.mouse_region_x - left) / max(right - left, 1.0)
            context.scene.fipt.check.divider = min(max(share, 0.0), 1.0)
        return {"RUNNING_MODAL"}

    def exit(self, context: bpy.types.Context, cancel: bool) -> None:
        if cancel:
            context.scene.fipt.check.divider = self.before


def frame_of(context: bpy.types.Context) -> tuple[float, float, float, float] | None:
    """Left, bottom, right and top of the compared picture in the region, in pixels; None where it is not."""
    from ..blend.capture import compare

    camera = compare.compared_camera(context.scene)
    region, space = context.region, context.space_data
    if not camera or region is None:
        return None
    if space.type == "IMAGE_EDITOR":
        if space.image is None or space.image.name != compare.NAME:
            return None
        corners = [region.view2d.view_to_region(*corner, clip=False) for corner in ((0.0, 0.0), (1.0, 1.0))]
    else:
        data, item = context.region_data, context.scene.camera
        if data is None or data.view_perspective != "CAMERA" or item is None or item.name != camera:
            return None
        from bpy_extras.view3d_utils import location_3d_to_region_2d

        ends = item.data.view_frame(scene=context.scene)
        found = [location_3d_to_region_2d(region, data, item.matrix_world @ end) for end in ends]
        if any(corner is None for corner in found):
            return None
        corners = [tuple(corner) for corner in found]
    across, up = zip(*corners, strict=True)
    return min(across), min(up), max(across), max(up)


class _Divider:
    """Mix-in of a group with the divider's gizmo."""

    bl_region_type = "WINDOW"
    bl_options = {"PERSISTENT", "SHOW_MODAL_ALL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.scene.fipt.check.compare != "OFF" and frame_of(context) is not None

    def setup(self, context: bpy.types.Context) -> None:
        """Make the gizmo."""
        gizmo = self.gizmos.new(FIPT_GT_divider.bl_idname)  # type: ignore[attr-defined]
        gizmo.use_draw_modal = True


class FIPT_GGT_divider_view(_Divider, bpy.types.GizmoGroup):
    """The divider of a comparison in 3D viewports"""

    bl_label = "Divider in Viewport"
    bl_space_type = "VIEW_3D"


class FIPT_GGT_divider_image(_Divider, bpy.types.GizmoGroup):
    """The divider of a comparison in Image Editors"""

    bl_label = "Divider in Image Editor"
    bl_space_type = "IMAGE_EDITOR"
