# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs inside Blender: paths of the opened file that begin with $FIPT_GUI_BASE begin with $FIPT_GUI_SHOTS."""

from __future__ import annotations

import os

import bpy


def move(data: bpy.types.bpy_struct, old: str, new: str) -> None:
    """Rewrite the text properties of a property group and of all groups inside it."""
    for item in data.bl_rna.properties:
        if item.identifier == "rna_type" or not (item.is_runtime or item.identifier == "filepath"):
            continue
        value = getattr(data, item.identifier)
        if item.type == "STRING" and value.startswith(old) and not item.is_readonly:
            setattr(data, item.identifier, new + value[len(old) :])
        elif item.type == "POINTER" and isinstance(value, bpy.types.PropertyGroup):
            move(value, old, new)
        elif item.type == "COLLECTION":
            for part in value:
                move(part, old, new)


if __name__ == "__main__":
    names = (os.environ["FIPT_GUI_BASE"], os.environ["FIPT_GUI_SHOTS"])
    for scene in bpy.data.scenes:
        move(scene.fipt, *names)
    for image in bpy.data.images:
        move(image, *names)
