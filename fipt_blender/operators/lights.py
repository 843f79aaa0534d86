# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Lights: fixtures, new lights, light groups and the environment."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.job.errors import FiptError
from ..properties.lights import FIXTURE, FIPT_Light
from .new_light import FIPT_OT_add_light
from .polls import has_results


def _name_property(what: str) -> object:
    return bpy.props.StringProperty(
        name="Light", description=f"Name of the {what}; the list's chosen one if empty", options={"SKIP_SAVE"}
    )


def _chosen(scene: bpy.types.Scene, name: str) -> bpy.types.Object:
    """The light of that name, or the list's chosen one.

    Raises:
        FiptError: ``fixture-missing``.
    """
    lights = scene.fipt.lights
    row: FIPT_Light | None = lights.active_light()
    if name:
        rows = [each for each in lights.lights if each.is_here()]
        row = next((each for each in rows if name in (each.object.name, each.object.get(FIXTURE))), None)
    if row is None or not row.is_here():
        text = f"There is no light '{name}' in the list." if name else "No light is chosen."
        raise FiptError("fixture-missing", text, "Choose a light of the list.")
    return row.object


class _NeedsLights:
    """Mix-in of operators on the list of lights."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not len(context.scene.fipt.lights.lights):
            cls.poll_message_set("There are no lights yet: apply results, or add a light")  # type: ignore[attr-defined]
            return False
        return True


class FIPT_OT_switch_lights(bpy.types.Operator):
    """Switch all estimated lights, the environment too. Lights that you added stay as they are"""

    bl_idname = "fipt.switch_lights"
    bl_label = "Switch Estimated Lights"
    bl_options = {"REGISTER", "UNDO"}

    on: bpy.props.BoolProperty(name="On", description="Switch them on or off", default=True)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_results(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights import set_estimated_lights

        set_estimated_lights(self.on, context.scene)
        return {"FINISHED"}


class FIPT_OT_list_lights(bpy.types.Operator):
    """List the scene's fixtures and added lights anew, also those that were appended or duplicated"""

    bl_idname = "fipt.list_lights"
    bl_label = "Update List"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.light_state import list_lights

        list_lights(context.scene)
        return {"FINISHED"}


