# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Lights: states of all lights, keyframes, and IES profiles."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy_extras.io_utils import ImportHelper

from ..blend.marks import ANIMATED, NEW_LIGHT, PROFILE, fixture_lights, lights_of
from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from .check import NeedsEstimate
from .job_operator import JobOperator
from .lights import NeedsLights, find_light, light_name_property
from .polls import all_of, needs
from .reporting import reports_errors

if TYPE_CHECKING:
    from ..blend.lights.light_states import LightState
    from ..bridge.sequence import Job

_NAMES = {"PRESENT": "Lights", "PHOTOGRAPHED": "As Photographed", "EVENING": "Evening"}


class FIPT_OT_save_light_state(NeedsLights, bpy.types.Operator):
    """Save the power, color and switch of all lights and of the environment under a name"""

    bl_idname = "fipt.save_light_state"
    bl_label = "Save Light State"
    bl_options = {"REGISTER", "UNDO"}

    kind: bpy.props.EnumProperty(
        name="State",
        description="What is saved",
        items=[
            ("PRESENT", "Present Lights", "All lights as they are now"),
            (
                "PHOTOGRAPHED",
                "As Photographed",
                "All that the photographs show as estimated, your lights off",
            ),
            ("EVENING", "Evening", "The environment off, all lights on at their present power"),
            ("LAMP", "Active Light Only", "The active light of the list alone, at its present power"),
        ],
        options={"SKIP_SAVE"},
    )
    name: bpy.props.StringProperty(
        name="Name",
        description="Name of the state; a state of that name is replaced. If empty, it is chosen",
        options={"SKIP_SAVE"},
    )

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights import light_states
        from ..core.run.parts import free_name

        scene = context.scene
        settings = scene.fipt.lights
        name = self.name
        if self.kind == "LAMP":
            lamp = find_light(scene, "")
            state, own_name = light_states.only(scene, lamp), lamp.name
        else:
            makers = {
                "PRESENT": light_states.present,
                "PHOTOGRAPHED": light_states.as_photographed,
                "EVENING": light_states.evening,
            }
            state, own_name = makers[self.kind](scene), iface_(_NAMES[self.kind])
        entry = settings.states.get(name) if name else None
        if entry is None:
            entry = settings.states.add()
            entry.name = name or free_name(own_name, [each.name for each in settings.states])
        entry.data = light_states.write(state)
        settings.active_state = settings.states.find(entry.name)
        show_thumbnails(scene, RunFolder(bpy.path.abspath(scene.fipt.run_folder)))
        return {"FINISHED"}


def show_thumbnails(scene: bpy.types.Scene, run: RunFolder) -> None:
    """Draw the thumbnails of the states from the lights that were rendered for them, if they were."""
    from ..blend import previews
    from ..blend.pictures.state_pictures import draw_states

    previews.state_pictures.load(draw_states(scene, run))


class FIPT_OT_render_state_thumbnails(NeedsEstimate, JobOperator, bpy.types.Operator):
    bl_idname = "fipt.render_state_thumbnails"
    bl_label = "Render Thumbnails"
    bl_description = (
        "Render what the scene's camera sees by each light alone, small, and show every state as the sum of"
        " its lights. States saved later are shown at once. Render again after a change of camera, room"
        " or places of lights"
    )
    title = "Render Thumbnails"
    kind = "lights"

    def make_job(self, context: bpy.types.Context) -> Job:
        from ..blend.pictures.orders import order_lights
        from ..blend.pictures.render_job import make_job

        run = RunFolder(bpy.path.abspath(context.scene.fipt.run_folder))
        return make_job(order_lights(context.scene, run))

    finished = staticmethod(show_thumbnails)


class _NeedsState:
    """Mix-in of operators on a saved state."""

    state: bpy.props.StringProperty(
        name="State",
        description="Name of the state. If empty, the active state of the list is used",
        options={"SKIP_SAVE"},
    )

    poll = all_of(needs(lambda context: len(context.scene.fipt.lights.states), "Save a light state first"))

    def index(self, scene: bpy.types.Scene) -> int:
        """The state's place in the list.

        Raises:
            FiptError: ``state-missing``.
        """
        settings = scene.fipt.lights
        index = settings.states.find(self.state) if self.state else settings.active_state
        if not 0 <= index < len(settings.states):
            text = f"There is no light state '{self.state}'." if self.state else "No light state is selected."
            raise FiptError("state-missing", text, "Select a state in the list Light States.")
        return int(index)

    def read(self, scene: bpy.types.Scene) -> LightState:
        """The state.

        Raises:
            FiptError: ``state-missing`` or ``state-damaged``.
        """
        from ..blend.lights import light_states

        return light_states.read(scene.fipt.lights.states[self.index(scene)].data)


