# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What results change of a scene besides its room: exposure, other lights; and all of it taken back."""

from __future__ import annotations

import json
import math

import bpy

from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder, read_json
from ..properties.lights import FIXTURE_LIGHT, NEW_LIGHT
from . import light_state, maps
from .backdrop import clear_view
from .light_groups import remove_light_groups
from .materials import own_materials, remove_unused
from .originals import FIXTURE_SOURCES, own_mesh, restore_original
from .outliner import FIXTURES, find_collection
from .world import restore_world

MUTED = "fipt_muted"  # of a light: whether it was hidden in viewports and renders before


def finish(scene: bpy.types.Scene, run: RunFolder) -> None:
    """Bring the panel's state up to date after `apply_results` and `apply_environment`.

    Args:
        scene: whose settings say what else to change.
        run: whose results were applied.
    """
    settings = scene.fipt.materials
    note_results(scene, run)
    if not settings.kept_before:
        settings.kept_before = json.dumps({"exposure": scene.view_settings.exposure})
    if settings.match_exposure and scene.fipt.lights.median_radiance > 0.0:
        match_exposure(scene)
    if settings.mute_lights:
        mute_other_lights(scene, True)


def note_results(scene: bpy.types.Scene, run: RunFolder) -> None:
    """Let the panel know of the results of a run that are applied, and list its lights."""
    settings = scene.fipt.materials
    room = maps.room_with_results(scene)
    meshes = [mesh for mesh in map(own_mesh, room) if mesh is not None]
    settings.object_count = len(room)
    settings.image_count = len(own_materials(meshes))
    settings.applied_mode = str(read_json(run.atlas_json)["mode"])
    settings.shown = "ESTIMATED"  # shows it too
    scene.fipt.lights.median_radiance = median_radiance(run)
    light_state.list_lights(scene)


def median_radiance(run: RunFolder) -> float:
    """The photographs' median radiance; 0 where the run does not tell."""
    try:
        return float(read_json(run.statistics_json).get("radiance_scale", 0.0))
    except (FiptError, TypeError, ValueError):
        return 0.0


def match_exposure(scene: bpy.types.Scene) -> float:
    """Set the scene's exposure so that the photographs' median is middle grey; returns the stops.

    Raises:
        FiptError: ``radiance-unknown``.
    """
    median = scene.fipt.lights.median_radiance
    if median <= 0.0:
        raise FiptError(
            "radiance-unknown", "How bright the photographs are is not known.", "Apply the results first."
        )
    stops = math.log2(0.18 / median)
    kept = scene.fipt.materials.kept_view
    if kept:  # a map is shown: the exposure comes with the way back
        scene.fipt.materials.kept_view = json.dumps({**json.loads(kept), "exposure": stops})
    else:
        scene.view_settings.exposure = stops
    return stops


def other_lights(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's lights that are none of ours."""
    return [
        item
        for item in scene.objects
        if item.type == "LIGHT" and NEW_LIGHT not in item and FIXTURE_LIGHT not in item
    ]


def mute_other_lights(scene: bpy.types.Scene, on: bool) -> int:
    """Hide the scene's lights that are none of ours, or show them as before; returns their number."""
    changed = 0
    for item in other_lights(scene):
        if on and MUTED not in item and not (item.hide_viewport and item.hide_render):
            item[MUTED] = [item.hide_viewport, item.hide_render]
            item.hide_viewport = item.hide_render = True
            changed += 1
        elif not on and MUTED in item:
            item.hide_viewport, item.hide_render = (bool(value) for value in item[MUTED])
            del item[MUTED]
            changed += 1
    return changed


def shining_outside_groups(scene: bpy.types.Scene) -> list[str]:
    """Names of visible lights that no light group holds."""
    return [item.name for item in other_lights(scene) if not item.lightgroup and not item.hide_render]


def revert(scene: bpy.types.Scene, new_lights: bool = False) -> list[str]:
    """Take everything off a scene that results have brought: it is then as before they were applied.

    Args:
        scene: with results.
        new_lights: remove the lights too that the artist has added with our tools.

    Returns:
        Names of the objects that were changed back.
    """
    settings = scene.fipt.materials
    settings.shown = "ESTIMATED"  # view settings, world and collections are then in their places
    for layer in scene.view_layers:
        remove_light_groups(scene, layer)
    room = maps.room_with_results(scene)
    materials = own_materials(mesh for mesh in map(own_mesh, room) if mesh is not None)
    restored = restore_original(room)
    for item in [item for item in scene.objects if FIXTURE_SOURCES in item]:
        _remove(item)  # a fixture whose own object was deleted or renamed
    if new_lights:
        for item in [item for item in scene.objects if NEW_LIGHT in item]:
            _remove(item)
    remove_unused(materials.values())
    restore_world(scene)
    target = find_collection(scene, FIXTURES)
    if target is not None and not target.all_objects:
        bpy.data.collections.remove(target)
    mute_other_lights(scene, False)
    if settings.kept_before:
        scene.view_settings.exposure = json.loads(settings.kept_before)["exposure"]
    for name in ("object_count", "image_count", "applied_mode", "kept_before", "kept_view"):
        settings.property_unset(name)
    scene.fipt.lights.property_unset("median_radiance")
    maps.restore_solid_views(scene)
    clear_view(scene, False)
    light_state.list_lights(scene)
    return restored


def _remove(item: bpy.types.Object) -> None:
    data = item.data
    bpy.data.objects.remove(item)
    if data is not None and data.users == 0:
        bpy.data.batch_remove([data])
