# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""State of the section Parts: which surfaces share a material."""

from __future__ import annotations

import bpy

# identifier, name, what it is good for; "folder" is "masks" to the engine, with images of the artist's own
SOURCES = (
    (
        "auto",
        "Automatic",
        "The finest that the capture or the room has: masks, else material slots, else objects",
        "SHADERFX",
    ),
    (
        "masks",
        "Part Masks",
        "Id images beside the photographs: one id a material. The best there is",
        "IMAGE",
    ),
    (
        "folder",
        "Mask Folder",
        "Id images of your own, named like the photographs, e.g. painted or from a segmentation tool",
        "FILE_FOLDER",
    ),
    (
        "semantics",
        "Semantic Masks",
        "Id images of classes (wall, chair, ...), each of several materials: guides, but binds less",
        "IMAGE_RGB",
    ),
    (
        "materials",
        "Material Slots",
        "One part a material slot: for rooms that were modelled, or painted with materials",
        "MATERIAL",
    ),
    ("objects", "Objects", "One part an object: where each thing is of one material", "OBJECT_DATA"),
    (
        "loose",
        "Loose Pieces",
        "One part a connected piece of mesh, also within one object: for models joined into one mesh",
        "MESH_DATA",
    ),
    ("none", "None", "Each point is estimated by itself: for one closed scan without masks", "X"),
)
ENGINE_SOURCES = {"folder": "masks"}


class FIPT_PartsSettings(bpy.types.PropertyGroup):
    """The section Parts."""

    source: bpy.props.EnumProperty(
        name="Parts From",
        description="What tells which surfaces are of one material, and so share roughness and metallic",
        items=[(*entry, index) for index, entry in enumerate(SOURCES)],
        default="auto",
    )
    folder: bpy.props.StringProperty(
        name="Masks",
        description="Folder with an id image (PNG or EXR) a photograph, named like it and of its size",
        subtype="DIR_PATH",
    )
    surveyed_folder: bpy.props.StringProperty(description="The folder of masks that the check looked at")
    auto_source: bpy.props.StringProperty(description="What Automatic chose; empty before a check")
    counts: bpy.props.StringProperty(description="Number of parts of each source, as JSON")

    @property
    def engine_source(self) -> str:
        """The source as room.json names it, one of `mainjob.PARTS`."""
        return ENGINE_SOURCES.get(self.source, self.source)


CLASSES = (FIPT_PartsSettings,)
