# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Lights: fixtures, new lights, light groups and the environment."""

from __future__ import annotations

from typing import Annotated

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..blend.marks import FIXTURE, has_light_groups
from ..core.run.errors import FiptError
from ..properties.lights import FIPT_Light
from .action import action, note, warning
from .polls import in_object_mode, is_own_room, needs
from .reporting import Messages

LightName = Annotated[str, "Name of the light. If empty, the active light of the list is used"]


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


def find_fixture(scene: bpy.types.Scene, name: str) -> bpy.types.Object:
    """The estimated fixture of that name, or the list's active one for "".

    Raises:
        FiptError: ``fixture-missing``.
    """
    fixture = find_light(scene, name)
    if FIXTURE not in fixture:
        text = f"'{fixture.name}' is not an estimated fixture."
        raise FiptError("fixture-missing", text, "Select a fixture in the list of the section Lights.")
    return fixture


has_lights = needs(
    lambda context: len(context.scene.fipt.lights.lights),
    "There are no lights yet. Use Apply Results, or add a light",
)
own_lights = (has_lights, is_own_room)  # of the operators on the list of lights


@action("Switch All Lights", needs=own_lights)
def switch_lights(scene: bpy.types.Scene, on: Annotated[bool, "Switch the lights on or off"] = True) -> None:
    """Switch all lights of the list and the environment on or off."""
    from ..blend.lights.light_state import switch_all

    switch_all(on, scene)


@action("Update List")
def list_lights(scene: bpy.types.Scene) -> None:
    """Update the list of fixtures and added lights, including appended and duplicated ones."""
    from ..blend.lights import light_state

    light_state.list_lights(scene)


@action("Reset Light", needs=own_lights)
def reset_light(scene: bpy.types.Scene, light: LightName = "") -> None:
    """Reset the light to its estimated power and color."""
    from ..blend.lights.light_state import reset

    reset(scene, find_light(scene, light))


@action("Select Light", needs=(has_lights, in_object_mode))
def select_light(
    context: bpy.types.Context,
    light: LightName = "",
    frame: Annotated[bool, "Bring the light into view"] = True,
) -> None:
    """Select the object of the light and bring it into view."""
    from ..blend.outliner import select_only

    layer = context.view_layer
    item = find_light(context.scene, light)
    if not item.visible_get(view_layer=layer):
        raise FiptError("light-hidden", f"'{item.name}' is hidden.", "Show it in the Outliner.")
    select_only(layer, item)
    if frame and not bpy.app.background and context.area and context.area.type == "VIEW_3D":
        region = next(region for region in context.area.regions if region.type == "WINDOW")
        with context.temp_override(region=region):
            bpy.ops.view3d.view_selected()


@action("Convert to Blender Light", needs=own_lights)
def fixture_to_area_light(scene: bpy.types.Scene, fixture: LightName = "") -> str | Messages:
    """Replace the light of the fixture by Blender lights of the same shape and radiance, which can be edited
    and also work in EEVEE. The fixture itself stays visible.
    """
    from ..blend.lights.convert import fixture_to_lights

    item = find_fixture(scene, fixture)
    lights, exact = fixture_to_lights(scene, item)
    if exact:
        return iface_("Converted to {} Blender lights").format(len(lights))
    text = iface_("The shape of '{}' is approximated by Blender lights; its total power is the same")
    return [warning("lights-approximate", text.format(item.name))]


@action("Convert Back", needs=own_lights)
def area_light_to_fixture(scene: bpy.types.Scene, fixture: LightName = "") -> None:
    """Let the surface of the fixture emit light again, and remove the Blender lights that replaced it."""
    from ..blend.lights.convert import lights_to_fixture

    lights_to_fixture(scene, find_fixture(scene, fixture))


@action(
    "Make Light Groups",
    needs=(
        has_lights,
        needs(
            lambda context: context.scene.render.engine == "CYCLES",
            "Only Cycles renders light groups: press Switch to Cycles first",
        ),
    ),
)
def make_light_groups(context: bpy.types.Context) -> Messages:
    """Create light groups, so that Cycles renders each fixture, the environment and your own lights into
    separate passes that you can mix after rendering: Combined_Ceiling panel and so on.
    """
    from ..blend.lights import light_groups
    from ..blend.results.scene_state import lights_outside_groups

    names = light_groups.make_light_groups(context.scene, context.view_layer)
    messages = [note(iface_("Light groups: {}").format(", ".join(names)))]
    if ungrouped := lights_outside_groups(context.scene):
        text = iface_("Not in any light group, so missing from the sum of the passes: {}")
        messages.append(warning("lights-ungrouped", text.format(", ".join(ungrouped))))
    return messages


@action(
    "Remove Light Groups",
    needs=(
        needs(
            lambda context: has_light_groups(context.view_layer),
            "This view layer has no groups created by Make Light Groups",
        ),
    ),
)
def remove_light_groups(context: bpy.types.Context) -> None:
    """Remove the light groups that Make Light Groups has created. Your own light groups are kept."""
    from ..blend.lights import light_groups

    light_groups.remove_light_groups(context.scene, context.view_layer)


@action(
    "Exposure from Photographs",
    needs=(
        needs(lambda context: context.scene.fipt.lights.median_radiance > 0.0, "Use Apply Results first"),
    ),
)
def match_exposure(scene: bpy.types.Scene) -> str:
    """Set the scene's exposure so that a render is as bright as the photographs."""
    from ..blend.results import scene_state

    return iface_("Exposure is {:+.2f} stops").format(scene_state.match_exposure(scene))


@action("Hide Other Lights")
def hide_other_lights(
    scene: bpy.types.Scene, hide: Annotated[bool, "Hide the lights or show them again"] = True
) -> str:
    """Hide the scene's lights that were neither estimated nor added in the section Lights, or show them
    again.
    """
    from ..blend.results.scene_state import mute_other_lights

    return iface_("{} lights changed").format(mute_other_lights(scene, hide))
