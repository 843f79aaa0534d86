# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that pick the two points of a known distance in merged photographs, in an Image Editor."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy

from ..core.run.errors import FiptError
from ..prepare.preparation import Group, PreparationFolder
from .action import REGISTER, action
from .pointer import NAVIGATION, WHEEL, WaitsForClicks, is_cancel, is_click
from .polls import all_of, needs
from .reporting import reports_errors

if TYPE_CHECKING:
    from ..properties.photographs import FIPT_PhotographsSettings

_TEXTS = ("Click: First point   Esc, Right Click: Cancel", "Click: Second point   Esc, Right Click: Cancel")


_has_groups = needs(
    lambda context: context.scene.fipt.photographs.groups, "Use Find Brackets and Make Capture first"
)


@action("Show Merged Image", needs=(_has_groups,), options=REGISTER)
def show_merged(context: bpy.types.Context) -> None:
    """Show the merged image of the active group in an Image Editor, to pick points in it."""
    settings = context.scene.fipt.photographs
    image = bpy.data.images.load(str(_merged(settings)), check_existing=True)
    area = _image_editor(context)
    if area is not None:
        area.spaces.active.image = image
        area.spaces.active.show_region_ui = True


class FIPT_OT_pick_scale_points(WaitsForClicks, bpy.types.Operator):
    """Click two points whose distance you know in the merged image that is shown"""

    bl_idname = "fipt.pick_scale_points"
    bl_label = "Pick Two Points"
    bl_options = {"REGISTER", "UNDO"}
    text_in_header = True

    view: bpy.props.StringProperty(name="View", description="Name of the group", options={"SKIP_SAVE"})
    points: bpy.props.FloatVectorProperty(
        name="Points",
        description="Both points in pixels from the top left corner of the image: x, y, x, y",
        size=4,
        options={"SKIP_SAVE"},
    )
    extend: bpy.props.BoolProperty(
        name="Extend",
        description="Add another view of the same points, which makes their distance more exact",
        options={"SKIP_SAVE"},
    )

    poll = all_of(_has_groups)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.capture.scale_picks import with_picks

        settings = context.scene.fipt.photographs
        if self.view not in settings.groups:
            raise FiptError("scale-view", f"There is no group '{self.view}'.", "Name one of the list.")
        first, second = tuple(self.points)[:2], tuple(self.points)[2:]
        if first == second:
            raise FiptError("scale-point", "The two picked points are the same.", "Pick two points.")
        before = settings.scale_picks if self.extend else ""
        settings.scale_picks = with_picks(before, self.view, first, second)
        settings.scale = "points"
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.properties.is_property_set("points"):
            return self.execute(context)
        from ..blend.capture.scale_picks import shown_group

        name = shown_group(context.space_data, context.scene.fipt.photographs)
        if not name:
            self.report({"ERROR"}, "Use Show Merged Image, and pick in the Image Editor.")
            return {"CANCELLED"}
        self.view = name
        self._clicks: list[tuple[float, float]] = []
        return self.wait_for_clicks(context, _TEXTS[0])

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if is_cancel(event):
            self.cancel(context)
            return {"CANCELLED"}
        if event.type in (*NAVIGATION, *WHEEL, "MOUSEMOVE"):
            return {"PASS_THROUGH"}
        if not is_click(event):
            return {"RUNNING_MODAL"}
        place = _pixel_under(context, event)
        if place is None:
            self.report({"WARNING"}, "Click inside the image")
            return {"RUNNING_MODAL"}
        self._clicks.append(place)
        if len(self._clicks) < 2:
            self.say(context, _TEXTS[1])
            return {"RUNNING_MODAL"}
        self.points = (*self._clicks[0], *self._clicks[1])
        self.cancel(context)
        return self.execute(context)


def _merged(settings: FIPT_PhotographsSettings) -> str:
    """The merged image of the active group.

    Raises:
        FiptError: ``image-missing``.
    """
    folder = settings.capture_folder()
    if folder is not None and 0 <= settings.active_group < len(settings.groups):
        path = PreparationFolder(folder).image(Group(settings.groups[settings.active_group].name, ()))
        if path.is_file():
            return str(path)
    raise FiptError("image-missing", "The active group is not merged yet.", "Use Make Capture first.")


def _image_editor(context: bpy.types.Context) -> bpy.types.Area | None:
    """An Image Editor of an open window, or a new window with one; None in background."""
    windows = context.window_manager.windows
    for window in windows:
        for area in window.screen.areas:
            if area.ui_type == "IMAGE_EDITOR":
                return area
    if bpy.app.background:
        return None
    bpy.ops.wm.window_new()
    area = windows[-1].screen.areas[0]
    area.ui_type = "IMAGE_EDITOR"
    return area


def _pixel_under(context: bpy.types.Context, event: bpy.types.Event) -> tuple[float, float] | None:
    """Pixels from the top left corner of the shown image under the pointer, None outside of it."""
    area, image = context.area, context.space_data.image
    region = next(item for item in area.regions if item.type == "WINDOW")
    u, v = region.view2d.region_to_view(event.mouse_x - region.x, event.mouse_y - region.y)
    if not (0.0 <= u <= 1.0 and 0.0 <= v <= 1.0):
        return None
    return u * image.size[0], (1.0 - v) * image.size[1]