class FIPT_OT_recall_light_state(_NeedsState, bpy.types.Operator):
    """Give all lights and the environment the power, color and switch of a saved state"""

    bl_idname = "fipt.recall_light_state"
    bl_label = "Recall Light State"
    bl_options = {"REGISTER", "UNDO"}

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights import light_states

        light_states.recall(context.scene, self.read(context.scene))
        return {"FINISHED"}


class FIPT_OT_remove_light_state(_NeedsState, bpy.types.Operator):
    """Remove a saved state. The lights stay as they are"""

    bl_idname = "fipt.remove_light_state"
    bl_label = "Remove Light State"
    bl_options = {"REGISTER", "UNDO"}

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        settings = context.scene.fipt.lights
        index = self.index(context.scene)
        settings.states.remove(index)
        settings.active_state = max(min(index, len(settings.states) - 1), 0)
        return {"FINISHED"}


class FIPT_OT_keyframe_lights(NeedsLights, bpy.types.Operator):
    bl_idname = "fipt.keyframe_lights"
    bl_label = "Keyframe Lights"
    bl_description = (
        "Insert keyframes of the power, color and switch of the active light, or of all lights, on the"
        " current frame. They also work in renders without the extension"
    )
    bl_options = {"REGISTER", "UNDO"}

    light: light_name_property("light")
    everything: bpy.props.BoolProperty(
        name="All Lights", description="All lights of the list", options={"SKIP_SAVE"}
    )

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights.light_drivers import keyframe
        from ..blend.lights.light_state import refresh

        scene = context.scene
        for item in lights_of(scene) if self.everything else [find_light(scene, self.light)]:
            keyframe(item, scene.frame_current)
        refresh(scene)
        return {"FINISHED"}


class FIPT_OT_clear_light_keyframes(NeedsLights, bpy.types.Operator):
    """Remove all keyframes of the light, which stays as it is on the current frame"""

    bl_idname = "fipt.clear_light_keyframes"
    bl_label = "Clear Light Keyframes"
    bl_options = {"REGISTER", "UNDO"}

    light: light_name_property("light")

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights.light_drivers import clear
        from ..blend.lights.light_state import refresh

        item = find_light(context.scene, self.light)
        if ANIMATED not in item:
            raise FiptError("keyframes-missing", f"'{item.name}' has no keyframes.", "Use Keyframe Lights.")
        clear(item)
        refresh(context.scene)
        return {"FINISHED"}


def _blender_lights(scene: bpy.types.Scene, name: str) -> list[bpy.types.Object]:
    """The Blender lights of a row of the list.

    Raises:
        FiptError: ``fixture-missing``; ``fixture-emits`` for a fixture whose surface still emits.
    """
    item = find_light(scene, name)
    lights = [item] if NEW_LIGHT in item and item.type == "LIGHT" else fixture_lights(item)
    if not lights:
        text = f"The surface of '{item.name}' emits by itself."
        raise FiptError("fixture-emits", text, "Use Convert to Blender Light first.")
    return lights


class FIPT_OT_set_ies_profile(NeedsLights, ImportHelper, bpy.types.Operator):
    bl_idname = "fipt.set_ies_profile"
    bl_label = "IES Profile..."
    bl_description = (
        "Let the light send its power into the directions of a lamp's IES profile, along its -Z axis. It"
        " becomes a point light; the profile is stored in the .blend file. Only Cycles renders it"
    )
    bl_options = {"REGISTER", "UNDO"}
    filename_ext = ".ies"

    filter_glob: bpy.props.StringProperty(default="*.ies", options={"HIDDEN"})
    light: light_name_property("light")

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights.ies import read_profile, set_profile
        from ..blend.lights.light_state import refresh

        lights = _blender_lights(context.scene, self.light)
        profile = read_profile(Path(bpy.path.abspath(self.filepath)))
        for light in lights:
            set_profile(light, profile)
        refresh(context.scene)
        return {"FINISHED"}


class FIPT_OT_remove_ies_profile(NeedsLights, bpy.types.Operator):
    """Remove the IES profile of the light and restore its shape"""

    bl_idname = "fipt.remove_ies_profile"
    bl_label = "Remove IES Profile"
    bl_options = {"REGISTER", "UNDO"}

    light: light_name_property("light")

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.lights.ies import remove_profile

        for light in _blender_lights(context.scene, self.light):
            if PROFILE in light:
                remove_profile(light)
        return {"FINISHED"}
