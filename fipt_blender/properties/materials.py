# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""State of the section Materials: how results are applied, and which map the room shows."""

from __future__ import annotations

import bpy

SHOWN = (
    ("ESTIMATED", "Estimated", "The estimated materials and lights", "SHADING_RENDERED", 0),
    ("ORIGINAL", "Original", "The room as it was: its own meshes, materials and world", "LOOP_BACK", 1),
    ("BASE_COLOR", "Base Colour", "What the surfaces reflect, without any light", "COLOR", 2),
    ("ROUGHNESS", "Roughness", "Black is a mirror, white is rough", "NODE_TEXTURE", 3),
    ("METALLIC", "Metallic", "White is metal", "NODE_MATERIAL", 4),
    ("EMISSION", "Emission", "Which surfaces shine, in the colour of their light", "LIGHT", 5),
    (
        "CONFIDENCE",
        "Confidence",
        "How well base colour (red), roughness (green) and metallic (blue) are known: 1 is certain, "
        "each 0.1 less is a standard error 0.03 larger; black was not seen and is filled in",
        "HIDE_OFF",
        6,
    ),
)


def _shown_changed(self: FIPT_MaterialsSettings, context: bpy.types.Context) -> None:
    from ..blend.maps import show

    show(self.id_data, self.shown)


class FIPT_MaterialsSettings(bpy.types.PropertyGroup):
    """The section Materials."""

    shown: bpy.props.EnumProperty(
        name="Show",
        description="What the whole room shows in viewports and renders",
        items=SHOWN,
        default="ESTIMATED",
        update=_shown_changed,
    )
    atlas_mode: bpy.props.EnumProperty(
        name="Store In",
        description="Where the estimated values lie",
        items=[
            ("uv", "Image Textures", "Images on a UV layer of their own", "IMAGE_DATA", 0),
            (
                "color_attribute",
                "Colour Attributes",
                "Values at the mesh's corners: for dense scans that can't be unwrapped",
                "GROUP_VCOL",
                1,
            ),
        ],
        default="uv",
    )
    texture_size: bpy.props.EnumProperty(
        name="Texture Size",
        description="Largest width and height of one image; a room gets as many as it needs, up to 16",
        items=[(str(size), f"{size:,}", "") for size in (512, 1024, 2048, 4096, 8192)],
        default="2048",
    )
    texel_density: bpy.props.FloatProperty(
        name="Texel Density",
        description="How fine the textures are, in texels a metre; photographs rarely show more than 500",
        default=128.0,
        min=1.0,
        soft_min=16.0,
        soft_max=1024.0,
        precision=0,
    )
    write_back: bpy.props.EnumProperty(
        name="Surface",
        description="What stands between the estimated textures and the render",
        items=[
            ("cycles", "For Cycles", "A node group makes Cycles reflect what the photographs show"),
            ("paper", "Plain", "Principled alone; several per cent off, more where seen at a slant"),
        ],
        default="cycles",
    )
    match_exposure: bpy.props.BoolProperty(
        name="Match Exposure",
        description="Set the scene's exposure so that the photographs' middle is middle grey",
        default=True,
    )
    mute_lights: bpy.props.BoolProperty(
        name="Hide Other Lights",
        description="Hide the scene's own lights, which the photographs did not see; Revert shows them again",
        default=True,
    )
    object_count: bpy.props.IntProperty(description="Objects that carry results; 0 for none")
    image_count: bpy.props.IntProperty(description="Images or attribute materials of the applied results")
    applied_mode: bpy.props.StringProperty(description="atlas_mode of the applied results")
    kept_view: bpy.props.StringProperty(description="The scene's view settings, while a map is shown (JSON)")
    kept_solid: bpy.props.StringProperty(
        description="How viewports in solid shading were coloured before they drew maps (JSON)"
    )
    kept_before: bpy.props.StringProperty(description="What Revert brings back of the scene (JSON)")


CLASSES = (FIPT_MaterialsSettings,)
