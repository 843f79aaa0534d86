# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""State of pictures with inserted objects: their backdrop, the last one."""

from __future__ import annotations

import bpy

BACKDROPS = (
    ("ROOM", "Rendered Room", "Render the whole picture, with changed lights and materials", "HOME", 0),
    (
        "PHOTOGRAPH",
        "Photograph",
        "Render the inserted objects with their shadows and reflections over the original photograph",
        "IMAGE_DATA",
        1,
    ),
)


class FIPT_InsertSettings(bpy.types.PropertyGroup):
    """Pictures of the section Render."""

    # Set only by the operator Set Backdrop, which also changes the scene.
    backdrop: bpy.props.EnumProperty(
        name="Backdrop", description="What is behind the inserted objects", items=BACKDROPS, default="ROOM"
    )
    picture: bpy.props.StringProperty(description="Image file of the last rendered picture")
