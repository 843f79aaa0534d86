# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The section Lights: edits fixtures, new lights and the environment."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Context, PropertyGroup, UILayout

from ..blend.marks import (
    ANIMATED,
    FIXTURE,
    INFERRED,
    MERGED,
    NAMED,
    PROBABILITY,
    VISIBILITY,
    light_probe,
    linked_lamps,
)
from .hints import ANSWER_NAMES, draw_again
from .sidebar import Rows, Section, SubSection, draw_text

# What lights of earlier releases have, by the mark that says so.
_OLD = {
    ANIMATED: "Keyframes of an earlier release, until results are applied",
    MERGED: "Merged by an earlier release, until results are applied",
}
CERTAIN = 0.98  # probability from which a fixture is not called in question


class FIPT_UL_lights(Rows, bpy.types.UIList):
    """Fixtures and added lights: on/off, solo, whole name, whether it may be no lamp, color"""

    def draw_row(self, context: Context, layout: UILayout, item: PropertyGroup, index: int) -> None:
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

    def filter_items(
        self, context: bpy.types.Context, data: bpy.types.PropertyGroup, propname: str
    ) -> tuple[list[int], list[int]]:
        items = getattr(data, propname)
        search = self.filter_name.lower()
        matches = (item.is_alive() and search in item.object.name.lower() for item in items)
        return [self.bitflag_filter_item if match else 0 for match in matches], []


class FIPT_PT_lights(Section, bpy.types.Panel):
    """Edit the estimated lights and the environment, and add lights"""

    bl_label = "Lights"
    bl_order = 5

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.fields()
        settings = context.scene.fipt.lights
        for path, names in linked_lamps(context.scene).items():
            text = iface_("The room of {} is linked. Open that file to change its lights:")
            draw_text(layout, context, text.format(bpy.path.basename(path)), icon="LINKED")
            for name in names:
                layout.label(text=name, icon="LIGHT", translate=False)
        if len(settings.lights):
            row = layout.row()
            row.template_list("FIPT_UL_lights", "", settings, "lights", settings, "active", rows=4)
            column = row.column(align=True)
            column.operator("fipt.select_light", text="", icon="ZOOM_SELECTED")
            column.operator("fipt.reset_light", text="", icon="LOOP_BACK")
            row = layout.row(align=True)
            row.operator("fipt.switch_lights", text="All Off", icon="OUTLINER_DATA_LIGHT").on = False
            row.operator("fipt.switch_lights", text="All On", icon="LIGHT").on = True
            _draw_light(layout, context.scene, settings.active_light())
        elif context.scene.fipt.materials.object_count:
            text = "No lamps were found. The room is lit by the environment (windows) alone."
            draw_text(layout, context, text, icon="INFO")
        else:
            layout.operator("fipt.list_lights", text="List Lights", icon="FILE_REFRESH")
        if settings.needs_cycles():
            draw_engine_choice(layout, context)
        elif settings.needs_probe():
            text = (
                "EEVEE shows the light that the room reflects as blotches, or not, until its probe is baked."
            )
            draw_text(layout, context, iface_(text), icon="ERROR")
            prepared = light_probe(context.scene) is not None
            layout.operator(
                "fipt.bake_probe" if prepared else "fipt.prepare_eevee", icon="OUTLINER_OB_LIGHTPROBE"
            )
        column = layout.column(align=True)
        column.operator("fipt.add_light", text="Add Light at Cursor", icon="ADD").place = "CURSOR"
        column.operator("fipt.add_light", text="Add Light by Pointing", icon="EYEDROPPER").place = "PICK"


