"""The guided path: conditions under which sections of the tab are shown, and texts of their state.

A section is shown as soon as it can be used. What is done, and what few need, is closed at first.
"""

from __future__ import annotations

from collections.abc import Sequence

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Context

from .. import machine
from ..blend.marks import is_room_linked, linked_lamps
from ..jobs import running, runstate


def has_views(context: Context) -> bool:
    """Whether the scene has a capture."""
    return bool(context.scene.fipt.capture.views)


def has_results(context: Context) -> bool:
    """Whether results are applied to the scene."""
    return bool(context.scene.fipt.materials.object_count)


def has_run(context: Context) -> bool:
    """Whether the scene has a capture, or a run from which one can go on."""
    return has_views(context) or bool(
        context.scene.fipt.run_folder and runstate.known(context.scene.fipt.run_folder).stages
    )


def has_photographs(context: Context) -> bool:
    """Whether the artist has chosen a camera's photographs."""
    return bool(context.scene.fipt.photographs.path)


def has_lights(context: Context) -> bool:
    """Whether the scene has results, lights of the list, or lamps of a linked room."""
    scene = context.scene
    return has_results(context) or bool(scene.fipt.lights.lights or linked_lamps(scene))


def has_own_light(context: Context) -> bool:
    """Whether a light is chosen that may be changed."""
    return context.scene.fipt.lights.active_light() is not None and not is_room_linked(context.scene)


def needs_start(context: Context) -> bool:
    """Whether there is no engine yet, or nothing to work on."""
    return not machine.has_engine() or not (has_run(context) or has_photographs(context))


def triangle_count(objects: Sequence[bpy.types.Object]) -> int:
    """Number of triangles of meshes, without their modifiers."""
    meshes = [item.data for item in objects]
    return sum(len(mesh.loops) - 2 * len(mesh.polygons) for mesh in meshes)


def capture_state(context: Context) -> Sequence[str]:
    """What was imported, or that it has warnings: it is closed at first."""
    settings = context.scene.fipt.capture
    views = iface_("{} views").format(len(settings.views))
    job = running.last("capture")
    if job is not None and job.warnings and running.belongs_to(job, context.scene):
        return (f"{views}, {running.count_text(len(job.warnings))}", views)
    objects = settings.room_objects(context.scene)
    if not objects:
        return (iface_("{}, no mesh").format(views), views)
    count = triangle_count(objects)
    return (
        iface_("{}, mesh of {:,} triangles").format(views, count),
        iface_("{}, {:,} triangles").format(views, count),
        views,
    )


def photographs_state(context: Context) -> Sequence[str]:
    """How many views have a camera."""
    settings = context.scene.fipt.photographs
    if settings.registered_count < 0:
        return ()
    return (iface_("{} of {} have a camera").format(settings.registered_count, settings.used_count),)


def estimate_state(context: Context) -> Sequence[str]:
    """Whether it is done."""
    state = runstate.known(context.scene.fipt.run_folder)
    return (iface_("finished"),) if state.finished and has_results(context) else ()


def materials_state(context: Context) -> Sequence[str]:
    """How much has results."""
    settings = context.scene.fipt.materials
    parts = iface_("{} parts").format(len(settings.parts))
    return (iface_("{} objects, {}").format(settings.object_count, parts), parts)


def lights_state(context: Context) -> Sequence[str]:
    """How many lights there are, as the list shows them."""
    count = sum(light.is_alive() for light in context.scene.fipt.lights.lights)
    return (iface_("{} lights").format(count),)
