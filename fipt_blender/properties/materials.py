"""State of the section Materials: how results are applied, and which map is shown on the room."""

from __future__ import annotations

from collections.abc import Sequence

import bpy

from ..core.run.stage_settings import TextureSettings
from .declared import properties_of

SHOWN = (
    ("ESTIMATED", "Estimated", "The estimated materials and lights", "SHADING_RENDERED", 0),
    ("ORIGINAL", "Original", "Your own meshes, materials and world", "LOOP_BACK", 1),
    ("BASE_COLOR", "Base Color", "The base color of the surfaces, without lighting", "COLOR", 2),
    (
        "ROUGHNESS",
        "Roughness",
        "The roughness of the surfaces: black is a mirror, white is rough",
        "NODE_TEXTURE",
        3,
    ),
    ("METALLIC", "Metallic", "Which surfaces are metal: white is metal", "NODE_MATERIAL", 4),
    ("EMISSION", "Emission", "The light that surfaces emit, in its color", "LIGHT", 5),
    (
        "CONFIDENCE",
        "Confidence",
        "Confidence of base color (red), roughness (green) and metallic (blue): 1 is certain, each 0.1 less"
        " is a standard error larger by 0.03. Black surfaces were not seen; their values are filled in",
        "HIDE_OFF",
        6,
    ),
)


def _shown_changed(self: FIPT_MaterialsSettings, context: bpy.types.Context) -> None:
    from ..blend.results.maps import show

    show(self.id_data, self.shown)


def _absolute(field: str) -> object:
    """A part's mean value with its adjustment, which is added to the estimate."""

    def read(self: FIPT_Part) -> float:
        return min(max(getattr(self, field) + getattr(self, f"{field}_offset"), 0.0), 1.0)

    def write(self: FIPT_Part, value: float) -> None:
        setattr(self, f"{field}_offset", value - getattr(self, field))

    text = f"Mean {field} of the part: the estimate, until you change it"
    limits = {"min": 0.0, "max": 1.0, "precision": 2}
    return bpy.props.FloatProperty(name=field.capitalize(), description=text, get=read, set=write, **limits)


def _adjustment(field: str, name: str, text: str, low: float, high: float) -> object:
    """An adjustment that is stored in the materials of a part."""

    def read(self: FIPT_Part) -> float:
        from ..blend.results.part_list import adjustment

        return float(getattr(adjustment(self.id_data, self.key), field))

    def write(self: FIPT_Part, value: float) -> None:
        from ..blend.results.part_list import set_adjustment

        set_adjustment(self.id_data, self.key, **{field: value})

    return bpy.props.FloatProperty(name=name, description=text, min=low, max=high, get=read, set=write)


def _color() -> object:
    """A part's mean base colour with its adjustment by gain and shift."""

    def read(self: FIPT_Part) -> tuple[float, ...]:
        from ..blend.results.part_colors import color_of

        return color_of(self)

    def write(self: FIPT_Part, value: Sequence[float]) -> None:
        from ..blend.results.part_colors import set_color

        set_color(self, value)

    text = "Mean base color of the part. Its pattern and gloss stay when you choose another one"
    limits = {"subtype": "COLOR", "size": 3, "min": 0.0, "max": 1.0}
    return bpy.props.FloatVectorProperty(name="Color", description=text, get=read, set=write, **limits)


