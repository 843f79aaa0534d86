# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Lights: fixtures, new lights, light groups and the environment."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..blend.marks import FIXTURE, has_light_groups
from ..core.run.errors import FiptError
from ..properties.lights import FIPT_Light
from .polls import all_of, in_object_mode, is_own_room, needs
from .reporting import reports_errors


def light_name_property(what: str) -> object:
    """The property by which an operator on a light names it."""
    return bpy.props.StringProperty(
        name="Light",
        description=f"Name of the {what}. If empty, the active light of the list is used",
        options={"SKIP_SAVE"},
    )


def find_light(scene: bpy.types.Scene, name: str) -> bpy.types.Object:
    """The light of that name, or the list's active one for "".

    Raises:
        FiptError: ``fixture-missing``.
    """
    lights = scene.fipt.lights
    row: FIPT_Light | None = lights.active_light()
    if name:
        rows = [light for light in lights.lights if light.is_here()]
        row = next((light for light in rows if name in (light.object.name, light.object.get(FIXTURE))), None)
    if row is None or not row.is_here():
        text = f"There is no light '{name}' in the list." if name else "No light is selected."
        raise FiptError("fixture-missing", text, "Select a light in the list of the section Lights.")
    return row.object


has_lights = needs(
    lambda context: len(context.scene.fipt.lights.lights),
    "There are no lights yet. Use Apply Results, or add a light",
)


class NeedsLights:
    """Mix-in of operators on the list of lights."""

    poll = all_of(has_lights, is_own_room)


class FIPT_OT_switch_lights(NeedsLights, bpy.types.Operator):
    """Switch all lights of the list and the environment on or off"""

    bl_idname = "fipt.switch_lights"
    bl_label = "Switch All Lights"
    bl_options = {"REGISTER", "UNDO"}

    on: bpy.props.BoolProperty(name="On", description="Switch the lights on or off", default=True)

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights.light_state import switch_all

        switch_all(self.on, context.scene)
        return {"FINISHED"}


class FIPT_OT_list_lights(bpy.types.Operator):
    """Update the list of fixtures and added lights, including appended and duplicated ones"""

    bl_idname = "fipt.list_lights"
    bl_label = "Update List"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights.light_state import list_lights

        list_lights(context.scene)
        return {"FINISHED"}


class FIPT_OT_reset_light(NeedsLights, bpy.types.Operator):
    """Reset the light to its estimated power and color"""

    bl_idname = "fipt.reset_light"
    bl_label = "Reset Light"
    bl_options = {"REGISTER", "UNDO"}

    light: light_name_property("light")

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights.light_state import reset

        reset(context.scene, find_light(context.scene, self.light))
        return {"FINISHED"}


class FIPT_OT_select_light(NeedsLights, bpy.types.Operator):
    """Select the object of the light and bring it into view"""

    bl_idname = "fipt.select_light"
    bl_label = "Select Light"
    bl_options = {"REGISTER", "UNDO"}

    light: light_name_property("light")
    frame: bpy.props.BoolProperty(name="Frame", description="Bring the light into view", default=True)

    poll = all_of(has_lights, in_object_mode)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.outliner import select_only

        layer = context.view_layer
        light = find_light(context.scene, self.light)
        if not light.visible_get(view_layer=layer):
            raise FiptError("light-hidden", f"'{light.name}' is hidden.", "Show it in the Outliner.")
        select_only(layer, light)
        if self.frame and not bpy.app.background and context.area and context.area.type == "VIEW_3D":
            region = next(region for region in context.area.regions if region.type == "WINDOW")
            with context.temp_override(region=region):
                bpy.ops.view3d.view_selected()
        return {"FINISHED"}


class _OnFixture(NeedsLights):
    """Mix-in of operators on one fixture."""

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        fixture = find_light(context.scene, self.fixture)  # type: ignore[attr-defined]
        if FIXTURE not in fixture:
            raise FiptError(
                "fixture-missing",
                f"'{fixture.name}' is not an estimated fixture.",
                "Select a fixture in the list of the section Lights.",
            )
        self.convert(context, fixture)
        return {"FINISHED"}

    def convert(self, context: bpy.types.Context, fixture: bpy.types.Object) -> None:
        """Convert the fixture.

        Raises:
            FiptError: it can't be converted.
        """
        raise NotImplementedError


