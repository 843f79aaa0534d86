"""Operators of the section Lights: fixtures, their unit, light groups, EEVEE."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..blend.marks import BAKED, FIXTURE, NEW_LIGHT, fixture_lights, has_light_groups, light_probe
from ..core.run.declared import Option
from ..core.run.errors import FiptError, warning
from ..properties.lights import FIPT_Light
from .action import REGISTER, Glob, Messages, action, dialog, file_dialog, note
from .polls import has_results, in_object_mode, is_own_room, needs

LightName = Annotated[str, "Name of the light. If empty, the active light of the list is used"]


def find_light(scene: bpy.types.Scene, name: str) -> bpy.types.Object:
    """The light of that name, or the list's active one for ""."""
    lights = scene.fipt.lights
    row: FIPT_Light | None = lights.active_light()
    if name:
        rows = [light for light in lights.lights if light.is_here()]
        row = next((light for light in rows if name in (light.object.name, light.object.get(FIXTURE))), None)
    if row is None or not row.is_here():
        text = f"There is no light '{name}' in the list." if name else "No light is selected."
        raise FiptError("fixture-missing.find-light", text=text)
    return row.object


def find_fixture(scene: bpy.types.Scene, name: str) -> bpy.types.Object:
    """The estimated fixture of that name, or the list's active one for ""."""
    fixture = find_light(scene, name)
    if FIXTURE not in fixture:
        raise FiptError("fixture-missing.find-fixture", name=fixture.name)
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


@action("Update List", needs=(is_own_room,))
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
        raise FiptError("light-hidden", name=item.name)
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
    return [warning("lights-approximate", name=item.name)]


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
        messages.append(warning("lights-ungrouped", lights=", ".join(ungrouped)))
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


@action("IES Profile...", needs=own_lights, invoke=file_dialog)
def set_ies_profile(
    scene: bpy.types.Scene,
    filepath: Annotated[str, Option("The file of the profile", "File", shown={"subtype": "FILE_PATH"})] = "",
    filter_glob: Glob = "*.ies",
    light: LightName = "",
) -> None:
    """Put the file of a lamp's IES profile into an IES Texture node of the light, which becomes a point and
    shines along its -Z axis. The profile multiplies its power. Only Cycles renders it.
    """
    from ..blend.lights.ies import set_profile

    for each in _blender_lights(scene, light):
        set_profile(each, Path(bpy.path.abspath(filepath)))


def _blender_lights(scene: bpy.types.Scene, name: str) -> list[bpy.types.Object]:
    """The Blender lights of a row of the list."""
    item = find_light(scene, name)
    lights = [item] if NEW_LIGHT in item and item.type == "LIGHT" else fixture_lights(item)
    if not lights:
        raise FiptError("fixture-emits", name=item.name)
    return lights


BY = (
    ("LUMENS", "Lumens of a Lamp", "What the package of the active lamp says; the lamp as it is set now"),
    ("LUX", "Lux at the 3D Cursor", "What a lux meter has shown on a horizontal surface at the 3D cursor"),
)


def _draw(self: Any, context: bpy.types.Context) -> None:
    self.layout.use_property_split = True
    self.layout.prop(self, "by", expand=True)
    self.layout.prop(self, "lumens" if self.by == "LUMENS" else "lux")


@action("Calibrate Light...", needs=(has_lights, is_own_room, in_object_mode), invoke=dialog, draw=_draw)
def calibrate_light(
    scene: bpy.types.Scene,
    by: Annotated[str, Option("What is known", choices=BY)] = "LUMENS",
    lumens: Annotated[
        float, Option("Luminous flux of the lamp", low=0.01, shown={"soft_max": 20000.0})
    ] = 800.0,
    lux: Annotated[
        float, Option("Illuminance at the 3D cursor", low=0.01, shown={"soft_max": 100000.0})
    ] = 300.0,
    light: LightName = "",
) -> str:
    """Type the lumens of one lamp or the lux at one place: all lights and the environment are in watts
    and lumens from then on, as a physical sky and lamps of other files are. Pictures stay as they are.
    """
    from ..blend.lights.calibration import calibrate_by_lamp, calibrate_by_lux

    if by == "LUMENS":
        factor = calibrate_by_lamp(scene, find_light(scene, light), lumens)
    else:
        factor = calibrate_by_lux(scene, tuple(scene.cursor.location), lux)
    return iface_("All light was multiplied by {:.4g}").format(factor)


@action("Set Up for EEVEE", needs=(has_results, in_object_mode))
def prepare_eevee(
    context: bpy.types.Context,
    bake: Annotated[bool, "Bake the light probe volume, which needs a window"] = True,
) -> str | None:
    """Make EEVEE the scene's render engine, convert all fixtures to Blender lights, and add a light probe
    volume of the room's size and bake it.
    """
    from ..blend.lights.eevee import prepare

    inexact = prepare(context.scene)
    if bake and not bpy.app.background:
        _bake(context)
    text = iface_("Lights of another shape than their fixtures: {}")
    return text.format(", ".join(inexact)) if inexact else None


@action(
    "Bake Light Probe",
    needs=(
        needs(lambda context: light_probe(context.scene) is not None, "Use Set Up for EEVEE first"),
        in_object_mode,
    ),
    options=REGISTER,
)
def bake_probe(context: bpy.types.Context) -> None:
    """Bake the light probe volume again, after a change of the lights."""
    if bpy.app.background:
        raise FiptError("window-missing")
    _bake(context)


def _bake(context: bpy.types.Context) -> None:
    """Bake our light probe volume, with Blender's own progress bar."""
    volume = light_probe(context.scene)
    if volume is None:
        return
    context.view_layer.update()  # a new volume
    with context.temp_override(active_object=volume, object=volume):
        bpy.ops.object.lightprobe_cache_bake("INVOKE_DEFAULT", subset="ALL")
    volume[BAKED] = 1
