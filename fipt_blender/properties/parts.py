# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""State of the section Parts: which surfaces share a material."""

from __future__ import annotations

import bpy

# Identifier, label, tooltip, icon. The engine knows "folder" as "masks", with the artist's own images.
SOURCES = (
    (
        "auto",
        "Automatic",
        "Material slots or objects, divided further where the capture's masks agree; one of them if no "
        "others; with a scan, masks or nothing",
        "SHADERFX",
    ),
    (
        "masks",
        "Part Masks",
        "ID images beside the photographs alone, with one ID per material; for meshes whose slots are wrong",
        "IMAGE",
    ),
    (
        "folder",
        "Mask Folder",
        "Your own ID images, named like the photographs, e.g. painted or made by a segmentation tool, whose "
        "IDs may differ from photograph to photograph",
        "FILE_FOLDER",
    ),
    (
        "semantics",
        "Semantic Masks",
        "ID images of classes (wall, chair, ...), which may have several materials. Less precise than parts",
        "IMAGE_RGB",
    ),
    (
        "materials",
        "Material Slots",
        "One part per material slot, for rooms that were modeled or have assigned materials",
        "MATERIAL",
    ),
    (
        "objects",
        "Objects",
        "One part per object, for rooms where each object has one material",
        "OBJECT_DATA",
    ),
    (
        "loose",
        "Loose Pieces",
        "One part per connected piece of mesh, for models that are joined into one object",
        "MESH_DATA",
    ),
    ("none", "None", "Each point is estimated separately, for a single scan without masks", "X"),
)
ENGINE_SOURCES = {"folder": "masks"}


class FIPT_PartsSettings(bpy.types.PropertyGroup):
    """The section Parts."""

    source: bpy.props.EnumProperty(
        name="Parts From",
        description="How surfaces of the same material are recognized. They share roughness and metallic",
        items=[(*entry, index) for index, entry in enumerate(SOURCES)],
        default="auto",
    )
    folder: bpy.props.StringProperty(
        name="Masks",
        description="Folder with an ID image (PNG or EXR) for each photograph, with the same name and size",
        subtype="DIR_PATH",
    )
    surveyed_folder: bpy.props.StringProperty(description="The mask folder at the last check")
    auto_source: bpy.props.StringProperty(description="The source that Automatic uses; empty before a check")
    counts: bpy.props.StringProperty(description="Number of parts from each source, as JSON")

    @property
    def engine_source(self) -> str:
        """The source as room.json names it, one of `jobs.options.PARTS`."""
        return ENGINE_SOURCES.get(self.source, self.source)