class FIPT_OT_fixture_to_area_light(_OnFixture, bpy.types.Operator):
    bl_idname = "fipt.fixture_to_area_light"
    bl_label = "Convert to Blender Light"
    bl_description = (
        "Replace the light of the fixture by Blender lights of the same shape and radiance, which can"
        " be edited and also work in EEVEE. The fixture itself stays visible"
    )
    bl_options = {"REGISTER", "UNDO"}

    fixture: light_name_property("fixture")

    def convert(self, context: bpy.types.Context, fixture: bpy.types.Object) -> None:
        from ..blend.lights.convert import fixture_to_lights

        lights, exact = fixture_to_lights(context.scene, fixture)
        if exact:
            self.report({"INFO"}, iface_("Converted to {} Blender lights").format(len(lights)))
        else:
            text = iface_("The shape of '{}' is approximated by Blender lights; its total power is the same")
            self.report({"WARNING"}, text.format(fixture.name))


class FIPT_OT_area_light_to_fixture(_OnFixture, bpy.types.Operator):
    """Let the surface of the fixture emit light again, and remove the Blender lights that replaced it"""

    bl_idname = "fipt.area_light_to_fixture"
    bl_label = "Convert Back"
    bl_options = {"REGISTER", "UNDO"}

    fixture: light_name_property("fixture")

    def convert(self, context: bpy.types.Context, fixture: bpy.types.Object) -> None:
        from ..blend.lights.convert import lights_to_fixture

        lights_to_fixture(context.scene, fixture)


class FIPT_OT_make_light_groups(NeedsLights, bpy.types.Operator):
    bl_idname = "fipt.make_light_groups"
    bl_label = "Make Light Groups"
    bl_description = (
        "Create light groups, so that Cycles renders each fixture, the environment and your own lights"
        " into separate passes that you can mix after rendering: Combined_Ceiling panel and so on"
    )
    bl_options = {"REGISTER", "UNDO"}

    poll = all_of(
        has_lights,
        needs(
            lambda context: context.scene.render.engine == "CYCLES",
            "Only Cycles renders light groups: press Switch to Cycles first",
        ),
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights.light_groups import make_light_groups
        from ..blend.results.scene_state import lights_outside_groups

        names = make_light_groups(context.scene, context.view_layer)
        self.report({"INFO"}, iface_("Light groups: {}").format(", ".join(names)))
        ungrouped = lights_outside_groups(context.scene)
        if ungrouped:
            text = iface_("Not in any light group, so missing from the sum of the passes: {}")
            self.report({"WARNING"}, text.format(", ".join(ungrouped)))
        return {"FINISHED"}


class FIPT_OT_remove_light_groups(bpy.types.Operator):
    """Remove the light groups that Make Light Groups has created. Your own light groups are kept"""

    bl_idname = "fipt.remove_light_groups"
    bl_label = "Remove Light Groups"
    bl_options = {"REGISTER", "UNDO"}

    poll = all_of(
        needs(
            lambda context: has_light_groups(context.view_layer),
            "This view layer has no groups created by Make Light Groups",
        )
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights.light_groups import remove_light_groups

        remove_light_groups(context.scene, context.view_layer)
        return {"FINISHED"}


class FIPT_OT_match_exposure(bpy.types.Operator):
    """Set the scene's exposure so that a render is as bright as the photographs"""

    bl_idname = "fipt.match_exposure"
    bl_label = "Exposure from Photographs"
    bl_options = {"REGISTER", "UNDO"}

    poll = all_of(
        needs(lambda context: context.scene.fipt.lights.median_radiance > 0.0, "Use Apply Results first")
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.results.scene_state import match_exposure

        stops = match_exposure(context.scene)
        self.report({"INFO"}, iface_("Exposure is {:+.2f} stops").format(stops))
        return {"FINISHED"}


class FIPT_OT_hide_other_lights(bpy.types.Operator):
    bl_idname = "fipt.hide_other_lights"
    bl_label = "Hide Other Lights"
    bl_description = (
        "Hide the scene's lights that were neither estimated nor added in the section Lights, or show"
        " them again"
    )
    bl_options = {"REGISTER", "UNDO"}

    hide: bpy.props.BoolProperty(name="Hide", description="Hide the lights or show them again", default=True)

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.results.scene_state import mute_other_lights

        count = mute_other_lights(context.scene, self.hide)
        self.report({"INFO"}, iface_("{} lights changed").format(count))
        return {"FINISHED"}
