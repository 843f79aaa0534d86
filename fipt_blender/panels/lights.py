"""The section Lights: edits fixtures, new lights and the environment."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Context, PropertyGroup, UILayout

from ..blend.marks import (
    FIXTURE,
    INFERRED,
    NAMED,
    PROBABILITY,
    VISIBILITY,
    light_probe,
    linked_lamps,
)
from . import path
from .hints import ANSWER_NAMES, draw_again
from .sidebar import draw_text, panel, rows

CERTAIN = 0.98  # probability from which a fixture is not called in question


def _filter(
    self: bpy.types.UIList, context: Context, data: PropertyGroup, propname: str
) -> tuple[list[int], list[int]]:
    """Lights that there still are, and whose names have the text that is searched for."""
    search = self.filter_name.lower()
    matches = (item.is_alive() and search in item.object.name.lower() for item in getattr(data, propname))
    return [self.bitflag_filter_item if match else 0 for match in matches], []


@rows(filter_items=_filter)
def FIPT_UL_lights(layout: UILayout, context: Context, item: PropertyGroup, index: int) -> None:
    """Fixtures and added lights: on/off, solo, whole name, whether it may be no lamp, color"""
    light = item.object
    layout.use_property_split = False
    halves = layout.split(factor=0.88, align=True)
    row = halves.row(align=True)
    row.prop(item, "on", text="", icon="LIGHT" if item.on else "OUTLINER_DATA_LIGHT", emboss=False)
    row.prop(item, "solo", text="", icon="SOLO_ON" if item.solo else "SOLO_OFF", emboss=False)
    name = row.row(align=True)
    name.active = item.on
    name.prop(light, "name", text="", emboss=False)
    if _probability(light) < CERTAIN:
        row.label(text="", icon="QUESTION")
    color = halves.row(align=True)
    color.active = item.on
    color.prop(item, "color", text="")


@panel("Lights", 5, shown=path.has_lights, state=path.lights_state)
def FIPT_PT_lights(layout: UILayout, context: Context) -> None:
    """Switch and dim the estimated lights, and add lights"""
    settings = context.scene.fipt.lights
    for file, names in linked_lamps(context.scene).items():
        text = iface_("The room of {} is linked. Open that file to change its lights:")
        draw_text(layout, text.format(bpy.path.basename(file)), icon="LINKED")
        for name in names:
            layout.label(text=name, icon="LIGHT", translate=False)
    if len(settings.lights):
        row = layout.row()
        row.template_list("FIPT_UL_lights", "", settings, "lights", settings, "active", rows=4)
        row.operator("fipt.select_light", text="", icon="ZOOM_SELECTED")
        row = layout.row(align=True)
        row.operator("fipt.switch_lights", text="All Off", icon="OUTLINER_DATA_LIGHT").on = False
        row.operator("fipt.switch_lights", text="All On", icon="LIGHT").on = True
    elif not context.scene.fipt.materials.object_count:
        layout.operator("fipt.list_lights", text="List Lights", icon="FILE_REFRESH")
    row = layout.row(align=True)  # above all that depends on the chosen light, so that it stays in its place
    row.operator("fipt.add_light", text="Add Light by Pointing", icon="EYEDROPPER").place = "PICK"
    row.operator("fipt.add_light", text="", icon="PIVOT_CURSOR").place = "CURSOR"
    if (light := settings.active_light()) is not None:
        layout.prop(light, "stops")
        if INFERRED in light.object:
            text = iface_("Inferred, in no photograph: {:.0f} % of the light")
            draw_text(layout, text.format(100.0 * light.object[INFERRED]), icon="QUESTION")
        if _probability(light.object) < CERTAIN:
            _draw_doubt(layout, context.scene.fipt.hints, light.object)
    elif context.scene.fipt.materials.object_count and not len(settings.lights):
        draw_text(layout, "No lamps were found. Windows alone light the room.", icon="INFO")
    shading = context.space_data.shading
    if shading.type in ("SOLID", "WIREFRAME"):
        row = layout.row()
        row.use_property_split = False
        row.label(text="This view shows no light:", icon="SHADING_SOLID")
        row.prop_enum(shading, "type", "RENDERED", text="Show Light")
    if settings.needs_cycles():
        _draw_engine_choice(layout)
    elif settings.needs_probe():
        text = "EEVEE shows the light that the room reflects as blotches, or not, until its probe is baked."
        draw_text(layout, iface_(text), icon="ERROR")
        prepared = light_probe(context.scene) is not None
        layout.operator(
            "fipt.bake_probe" if prepared else "fipt.prepare_eevee", icon="OUTLINER_OB_LIGHTPROBE"
        )


def _draw_calibration(layout: UILayout, scene: bpy.types.Scene) -> None:
    """What the unit of light is, and the button that tells it."""
    row = layout.row(align=True)
    if not scene.fipt.lights.is_calibrated():
        row.operator("fipt.calibrate_light", icon="DRIVER_DISTANCE")
        return
    from ..blend.lights.calibration import exposure_value

    text = iface_("Calibrated, EV {:.1f}").format(exposure_value(scene))
    row.label(text=text, icon="CHECKMARK", translate=False)
    row.operator("fipt.calibrate_light", text="", icon="DRIVER_DISTANCE")


def _draw_engine_choice(layout: UILayout) -> None:
    """What is wrong in EEVEE, and what can be done about it."""
    text = "The room is lit by the surfaces of its lamps, whose light EEVEE does not render: it is dark."
    draw_text(layout, iface_(text), icon="ERROR")
    column = layout.column(align=True)
    column.operator("fipt.use_cycles", icon="SHADING_RENDERED")
    column.operator("fipt.prepare_eevee", icon="OUTLINER_OB_LIGHTPROBE")


def report_name(item: bpy.types.Object) -> str:
    """What the report calls a fixture that the artist has renamed; "" for any other object."""
    name = str(item.get(NAMED, item[FIXTURE])) if FIXTURE in item else ""
    return "" if name == item.name else name


def _probability(lamp: bpy.types.Object) -> float:
    """That a light of the list emits, as estimated; 1 for a light that was added."""
    return float(lamp.get(PROBABILITY, 1.0))


def _draw_doubt(layout: UILayout, hints: PropertyGroup, lamp: bpy.types.Object) -> None:
    """How sure it is that a fixture is a lamp, the answers, and how to use the answer."""
    column = layout.column(align=True)
    text = iface_("A lamp? {:.0f} % sure").format(100.0 * _probability(lamp))
    column.label(text=text, icon="QUESTION")
    told = {hint.emission for hint in hints.hints if hint.area and hint.name == lamp.name}
    row = column.row(align=True)
    for emission in ("EMITS", "NOT"):
        button = row.operator("fipt.hint_on_lamp", text=ANSWER_NAMES[emission], depress=emission in told)
        button.light, button.emission = lamp.name, emission
    if told:
        draw_again(layout, hints)


@panel("Chosen Light", 0, parent="FIPT_PT_lights", closed=True, shown=path.has_own_light)
def FIPT_PT_light(layout: UILayout, context: Context) -> None:
    """Power and color of the chosen light, and the way to Blender lights"""
    light = context.scene.fipt.lights.active_light()
    if name := report_name(light.object):
        layout.label(text=iface_("In the report: {}").format(name), translate=False)
    column = layout.column(align=True)
    if light.has_power():
        column.prop(light, "watts")
        if context.scene.fipt.lights.is_calibrated():
            column.prop(light, "lumens")
    if FIXTURE in light.object:
        column.prop(light, "radiance")
    column = layout.column()
    column.prop(light, "tint")
    is_temperature = light.has_temperature()
    if light.tint == "COLOR" or not is_temperature:
        column.prop(light, "color")
    if is_temperature:
        column.prop(light, "kelvin")
    column = layout.column(align=True)
    column.operator("fipt.reset_light", icon="LOOP_BACK")
    if FIXTURE in light.object and VISIBILITY not in light.object:
        column.operator("fipt.fixture_to_area_light", icon="LIGHT_AREA")
        return
    if FIXTURE in light.object:
        column.operator("fipt.area_light_to_fixture", icon="LOOP_BACK")
    column.operator("fipt.set_ies_profile", icon="LIGHT_POINT")


def _draw_switch(layout: UILayout, context: Context) -> None:
    """Whether light from outside is on."""
    settings = context.scene.fipt.lights
    layout.active = settings.has_environment()
    layout.prop(settings, "environment_on", text="")


@panel(
    "Environment",
    1,
    parent="FIPT_PT_lights",
    closed=True,
    shown=lambda context: context.scene.fipt.lights.result_world() is not None,
    before=_draw_switch,
)
def FIPT_PT_environment(layout: UILayout, context: Context) -> None:
    """Light from outside the room"""
    settings = context.scene.fipt.lights
    if not settings.has_environment():
        draw_text(layout, "The photographs show no light from outside the room.", icon="INFO")
        return
    column = layout.column()
    column.active = settings.environment_on
    column.prop(settings, "environment_factor")
    column.prop(settings, "environment_rotation")


@panel("Scene and Passes", 2, parent="FIPT_PT_lights", closed=True)
def FIPT_PT_light_output(layout: UILayout, context: Context) -> None:
    """The list, the unit of light, exposure, other lights, and render passes for each light"""
    layout.operator("fipt.list_lights", icon="FILE_REFRESH")
    if len(context.scene.fipt.lights.lights):
        _draw_calibration(layout, context.scene)
    layout.operator("fipt.match_exposure", icon="CAMERA_DATA")
    layout.label(text="Other Lights")
    row = layout.row(align=True)
    row.operator("fipt.hide_other_lights", text="Hide", icon="HIDE_ON").hide = True
    row.operator("fipt.hide_other_lights", text="Show", icon="HIDE_OFF").hide = False
    column = layout.column(align=True)
    if context.scene.render.engine != "CYCLES":
        column.operator("fipt.use_cycles", icon="SHADING_RENDERED")
    row = column.row(align=True)
    row.operator("fipt.prepare_eevee", icon="OUTLINER_OB_LIGHTPROBE")
    row.operator("fipt.bake_probe", text="", icon="RENDER_STILL")
    row = layout.row(align=True)
    row.operator("fipt.make_light_groups", icon="RENDERLAYERS")
    row.operator("fipt.remove_light_groups", text="", icon="X")
