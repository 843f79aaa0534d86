"""What results change of a scene besides its room: panel, exposure, engine, other lights."""

from __future__ import annotations

import json
import math

import bpy

from ...core.run.documents import optional_document, read_document
from ...core.run.errors import FiptError
from ...core.run.result_contents import AtlasImages, QualityNote
from ...core.run.runfolder import RunFolder
from ...core.run.versions import results_id
from ..capture.backdrop import set_backdrop
from ..capture.look import cull_outside, enter_room
from ..lights import light_state
from ..lights.calibration import scene_unit
from ..lights.missing_lamps import add_inferred
from ..marks import MUTED, VIEW, other_lights, remove_marks, room_with_results
from ..render_settings import follow_exposure, set_once, set_up
from .part_list import note_parts

MIDDLE_GREY = 0.18


def finish(scene: bpy.types.Scene, run: RunFolder) -> None:
    """Bring the panel's state up to date after `apply_results` and `apply_environment`.

    Args:
        scene: the scene with results; its settings say what else to change.
        run: the run whose results were applied.
    """
    settings = scene.fipt.materials
    is_first = not settings.object_count
    note_results(scene, run)
    if settings.set_rendering and "view_settings.exposure" in set_up(scene, photographs_exposure(scene)):
        scene.fipt.capture.shown_exposure = 0.0
    looked_through = scene.camera.get(VIEW, "") if scene.camera else ""
    follow_exposure(scene, photograph_exposures(run).get(looked_through, 0.0))
    if settings.mute_lights and is_first:  # lights that the artist adds later are to be seen
        mute_other_lights(scene, True)
    if scene.fipt.insert.backdrop == "PHOTOGRAPH":  # the new fixtures are part of it
        set_backdrop(scene, "PHOTOGRAPH", scene.fipt.capture.room_objects(scene))
    cull_outside(scene)
    if is_first and not bpy.app.background:
        enter_room(bpy.context, scene)


def note_results(scene: bpy.types.Scene, run: RunFolder) -> None:
    """Fill the panel with what results of a run were applied, and list the scene's lights."""
    settings = scene.fipt.materials
    room = room_with_results(scene)
    settings.object_count = len(room)
    atlas = read_document(run.atlas_json, AtlasImages, "Apply the results again.")
    settings.image_count, settings.applied_mode = len(atlas.images), atlas.mode
    settings.applied_version = results_id(run)
    settings.shown = "ESTIMATED"  # its update function shows them
    scene.fipt.lights.median_radiance = median_radiance(run)
    scene.fipt.lights.median_shown = median_shown(run)
    exposures = photograph_exposures(run)
    for view in scene.fipt.capture.views:
        view.exposure = exposures.get(view.name, 0.0)
    add_inferred(scene, run)
    note_parts(scene, run)
    light_state.list_lights(scene)


def photograph_exposures(run: RunFolder) -> dict[str, float]:
    """Of photographs that are not HDR: their exposures after that of the median one, stops, by view."""
    views = (run.statistics().get("photometry") or {}).get("views", {})
    found = {name: float(view.get("shown_ev", 0.0)) for name, view in views.items()}
    held_back = optional_document(run.quality_json, QualityNote)
    return found if held_back is None else {**found, **held_back.exposures}


def median_radiance(run: RunFolder) -> float:
    """The photographs' median radiance; 0 where the run does not record it."""
    return float(run.statistics().get("radiance_scale", 0.0))


def median_shown(run: RunFolder) -> float:
    """The value between black and white at which the photographs show their median radiance.

    Photographs that are not HDR have one; HDR photographs are shown with their median at middle grey.
    """
    shown = run.statistics().get("photometry", {}).get("median_shown")
    return shown if shown and 0.0 < shown < 1.0 else MIDDLE_GREY


def photographs_exposure(scene: bpy.types.Scene) -> float | None:
    """The stops with which a render is as bright as the photographs; None where that is not known."""
    median = scene.fipt.lights.median_radiance
    if scene.render.engine != "CYCLES":  # only its film has an exposure, which the calibration has set
        median *= scene_unit(scene)
    return math.log2(scene.fipt.lights.median_shown / median) if median > 0.0 else None


def match_exposure(scene: bpy.types.Scene) -> float:
    """Set the scene's exposure so that a render is as bright as the photographs; returns the stops."""
    stops = photographs_exposure(scene)
    if stops is None:
        raise FiptError("radiance-unknown")
    kept = scene.fipt.materials.kept_view
    if kept:  # while a map is shown: the exposure is set when the scene's view settings come back
        scene.fipt.materials.kept_view = json.dumps({**json.loads(kept), "exposure": stops})
    else:
        shown = scene.fipt.capture.shown_exposure
        set_once(scene, {"view_settings.exposure": stops + shown}, again=True)
    return stops


def mute_other_lights(scene: bpy.types.Scene, on: bool) -> int:
    """Hide the scene's lights that are not ours, or show them as before; returns how many changed."""
    changed = 0
    for item in other_lights(scene):
        if on and MUTED not in item and not (item.hide_viewport and item.hide_render):
            item[MUTED] = [item.hide_viewport, item.hide_render]
            item.hide_viewport = item.hide_render = True
            changed += 1
        elif not on and MUTED in item:
            item.hide_viewport, item.hide_render = (bool(value) for value in item[MUTED])
            remove_marks(item, MUTED)
            changed += 1
    return changed


def lights_outside_groups(scene: bpy.types.Scene) -> list[str]:
    """Names of visible lights that no light group holds."""
    return [item.name for item in other_lights(scene) if not item.lightgroup and not item.hide_render]
