# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Conditions that several operators poll; each sets the message that explains a disabled button."""

from __future__ import annotations

import bpy


def in_object_mode(cls: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Blender is in Object Mode."""
    if context.mode != "OBJECT":
        cls.poll_message_set("Switch to Object Mode first")
        return False
    return True


def has_run(cls: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """The scene has a run folder; its contents are checked when the operator runs."""
    if not context.scene.fipt.run_folder:
        cls.poll_message_set("Import a capture and run Estimate first")
        return False
    return True


def has_views(cls: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """The scene has a capture."""
    if not context.scene.fipt.capture.views:
        cls.poll_message_set("Import a capture first")
        return False
    return True


def has_results(cls: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Results are applied to the scene."""
    if not context.scene.fipt.materials.object_count:
        cls.poll_message_set("Use Apply Results first")
        return False
    return True


def has_no_capture(cls: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """The scene has no capture yet: a room comes into a scene of its own."""
    if context.scene.fipt.capture.views:
        cls.poll_message_set("The scene has a capture already. Use a new scene")
        return False
    return True


def over_sidebar(context: bpy.types.Context) -> bool:
    """The pointer drops files on the 3D Viewport's sidebar; elsewhere there, Blender takes dropped images."""
    area, region = context.area, context.region
    return area is not None and area.type == "VIEW_3D" and region is not None and region.type == "UI"
