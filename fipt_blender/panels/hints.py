"""The panel Hints of the section Estimate: questions of the engine, and what the artist knows."""

from __future__ import annotations

from pathlib import Path

from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Context, PropertyGroup, UILayout

from ..blend.previews import doubt_pictures
from ..jobs import running
from ..properties.hints import ANSWERS
from .sidebar import draw_text, panel, rows

ANSWER_NAMES = {identifier: name for identifier, name, _ in ANSWERS}
_CHOICES = {"METAL": ("METAL", "DIELECTRIC"), "GLOSS": ("GLOSSY", "MATT"), "LAMP": ("EMITS", "NOT")}


@rows()
def FIPT_UL_doubts(layout: UILayout, context: Context, item: PropertyGroup, index: int) -> None:
    """The engine's questions, the most useful one first"""
    row = layout.row(align=True)
    row.label(text=item.name, icon="CHECKMARK" if item.answered else "QUESTION", translate=False)
    row.label(text=item.text)


@rows()
def FIPT_UL_hints(layout: UILayout, context: Context, item: PropertyGroup, index: int) -> None:
    """What the artist knows of parts and areas"""
    row = layout.row(align=True)
    missing = item.object is None or item.object.name not in context.scene.objects
    kind = "FACE_MAPS" if item.area else "MATERIAL"
    row.prop(item, "name", text="", emboss=False, icon="CANCEL" if missing else kind)
    row.label(text=hint_text(item), translate=False)
    row.operator("fipt.remove_hint", text="", icon="X", emboss=False).index = index


@panel("Hints", 1, parent="FIPT_PT_estimate", closed=True)
def FIPT_PT_estimate_hints(layout: UILayout, context: Context) -> None:
    """Say what you know of materials and lamps, and estimate again with it"""
    layout.use_property_split = False
    settings = context.scene.fipt.hints
    column = layout.column()
    column.enabled = running.current() is None
    column.operator("fipt.read_doubts", icon="QUESTION")
    if len(settings.doubts):
        column.template_list("FIPT_UL_doubts", "", settings, "doubts", settings, "active_doubt", rows=4)
        doubt = settings.doubt()
        if doubt is not None:
            _draw_doubt(column, doubt)
    column.separator()
    row = column.row(align=True)
    if context.mode == "EDIT_MESH":
        row.operator("fipt.add_area_hint", icon="FACESEL")
    else:
        row.operator("fipt.add_hint", text="Hint on Part", icon="EYEDROPPER").what = "PART"
        row.operator("fipt.add_hint", text="Hint on Face Set", icon="FACE_MAPS").what = "FACE_SET"
    if len(settings.hints):
        column.template_list("FIPT_UL_hints", "", settings, "hints", settings, "active_hint", rows=3)
        hint = settings.hint()
        if hint is not None:
            _draw_hint(column, context, hint)
    draw_again(layout, settings)


def draw_again(layout: UILayout, settings: PropertyGroup) -> None:
    """How to estimate again with the hints."""
    layout.prop(settings, "light")
    column = layout.column()
    column.scale_y = 1.2
    column.operator("fipt.reestimate", icon="FILE_REFRESH")


def _draw_doubt(layout: UILayout, doubt: PropertyGroup) -> None:
    """The picture of a part, the question, and a button for each answer."""
    box = layout.box()
    if icon := doubt_pictures.add(Path(doubt.picture)):
        box.template_icon(icon_value=icon, scale=7.0)
    row = box.row()
    row.label(text=doubt.text)
    row.operator("fipt.look_through", text="", icon="OUTLINER_OB_CAMERA").view = doubt.view
    row = box.row(align=True)
    for answer in (*_CHOICES[doubt.question], "LEAVE"):
        row.operator("fipt.answer_doubt", text=ANSWER_NAMES[answer]).answer = answer


def _draw_hint(layout: UILayout, context: Context, hint: PropertyGroup) -> None:
    """What is known of a part."""
    column = layout.column()
    column.use_property_split = True
    column.use_property_decorate = False
    column.prop(hint, "leave_alone")
    about = column.column()
    about.enabled = not hint.leave_alone
    about.prop(hint, "material")
    about.prop(hint, "roughness_known")
    if hint.roughness_known != "UNKNOWN":
        about.prop(hint, "roughness", text="Lowest" if hint.roughness_known == "RANGE" else "Roughness")
    if hint.roughness_known == "RANGE":
        about.prop(hint, "roughness_most")
    about.prop(hint, "color_known")
    if hint.color_known == "VALUE":
        about.prop(hint, "color")
    about.prop(hint, "emission")
    row = about.row(align=True)
    row.prop(hint, "same_object", text="Same As")
    row.operator("fipt.pick_same_material", text="", icon="EYEDROPPER")
    if hint.object is None or hint.object.name not in context.scene.objects:
        draw_text(layout, "Its object has been removed: this hint has no effect.", icon="ERROR")


def hint_text(hint: PropertyGroup) -> str:
    """What a hint says, in a few words."""
    if hint.leave_alone:
        return iface_("Leave Alone")
    names = []
    if hint.material != "UNKNOWN":
        names.append(iface_("Metal" if hint.material == "METAL" else "Dielectric"))
    bounds = hint.bounds()
    if bounds is not None:
        low, high = bounds
        names.append(f"{low:.2g}" if low == high else f"{low:.2g}-{high:.2g}")
    if hint.color_known != "UNKNOWN":
        names.append(iface_("Known Color"))
    if hint.emission != "UNKNOWN":
        names.append(iface_("Emits Light" if hint.emission == "EMITS" else "Does Not Emit"))
    if hint.same_object is not None:
        names.append(iface_("as {}").format(hint.same_object.name))
    return ", ".join(names) or iface_("Unknown")