class FIPT_OT_reset_light(_NeedsLights, bpy.types.Operator):
    """Bring a light back to its estimated power and colour"""

    bl_idname = "fipt.reset_light"
    bl_label = "Reset Light"
    bl_options = {"REGISTER", "UNDO"}

    light: _name_property("light")

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.light_state import reset

        try:
            reset(context.scene, _chosen(context.scene, self.light))
        except FiptError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class FIPT_OT_select_light(_NeedsLights, bpy.types.Operator):
    """Select the light, and bring it into view"""

    bl_idname = "fipt.select_light"
    bl_label = "Select Light"
    bl_options = {"REGISTER", "UNDO"}

    light: _name_property("light")
    frame: bpy.props.BoolProperty(name="Frame", description="Bring it into view", default=True)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not super().poll(context):
            return False
        if context.mode != "OBJECT":
            cls.poll_message_set("Switch to object mode first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.outliner import select_only

        layer = context.view_layer
        try:
            item = _chosen(context.scene, self.light)
            if not item.visible_get(view_layer=layer):
                raise FiptError("light-hidden", f"'{item.name}' is hidden.", "Show it in the Outliner.")
        except FiptError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        select_only(layer, item)
        if self.frame and not bpy.app.background and context.area and context.area.type == "VIEW_3D":
            region = next(each for each in context.area.regions if each.type == "WINDOW")
            with context.temp_override(region=region):
                bpy.ops.view3d.view_selected()
        return {"FINISHED"}


class _OnFixture(_NeedsLights):
    """Mix-in of operators on one fixture."""

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            item = _chosen(context.scene, self.fixture)  # type: ignore[attr-defined]
            if FIXTURE not in item:
                raise FiptError(
                    "fixture-missing", f"'{item.name}' is no fixture.", "Choose a fixture of the list."
                )
            self.work(context, item)
        except FiptError as error:
            self.report({"ERROR"}, str(error))  # type: ignore[attr-defined]
            return {"CANCELLED"}
        return {"FINISHED"}

    def work(self, context: bpy.types.Context, item: bpy.types.Object) -> None:
        """What the operator does with a fixture."""
        raise NotImplementedError


class FIPT_OT_fixture_to_area_light(_OnFixture, bpy.types.Operator):
    """Let Blender lights of the same shape and radiance give the fixture's light. They can be aimed and
    shaped, and light the room in EEVEE too; the fixture itself stays visible"""

    bl_idname = "fipt.fixture_to_area_light"
    bl_label = "Convert to Blender Light"
    bl_options = {"REGISTER", "UNDO"}

    fixture: _name_property("fixture")

    def work(self, context: bpy.types.Context, item: bpy.types.Object) -> None:
        from ..blend.convert import fixture_to_lights

        lights, exact = fixture_to_lights(context.scene, item)
        if not exact:
            text = iface_("'{}' is neither flat and plain nor a ball: power is the same, its shape nearly")
            self.report({"WARNING"}, text.format(item.name))
        else:
            self.report({"INFO"}, iface_("{} lights give the same light").format(len(lights)))


class FIPT_OT_area_light_to_fixture(_OnFixture, bpy.types.Operator):
    """Let the fixture's own surface give its light again, and remove the Blender lights made of it"""

    bl_idname = "fipt.area_light_to_fixture"
    bl_label = "Convert Back"
    bl_options = {"REGISTER", "UNDO"}

    fixture: _name_property("fixture")

    def work(self, context: bpy.types.Context, item: bpy.types.Object) -> None:
        from ..blend.convert import lights_to_fixture

        lights_to_fixture(context.scene, item)


class FIPT_OT_make_light_groups(_NeedsLights, bpy.types.Operator):
    """Let Cycles render each fixture, the environment and your own lights into passes of their own, so that
    they can be mixed after rendering: Combined_Fixture_001 and so on"""

    bl_idname = "fipt.make_light_groups"
    bl_label = "Make Light Groups"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.applied import shining_outside_groups
        from ..blend.light_groups import make_light_groups

        names = make_light_groups(context.scene, context.view_layer)
        self.report({"INFO"}, iface_("Light groups: {}").format(", ".join(names)))
        others = shining_outside_groups(context.scene)
        if others:
            text = iface_("In no group, and so missing in the sum of the passes: {}")
            self.report({"WARNING"}, text.format(", ".join(others)))
        return {"FINISHED"}


class FIPT_OT_remove_light_groups(bpy.types.Operator):
    """Remove the light groups that Make Light Groups has made; your own ones stay"""

    bl_idname = "fipt.remove_light_groups"
    bl_label = "Remove Light Groups"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if "fipt_light_groups" not in context.view_layer:
            cls.poll_message_set("There are no light groups of ours in this view layer")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.light_groups import remove_light_groups

        remove_light_groups(context.scene, context.view_layer)
        return {"FINISHED"}


class FIPT_OT_match_exposure(bpy.types.Operator):
    """Set the scene's exposure so that the photographs' median is middle grey"""

    bl_idname = "fipt.match_exposure"
    bl_label = "Exposure from Photographs"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.scene.fipt.lights.median_radiance <= 0.0:
            cls.poll_message_set("Apply results first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.applied import match_exposure

        stops = match_exposure(context.scene)
        self.report({"INFO"}, iface_("Exposure is {:+.2f} stops").format(stops))
        return {"FINISHED"}


class FIPT_OT_hide_other_lights(bpy.types.Operator):
    """Hide the scene's lights that are neither estimated nor added here, or show them as they were before"""

    bl_idname = "fipt.hide_other_lights"
    bl_label = "Hide Other Lights"
    bl_options = {"REGISTER", "UNDO"}

    hide: bpy.props.BoolProperty(name="Hide", description="Hide them, or show them again", default=True)

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.applied import mute_other_lights

        count = mute_other_lights(context.scene, self.hide)
        self.report({"INFO"}, iface_("{} lights changed").format(count))
        return {"FINISHED"}


CLASSES = (
    FIPT_OT_switch_lights,
    FIPT_OT_list_lights,
    FIPT_OT_reset_light,
    FIPT_OT_select_light,
    FIPT_OT_add_light,
    FIPT_OT_fixture_to_area_light,
    FIPT_OT_area_light_to_fixture,
    FIPT_OT_make_light_groups,
    FIPT_OT_remove_light_groups,
    FIPT_OT_match_exposure,
    FIPT_OT_hide_other_lights,
)
