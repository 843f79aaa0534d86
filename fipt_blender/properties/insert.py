# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""State of the section Insert: what is placed and how, and what is seen behind it."""

from __future__ import annotations

import bpy

KINDS = (
    ("OBJECT", "Object", "An object, with its children; one that is only linked is copied", "OBJECT_DATA", 0),
    ("COLLECTION", "Collection", "An instance of a collection", "OUTLINER_COLLECTION", 1),
    ("GREY_BALL", "Grey Ball", "A matt ball of 18 % grey: shows where the light comes from", "SPHERE", 2),
    ("MIRROR_BALL", "Mirror Ball", "A chrome ball: shows what surrounds it", "SHADING_RENDERED", 3),
    ("BALLS", "Both Balls", "A grey and a mirror ball side by side, as on a film set", "SNAP_PEEL_OBJECT", 4),
)
BALLS = {
    "GREY_BALL": ("grey_ball",),
    "MIRROR_BALL": ("mirror_ball",),
    "BALLS": ("grey_ball", "mirror_ball"),
}
ALIGNMENTS = (
    ("NORMAL", "Surface", "Its own up points away from the surface", "SNAP_NORMAL", 0),
    ("UPRIGHT", "Upright", "It stays as upright as it is, whatever the surface", "EMPTY_SINGLE_ARROW", 1),
)
BACKDROPS = (
    ("ROOM", "Rendered Room", "The whole picture is rendered: the room may be relit and changed", "HOME", 0),
    (
        "PHOTOGRAPH",
        "Photograph",
        "The original photograph, onto which inserted objects cast shadows and reflections",
        "IMAGE_DATA",
        1,
    ),
)


class FIPT_InsertSettings(bpy.types.PropertyGroup):
    """The section Insert."""

    kind: bpy.props.EnumProperty(name="Insert", description="What to place", items=KINDS, default="BALLS")
    object: bpy.props.PointerProperty(name="Object", description="The object to place", type=bpy.types.Object)
    collection: bpy.props.PointerProperty(
        name="Collection", description="The collection to place an instance of", type=bpy.types.Collection
    )
    copy: bpy.props.BoolProperty(
        name="Place a Copy",
        description="Leave the object where it is and place a copy that shares its data",
    )
    align: bpy.props.EnumProperty(
        name="Align", description="How it stands on the surface", items=ALIGNMENTS, default="NORMAL"
    )
    turn: bpy.props.FloatProperty(
        name="Turn", description="Angle about its own up", subtype="ANGLE", soft_min=-3.1416, soft_max=3.1416
    )
    scale: bpy.props.FloatProperty(
        name="Scale", description="Factor on its own size", default=1.0, min=1e-4, soft_max=10.0, precision=3
    )
    drop: bpy.props.BoolProperty(
        name="Drop to Surface",
        description="Its lowest point touches the surface; otherwise its origin lies on it",
        default=True,
    )
    # Written by the operator Set Backdrop alone, which changes the scene accordingly.
    backdrop: bpy.props.EnumProperty(
        name="Backdrop", description="What is seen behind inserted objects", items=BACKDROPS, default="ROOM"
    )
    samples: bpy.props.IntProperty(
        name="Samples",
        description="Cycles' samples a pixel: more take longer and leave less noise",
        default=128,
        min=1,
        soft_max=4096,
    )
    picture: bpy.props.StringProperty(description="File of the picture that was rendered last")


CLASSES = (FIPT_InsertSettings,)
