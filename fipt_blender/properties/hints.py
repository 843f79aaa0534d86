"""State of the panel Hints: what the artist knows of parts and areas, and the engine's questions."""

from __future__ import annotations

import bpy

MATERIALS = (
    ("UNKNOWN", "Unknown", "The engine decides between dielectric and metal", "QUESTION", 0),
    (
        "DIELECTRIC",
        "Dielectric",
        "Paint, plastic, wood, cloth, stone, ceramics, glass: no metal",
        "MATFLUID",
        1,
    ),
    ("METAL", "Metal", "Bare metal, for example steel, brass, chrome", "SHADING_RENDERED", 2),
)
ROUGHNESS = (
    ("UNKNOWN", "Unknown", "The engine finds the roughness"),
    ("VALUE", "Value", "The roughness is known"),
    ("RANGE", "Range", "The roughness lies between two values"),
)
# Base colours that are known, and their reflectance: of photographers' grey cards, and of white wall paint.
COLORS = (
    ("UNKNOWN", "Unknown", "The engine finds the base color"),
    ("GREY", "18 % Grey", "A photographer's grey card"),
    ("WHITE", "White Paint", "White wall paint, which reflects 82 %"),
    ("VALUE", "Value", "The base color is known, for example of a patch of a color chart"),
)
REFLECTANCE = {"GREY": 0.18, "WHITE": 0.82}
EMISSION = (
    ("UNKNOWN", "Unknown", "The engine finds out whether it is a lamp"),
    ("EMITS", "Emits Light", "It is a lamp or a screen, however dim it is"),
    ("NOT", "Does Not Emit", "It only reflects light, however bright it is"),
)

# Answers to the engine's questions.
ANSWERS = (
    ("METAL", "Metal", "It is bare metal"),
    ("DIELECTRIC", "No Metal", "It is paint, plastic, wood, cloth, stone or ceramics"),
    ("GLOSSY", "Glossy", "It mirrors its surroundings at least dimly: roughness up to 0.5"),
    ("MATT", "Matt", "It shows no more than a wide sheen: roughness 0.5 or more"),
    ("EMITS", "Lamp", "It emits light"),
    ("NOT", "No Lamp", "It only reflects light"),
    ("LEAVE", "Leave Alone", "Do not estimate it; it keeps its own material"),
)


class FIPT_Hint(bpy.types.PropertyGroup):
    """What is known of one part, or of an area that becomes a part of its own."""

    object: bpy.props.PointerProperty(
        type=bpy.types.Object, name="Object", description="Object of the surface"
    )
    point: bpy.props.FloatVectorProperty(
        name="Point", description="A point of the part, in the object's space", subtype="XYZ"
    )
    area: bpy.props.BoolProperty(name="Area", description="It is about an area instead of a whole part")
    material: bpy.props.EnumProperty(
        name="Material", description="Whether the part is a dielectric or a metal", items=MATERIALS
    )
    roughness_known: bpy.props.EnumProperty(
        name="Roughness", description="What is known of the part's roughness", items=ROUGHNESS
    )
    roughness: bpy.props.FloatProperty(
        name="Roughness",
        description="Roughness as in the Principled BSDF, or the lowest one",
        default=0.3,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
    )
    roughness_most: bpy.props.FloatProperty(
        name="Highest", description="The highest roughness", default=1.0, min=0.0, max=1.0, subtype="FACTOR"
    )
    color_known: bpy.props.EnumProperty(
        name="Base Color",
        description=(
            "What is known of the part's base color. It tells how bright and of which color the light is that"
            " no photograph shows. Estimate again to use it"
        ),
        items=COLORS,
    )
    color: bpy.props.FloatVectorProperty(
        name="Color",
        description="The base color",
        subtype="COLOR",
        size=3,
        default=(0.5,) * 3,
        min=0.01,
        max=1.0,
    )
    emission: bpy.props.EnumProperty(name="Light", description="Whether the part emits light", items=EMISSION)
    leave_alone: bpy.props.BoolProperty(
        name="Leave Alone",
        description="Do not estimate this part, for example a plant: its pixels are left out, and it keeps"
        " its own material",
    )
    same_object: bpy.props.PointerProperty(
        type=bpy.types.Object, name="Same Material As", description="Object of a part of the same material"
    )
    same_point: bpy.props.FloatVectorProperty(
        name="Same Point", description="A point of that part, in its object's space", subtype="XYZ"
    )

    def known_color(self) -> tuple[float, float, float] | None:
        """Scene-linear base color; None where nothing is known."""
        if self.color_known == "UNKNOWN":
            return None
        red, green, blue = self.color if self.color_known == "VALUE" else (REFLECTANCE[self.color_known],) * 3
        return red, green, blue

    def bounds(self) -> tuple[float, float] | None:
        """The lowest and highest roughness; None where nothing is known."""
        if self.roughness_known == "UNKNOWN":
            return None
        most = self.roughness if self.roughness_known == "VALUE" else self.roughness_most
        return min(self.roughness, most), max(self.roughness, most)


class FIPT_Doubt(bpy.types.PropertyGroup):
    """A part of which a hint would help. `name` is the part's."""

    question: bpy.props.EnumProperty(
        name="Question",
        description="What the photographs do not tell clearly",
        items=[
            ("METAL", "Metal?", "Whether it is a metal"),
            ("GLOSS", "Glossy?", "How rough it is"),
            ("LAMP", "Lamp?", "Whether it emits light"),
        ],
    )
    text: bpy.props.StringProperty(name="Text", description="The question in words")
    point: bpy.props.FloatVectorProperty(
        name="Point", description="A point of the part in the world", subtype="XYZ"
    )
    view: bpy.props.StringProperty(name="View", description="The view that shows the part best")
    picture: bpy.props.StringProperty(name="Picture", description="File with a picture of the part")
    answered: bpy.props.BoolProperty(name="Answered", description="A hint has been made of it")


class FIPT_HintsSettings(bpy.types.PropertyGroup):
    """The panel Hints."""

    hints: bpy.props.CollectionProperty(type=FIPT_Hint)
    active_hint: bpy.props.IntProperty(name="Hint", description="What is known of a part or an area")
    light: bpy.props.BoolProperty(
        name="Light Changes Too",
        description=(
            "Re-estimate computes the light anew, too, because the hints change which surfaces are lamps."
            " It takes as long as the last refinement"
        ),
    )
    doubts: bpy.props.CollectionProperty(type=FIPT_Doubt)
    active_doubt: bpy.props.IntProperty(
        name="Question", description="A part of which the photographs do not tell enough"
    )

    def hint(self) -> FIPT_Hint | None:
        """The active hint; None without one."""
        return self.hints[self.active_hint] if 0 <= self.active_hint < len(self.hints) else None

    def doubt(self) -> FIPT_Doubt | None:
        """The active question; None without one."""
        return self.doubts[self.active_doubt] if 0 <= self.active_doubt < len(self.doubts) else None
