"""The section Materials: applies the results to the room and shows their maps."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Context, PropertyGroup, UILayout

from ..jobs import running, runstate
from . import path, swatches
from .job import draw_job, draw_warnings, job_warnings
from .sidebar import draw_text, panel, rows

# The adjustments, and where they change nothing; of parts with mean values, sliders show the sums.
_SLIDERS = {"roughness_offset": 0.0, "metallic_offset": 0.0, "hue": 0.0, "saturation": 1.0, "value": 1.0}
_SUMS = {"roughness_offset": "roughness_value", "metallic_offset": "metallic_value"}


@panel("Materials", 4, shown=path.has_results, state=path.materials_state)
def FIPT_PT_materials(layout: UILayout, context: Context) -> None:
    """Show the estimated materials and their maps"""
    column = layout.column()
    column.enabled = context.mode == "OBJECT"
    column.prop(context.scene.fipt.materials, "shown")
    if missing := runstate.known(context.scene.fipt.run_folder).missing:
        text = iface_("{} pictures of the results are missing, such as {}").format(len(missing), missing[0])
        draw_text(layout, text, icon="ERROR", alert=True)
        layout.operator("file.find_missing_files", icon="VIEWZOOM")
    draw_job(layout, context, "materials")
    draw_warnings(layout, "materials", job_warnings(context, "materials"))


@rows()
def FIPT_UL_part_materials(layout: UILayout, context: Context, item: PropertyGroup, index: int) -> None:
    """The parts of the room: mean base color, name, and whether its material is adjusted"""
    layout.use_property_split = False
    # An icon: a color field can't be disabled without a tint.
    color = item.base_color.copy()  # of a property itself, Blender 4.3 converts zeros
    red, green, blue = (round(value, 2) for value in color.from_scene_linear_to_srgb())
    layout.label(text=item.name, icon_value=swatches.icon((red, green, blue)), translate=False)


@panel("Materials of Parts", 0, parent="FIPT_PT_materials")
def FIPT_PT_materials_parts(layout: UILayout, context: Context) -> None:
    """Adjust the estimated material of a part of the room"""
    settings = context.scene.fipt.materials
    row = layout.row()
    row.template_list("FIPT_UL_part_materials", "", settings, "parts", settings, "active_part", rows=5)
    row.operator("fipt.pick_part", text="", icon="EYEDROPPER")
    part = settings.part()
    if part is None:
        return
    column = _adjustments(layout, context, part)
    if part.known:
        column.prop(part, "color")
    for name in list(_SLIDERS)[:2]:
        column.prop(part, _SUMS[name] if part.known else name, slider=True)
    if (material := _replacement(context, part)) is not None:
        draw_text(layout, iface_("Replaced by {}").format(material.name), icon="MATERIAL")
    elif part.known:
        text = iface_("Estimated: roughness {:.2f}, metallic {:.2f}; {:,} pixels")
        draw_text(layout, text.format(part.roughness, part.metallic, part.pixels))
    else:
        draw_text(layout, iface_("No mean values for this part; {:,} faces").format(part.faces))
    changed = any(getattr(part, name) != neutral for name, neutral in _SLIDERS.items())
    changed |= part.known and part.color != part.base_color
    if changed and context.space_data.shading.type == "SOLID":
        text = "Solid shading shows the textures without these changes. Use Material Preview or Rendered."
        draw_text(layout, iface_(text), icon="INFO")


@panel(
    "More",
    0,
    parent="FIPT_PT_materials_parts",
    closed=True,
    shown=lambda context: context.scene.fipt.materials.part() is not None,
)
def FIPT_PT_materials_parts_more(layout: UILayout, context: Context) -> None:
    """What else can be done with the active part"""
    part = context.scene.fipt.materials.part()
    column = _adjustments(layout, context, part)
    for name in list(_SLIDERS)[2:]:
        column.prop(part, name, slider=True)
    row = column.row()
    row.enabled = part.known
    row.operator("fipt.set_part_color", text="Color by Code...", icon="COLOR")
    column = layout.column(align=True)
    row = column.row(align=True)
    row.operator("fipt.replace_part_material", text="Replace Material...", icon="MATERIAL")
    if _replacement(context, part) is not None:
        row.operator("fipt.restore_estimate", text="", icon="LOOP_BACK").all_parts = False
    column.operator("fipt.select_part_faces", icon="FACESEL")
    column.operator("fipt.reset_part", icon="LOOP_BACK").all_parts = False
    column.operator("fipt.mark_part_assets", icon="ASSET_MANAGER").all_parts = False


def _adjustments(layout: UILayout, context: Context, part: PropertyGroup) -> UILayout:
    """A column for the adjustments of a part, enabled where the part's estimate is shown."""
    column = layout.column(align=True)
    estimated = context.scene.fipt.materials.shown != "ORIGINAL"
    column.enabled = estimated and _replacement(context, part) is None
    return column


def _replacement(context: Context, part: PropertyGroup) -> bpy.types.Material | None:
    """The material that replaces that of a part."""
    from ..blend.results.replacing import replacement

    return replacement(context.scene, part.key)


@panel("Empty the Room", 1, parent="FIPT_PT_materials", closed=True)
def FIPT_PT_materials_emptying(layout: UILayout, context: Context) -> None:
    """The room without some of its furniture"""
    column = layout.column(align=True)
    column.operator("fipt.remove_from_room", icon="TRASH")
    column.operator("fipt.bring_back", icon="LOOP_BACK")


@panel("Hand Off", 3, parent="FIPT_PT_materials", closed=True)
def FIPT_PT_materials_hand_off(layout: UILayout, context: Context) -> None:
    """The room for other programs and machines"""
    column = layout.column(align=True)
    column.operator("fipt.export_room", text="Export Room...", icon="EXPORT")
    column.operator("fipt.collect_room", text="Collect Room...", icon="PACKAGE")


@panel("Apply Settings", 2, parent="FIPT_PT_materials", closed=True)
def FIPT_PT_materials_settings(layout: UILayout, context: Context) -> None:
    """Textures, and what else Apply Results changes"""
    settings = context.scene.fipt.materials
    column = layout.column()
    column.enabled = running.current() is None
    column.prop(settings, "atlas_mode")
    if settings.atlas_mode == "uv":
        column.prop(settings, "atlas_images")
        column.prop(settings, "texture_size")
        column.prop(settings, "texel_density")
        column.prop(settings, "texture_format")
    column.prop(settings, "write_back")
    column.prop(settings, "clean_mesh")
    column = layout.column(heading="Scene")
    column.enabled = running.current() is None
    column.prop(settings, "mute_lights")
    column.prop(settings, "set_rendering")
    layout.operator("fipt.apply_results", text="Apply Again", icon="MATERIAL")
    layout.operator("fipt.revert", icon="LOOP_BACK")
    text = "{} objects, {} images" if settings.applied_mode == "uv" else "{} objects with attributes"
    text = iface_(text).format(settings.object_count, 4 * settings.image_count)
    layout.label(text=text, icon="CHECKMARK", translate=False)
