"""Reverting a scene to what it was before results were applied."""

from __future__ import annotations

import bpy

from ..capture.backdrop import set_backdrop, show_photographs
from ..lights import light_state
from ..lights.calibration import scale_light, scene_unit
from ..lights.light_groups import remove_light_groups
from ..lights.world import restore_world
from ..marks import UNIT, UNPLACED, added_lights, is_split_off, light_probe, remove_marks, room_with_results
from ..outliner import FIXTURES, remove_if_empty, remove_object
from ..render_settings import restore
from ..room.originals import restore_original, result_meshes, separated
from .emptying import bring_back
from .maps import restore_solid_views
from .materials import remove_unused, result_materials
from .scene_state import mute_other_lights


def revert(scene: bpy.types.Scene, new_lights: bool = False) -> tuple[list[str], list[str]]:
    """Remove everything from a scene that results have brought.

    Args:
        scene: the scene with results.
        new_lights: also remove the lights that the artist has added with our tools.

    Returns:
        Names of the objects that were restored, and of those that are hidden now: the artist has separated
        them from others, whose original meshes hold the same faces.
    """
    settings = scene.fipt.materials
    settings.shown = "ESTIMATED"  # restores view settings, world and collections
    set_backdrop(scene, "ROOM", ())
    bring_back(scene)
    for layer in scene.view_layers:
        remove_light_groups(scene, layer)
    room = room_with_results(scene)
    materials = result_materials(result_meshes(room))
    hidden = [item.name for item in separated(room)]
    restored = restore_original(scene, room)
    probe = light_probe(scene)
    if probe is not None:
        remove_object(probe)
    # Fixtures can be left over whose source objects were deleted or renamed.
    for item in [item for item in scene.objects if is_split_off(item)]:
        remove_object(item)
    if new_lights:
        for item in added_lights(scene):
            remove_object(item)
    remove_unused(materials)
    restore_world(scene)
    remove_if_empty(scene, FIXTURES)
    mute_other_lights(scene, False)
    restore(scene)
    settings.parts.clear()
    for name in ("active_part", "object_count", "image_count", "applied_mode", "kept_view"):
        settings.property_unset(name)
    if UNIT in scene:
        scale_light(scene, 1.0 / scene_unit(scene))
        remove_marks(scene, UNIT)
    remove_marks(scene, UNPLACED)
    for view in scene.fipt.capture.views:
        view.property_unset("exposure")
    scene.fipt.capture.property_unset("shown_exposure")
    for name in ("median_radiance", "median_shown"):
        scene.fipt.lights.property_unset(name)
    restore_solid_views(scene)
    show_photographs(scene)
    light_state.list_lights(scene)
    return restored, hidden
