# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Looking through a view's camera with its photograph before the room, in any 3D view that is open."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy

from ..core.job.errors import FiptError
from .backdrop import show_photograph
from .cameras import use_view

if TYPE_CHECKING:
    from ..properties.capture import FIPT_CaptureView


def look_through(
    scene: bpy.types.Scene, view: FIPT_CaptureView, context: bpy.types.Context
) -> bpy.types.Object | None:
    """Make the view's camera the scene's and turn the 3D view to it; None where the camera was deleted."""
    camera = view.camera_object()
    if camera is None:
        return None
    use_view(scene, camera)
    show_photograph(scene, camera)
    for space in view_spaces(context, scene):
        space.region_3d.view_perspective = "CAMERA"
    return camera


def camera_missing(view: FIPT_CaptureView) -> FiptError:
    """The error for a view whose camera was deleted."""
    return FiptError(
        "camera-missing",
        f"The camera of the view '{view.name}' was deleted.",
        "Undo that, or import the capture again: what is there already is kept.",
    )


def view_spaces(context: bpy.types.Context, scene: bpy.types.Scene) -> list[bpy.types.SpaceView3D]:
    """The 3D view in which the artist works, else the first of each window that shows the scene."""
    area = getattr(context, "area", None)
    if area is not None and area.type == "VIEW_3D":
        return [area.spaces.active]
    spaces = []
    for window in context.window_manager.windows:
        if window.scene == scene:
            areas = [each for each in window.screen.areas if each.type == "VIEW_3D"]
            spaces += [each.spaces.active for each in areas[:1]]
    return spaces


def refresh_photograph(scene: bpy.types.Scene) -> None:
    """Show the photograph as strongly as the panel says, if the scene looks through a view's camera."""
    camera = scene.camera
    if camera is not None and any(view.camera == camera.name for view in scene.fipt.capture.views):
        show_photograph(scene, camera)
