# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""State of the section Insert: what is placed and how, and its backdrop."""

from __future__ import annotations

import bpy

KINDS = (
    (
        "OBJECT",
        "Object",
        "An object with its children. It is copied if it is in a library or another scene",
        "OBJECT_DATA",
        0,
    ),
    ("COLLECTION", "Collection", "An instance of a collection", "OUTLINER_COLLECTION", 1),
    (
        "GREY_BALL",
        "Gray Ball",
        "A matte ball of 18% gray, which shows where the light comes from",
        "SPHERE",
        2,
    ),
    ("MIRROR_BALL", "Mirror Ball", "A chrome ball, which reflects its surroundings", "SHADING_RENDERED", 3),
    (
        "BALLS",
        "Both Balls",
        "A gray ball and a mirror ball side by side, as on a film set",
        "SNAP_PEEL_OBJECT",
        4,
    ),
)
BALLS = {"GREY_BALL": ("gray_ball",), "MIRROR_BALL": ("mirror_ball",), "BALLS": ("gray_ball", "mirror_ball")}
ALIGNMENTS = (
    ("NORMAL", "Surface", "Align the object's up axis with the surface normal", "SNAP_NORMAL", 0),
    ("UPRIGHT", "Upright", "Keep the object upright on any surface", "EMPTY_SINGLE_ARROW", 1),
)
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
    """The section Insert."""

    kind: bpy.props.EnumProperty(name="Insert", description="What to place", items=KINDS, default="BALLS")
    object: bpy.props.PointerProperty(name="Object", description="The object to place", type=bpy.types.Object)
    collection: bpy.props.PointerProperty(
        name="Collection", description="The collection to place an instance of", type=bpy.types.Collection
    )
    copy: bpy.props.BoolProperty(
        name="Place a Copy", description="Leave the object where it is, and place a copy that shares its data"
    )
    align: bpy.props.EnumProperty(
        name="Align",
        description="Orientation of the object on the surface",
        items=ALIGNMENTS,
        default="NORMAL",
    )
    turn: bpy.props.FloatProperty(
        name="Rotation",
        description="Rotation about the object's up axis",
        subtype="ANGLE",
        soft_min=-3.1416,
        soft_max=3.1416,
    )
    scale: bpy.props.FloatProperty(
        name="Scale",
        description="Scale factor of the object",
        default=1.0,
        min=1e-4,
        soft_max=10.0,
        precision=3,
    )
    drop: bpy.props.BoolProperty(
        name="Drop to Surface",
        description="Place the object's lowest point on the surface instead of its origin",
        default=True,
    )
    # Set only by the operator Set Backdrop, which also changes the scene.
    backdrop: bpy.props.EnumProperty(
        name="Backdrop", description="What is behind the inserted objects", items=BACKDROPS, default="ROOM"
    )
    picture: bpy.props.StringProperty(description="Image file of the last rendered picture")