def _draw_calibration(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """What the unit of light is, and the button that tells it."""
    row = layout.row(align=True)
    if not scene.fipt.lights.is_calibrated():
        row.operator("fipt.calibrate_light", icon="DRIVER_DISTANCE")
        return
    from ..blend.lights.calibration import exposure_value

    text = iface_("Calibrated, EV {:.1f}").format(exposure_value(scene))
    row.label(text=text, icon="CHECKMARK", translate=False)
    row.operator("fipt.calibrate_light", text="", icon="DRIVER_DISTANCE")


def draw_engine_choice(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """What is wrong in EEVEE, and what can be done about it."""
    text = "The room is lit by the surfaces of its lamps, whose light EEVEE does not render: it is dark."
    draw_text(layout, context, iface_(text), icon="ERROR")
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


def _draw_doubt(layout: bpy.types.UILayout, hints: bpy.types.PropertyGroup, lamp: bpy.types.Object) -> None:
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


def _draw_light(
    layout: bpy.types.UILayout, scene: bpy.types.Scene, light: bpy.types.PropertyGroup | None
) -> None:
    """The settings of the active light."""
    if light is None:
        return
    if name := report_name(light.object):
        layout.label(text=iface_("In the report: {}").format(name), translate=False)
    if INFERRED in light.object:
        text = iface_("Inferred, in no photograph: {:.0f} % of the light")
        layout.label(text=text.format(100.0 * light.object[INFERRED]), icon="QUESTION", translate=False)
    if _probability(light.object) < CERTAIN:
        _draw_doubt(layout, scene.fipt.hints, light.object)
    column = layout.column(align=True)
    column.prop(light, "stops")
    if light.has_power():
        column.prop(light, "watts")
        if scene.fipt.lights.is_calibrated():
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
    for mark, note in _OLD.items():
        if mark in light.object:
            layout.label(text=note, icon="INFO")
    if FIXTURE in light.object and VISIBILITY not in light.object:
        layout.operator("fipt.fixture_to_area_light", icon="LIGHT_AREA")
        return
    if FIXTURE in light.object:
        layout.operator("fipt.area_light_to_fixture", icon="LOOP_BACK")
    layout.operator("fipt.set_ies_profile", icon="LIGHT_POINT")


class FIPT_UL_light_states(Rows, bpy.types.UIList):
    """Saved states of all lights"""

    def draw_row(self, context: Context, layout: UILayout, item: PropertyGroup, index: int) -> None:
        row = layout.row(align=True)
        row.prop(item, "name", text="", emboss=False, icon="LIGHT")
        row.operator("fipt.recall_light_state", text="", icon="PLAY", emboss=False).state = item.name


class FIPT_PT_light_states(SubSection, bpy.types.Panel):
    """Save and recall the state of all lights"""

    bl_label = "Light States"
    bl_parent_id = "FIPT_PT_lights"
    bl_order = 1

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.fields()
        settings = context.scene.fipt.lights
        row = layout.row()
        row.template_list("FIPT_UL_light_states", "", settings, "states", settings, "active_state", rows=3)
        column = row.column(align=True)
        column.operator("fipt.save_light_state", text="", icon="ADD")
        column.operator("fipt.remove_light_state", text="", icon="REMOVE")


class FIPT_PT_environment(SubSection, bpy.types.Panel):
    """Light from outside the room"""

    bl_label = "Environment"
    bl_parent_id = "FIPT_PT_lights"
    bl_order = 2

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.scene.fipt.lights.result_world() is not None

    def draw_header(self, context: bpy.types.Context) -> None:
        settings = context.scene.fipt.lights
        self.layout.active = settings.has_environment()
        self.layout.prop(settings, "environment_on", text="")

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.fields()
        settings = context.scene.fipt.lights
        if not settings.has_environment():
            draw_text(layout, context, "The photographs show no light from outside the room.", icon="INFO")
            return
        column = layout.column()
        column.active = settings.environment_on
        column.prop(settings, "environment_factor")
        column.prop(settings, "environment_rotation")


class FIPT_PT_light_output(SubSection, bpy.types.Panel):
    """The list, the unit of light, exposure, other lights, and render passes for each light"""

    bl_label = "Scene and Passes"
    bl_parent_id = "FIPT_PT_lights"
    bl_order = 3

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
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