class FIPT_Part(bpy.types.PropertyGroup):
    """A part of the room with applied results; its name is unique."""

    key: bpy.props.StringProperty(description="Names the part in other estimates, see core.run.parts")
    unit: bpy.props.IntProperty(description="Index of the part in the run; -1 for the rest of an object")
    class_name: bpy.props.StringProperty(name="Class", description="Semantic class")
    faces: bpy.props.IntProperty(name="Faces", description="Number of faces in the room")
    pixels: bpy.props.IntProperty(name="Pixels", description="Number of pixels that saw it")
    known: bpy.props.BoolProperty(description="Whether photographs saw the part")
    base_color: bpy.props.FloatVectorProperty(
        name="Base Color", description="Mean estimated base color", subtype="COLOR", size=3, min=0.0, max=1.0
    )
    roughness: bpy.props.FloatProperty(name="Roughness", description="Mean estimated roughness")
    metallic: bpy.props.FloatProperty(name="Metallic", description="Mean estimated metallic")
    confidence: bpy.props.FloatVectorProperty(
        name="Confidence", description="Mean confidence of base color, roughness and metallic", size=3
    )
    roughness_offset: _adjustment(
        "roughness", "Roughness ±", "Added to the estimated roughness of the part", -1.0, 1.0
    )
    metallic_offset: _adjustment(
        "metallic", "Metallic ±", "Added to the estimated metallic of the part", -1.0, 1.0
    )
    color: _color()
    roughness_value: _absolute("roughness")
    metallic_value: _absolute("metallic")
    hue: _adjustment(
        "hue", "Hue", "Turn of the estimated base color's hue; 0.5 is the opposite color", -0.5, 0.5
    )
    saturation: _adjustment(
        "saturation", "Saturation", "Factor of the estimated base color's saturation", 0.0, 2.0
    )
    value: _adjustment("value", "Value", "Factor of the estimated base color's brightness", 0.0, 2.0)


class FIPT_MaterialsSettings(bpy.types.PropertyGroup):
    """The section Materials."""

    shown: bpy.props.EnumProperty(
        name="Show",
        description="What is shown on the room in viewports and renders",
        items=SHOWN,
        default="ESTIMATED",
        update=_shown_changed,
    )
    texture_size: bpy.props.EnumProperty(
        name="Texture Size",
        description="Maximum width and height of an image. A room uses up to 16 images",
        items=[(str(size), f"{size:,}", "") for size in (512, 1024, 2048, 4096, 8192)],
        default="2048",
    )
    texture_format: bpy.props.EnumProperty(
        name="Format",
        description="File format of the textures; the environment is always EXR",
        items=[
            ("EXR", "OpenEXR", "Linear values in half precision, as they were baked", "NONE", 0),
            ("PNG", "PNG 16 Bit", "For programs that do not read EXR; base color is sRGB", "NONE", 1),
        ],
        default="EXR",
    )
    __annotations__.update(
        properties_of(
            TextureSettings, ("atlas_mode", "atlas_images", "texel_density", "write_back", "clean_mesh")
        )
    )
    mute_lights: bpy.props.BoolProperty(
        name="Hide Lights",
        description="Hide the scene's own lights, which are not in the photographs. Revert shows them again",
        default=True,
    )
    set_rendering: bpy.props.BoolProperty(
        name="Render Settings",
        description="Set the scene's render settings, once: Cycles, since in EEVEE the surfaces of lamps emit"
        " no light onto the room; samples, denoiser and size of pictures; colors and exposure of the"
        " photographs. What you change of them stays as you set it. Revert restores the others",
        default=True,
    )
    parts: bpy.props.CollectionProperty(type=FIPT_Part)
    active_part: bpy.props.IntProperty(name="Part", description="The part whose material is adjusted")
    object_count: bpy.props.IntProperty(description="Number of objects with applied results")
    image_count: bpy.props.IntProperty(
        description="Number of images or attribute materials of the applied results"
    )
    applied_mode: bpy.props.StringProperty(description="atlas_mode of the applied results")
    applied_version: bpy.props.StringProperty(description="Id of the results that were applied")
    kept_view: bpy.props.StringProperty(
        description="The scene's view settings from before a map was shown, as JSON"
    )
    kept_solid: bpy.props.StringProperty(
        description="Color settings of viewports in Solid mode from before a map was shown, as JSON"
    )

    def part(self) -> FIPT_Part | None:
        """The active part; None without one."""
        index = self.active_part
        return self.parts[index] if 0 <= index < len(self.parts) else None

    def active_part_key(self) -> str:
        """Its key; "" without one."""
        part = self.part()
        return part.key if part is not None else ""
