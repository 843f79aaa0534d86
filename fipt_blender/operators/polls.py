# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Conditions of several operators; each says why not."""

from __future__ import annotations

import bpy


def in_object_mode(cls: type, context: bpy.types.Context) -> bool:
    """Nothing is in edit mode, or in any other that Blender's operators on objects refuse."""
    if context.mode != "OBJECT":
        cls.poll_message_set("Leave edit mode first")  # type: ignore[attr-defined]
        return False
    return True


def has_run(cls: type, context: bpy.types.Context) -> bool:
    """The scene has a run folder; what is there is looked at when the operator runs."""
    if not context.scene.fipt.run_folder:
        cls.poll_message_set("Import a capture and estimate first")  # type: ignore[attr-defined]
        return False
    return True


def has_views(cls: type, context: bpy.types.Context) -> bool:
    """The scene has a capture."""
    if not context.scene.fipt.capture.views:
        cls.poll_message_set("Import a capture first")  # type: ignore[attr-defined]
        return False
    return True


def has_results(cls: type, context: bpy.types.Context) -> bool:
    """Results are applied to the scene."""
    if not context.scene.fipt.materials.object_count:
        cls.poll_message_set("Apply results first")  # type: ignore[attr-defined]
        return False
    return True
