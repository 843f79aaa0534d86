# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The guided path: when each section of the tab is shown, and the line of state in its header.

A section is shown as soon as it can be used. What is done, and what few need, is closed at first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import machine
from ..blend.marks import linked_lamps
from ..jobs import running, runstate

_CHARACTER_PIXELS = 6.5  # mean width of the default font at scale 1


class Place(NamedTuple):
    """When a section is shown, and texts of its state, the longest one first; () for none."""

    shown: Callable[[bpy.types.Context], bool]
    state: Callable[[bpy.types.Context], Sequence[str]] = lambda context: ()


def is_shown(section: str, context: bpy.types.Context) -> bool:
    """Whether a section is shown, by its class name; what is not listed is shown with its section."""
    return section not in PLACES or PLACES[section].shown(context)


def state_text(section: str, label: str, buttons: int, context: bpy.types.Context) -> str:
    """The state of a section, as long as the header has room for it.

    Args:
        section: class name of the section.
        label: its label.
        buttons: how many buttons the header has.
    """
    texts = PLACES[section].state(context) if section in PLACES else ()
    if not texts or context.region is None:
        return next(iter(texts), "")
    width = context.region.width / context.preferences.system.ui_scale
    # The triangle and the margins, and each button, in heights of a header (20 pixels).
    units = 2.6 + 1.1 * buttons
    room = (width - units * 20.0) / _CHARACTER_PIXELS - len(iface_(label))
    return next((text for text in texts if len(text) <= room), "")


def has_views(context: bpy.types.Context) -> bool:
    """Whether the scene has a capture."""
    return bool(context.scene.fipt.capture.views)


def has_results(context: bpy.types.Context) -> bool:
    """Whether results are applied to the scene."""
    return bool(context.scene.fipt.materials.object_count)


def has_run(context: bpy.types.Context) -> bool:
    """Whether the scene has a capture, or a run from which one can go on."""
    return has_views(context) or bool(
        context.scene.fipt.run_folder and runstate.known(context.scene.fipt.run_folder).stages
    )


def has_photographs(context: bpy.types.Context) -> bool:
    """Whether the artist has chosen a camera's photographs."""
    return bool(context.scene.fipt.photographs.path)


def needs_start(context: bpy.types.Context) -> bool:
    """Whether there is no engine yet, or nothing to work on."""
    return not machine.has_engine() or not (has_run(context) or has_photographs(context))


def triangle_count(objects: Sequence[bpy.types.Object]) -> int:
    """Number of triangles of meshes, without their modifiers."""
    meshes = [item.data for item in objects]
    return sum(len(mesh.loops) - 2 * len(mesh.polygons) for mesh in meshes)


def _capture_state(context: bpy.types.Context) -> Sequence[str]:
    settings = context.scene.fipt.capture
    views = iface_("{} views").format(len(settings.views))
    job = running.last("capture")
    if job is not None and job.warnings and running.belongs_to(job, context.scene):
        return (f"{views}, {running.count_text(len(job.warnings))}", views)  # it is closed at first
    objects = settings.room_objects(context.scene)
    if not objects:
        return (iface_("{}, no mesh").format(views), views)
    count = triangle_count(objects)
    return (
        iface_("{}, mesh of {:,} triangles").format(views, count),
        iface_("{}, {:,} triangles").format(views, count),
        views,
    )


def _photographs_state(context: bpy.types.Context) -> Sequence[str]:
    settings = context.scene.fipt.photographs
    if settings.registered_count < 0:
        return ()
    return (iface_("{} of {} have a camera").format(settings.registered_count, settings.used_count),)


def _estimate_state(context: bpy.types.Context) -> Sequence[str]:
    state = runstate.known(context.scene.fipt.run_folder)
    return (iface_("finished"),) if state.finished and has_results(context) else ()


def _materials_state(context: bpy.types.Context) -> Sequence[str]:
    settings = context.scene.fipt.materials
    parts = iface_("{} parts").format(len(settings.parts))
    return (iface_("{} objects, {}").format(settings.object_count, parts), parts)


def _lights_state(context: bpy.types.Context) -> Sequence[str]:
    count = sum(light.is_alive() for light in context.scene.fipt.lights.lights)  # as the list shows them
    return (iface_("{} lights").format(count),)


PLACES = {
    "FIPT_PT_start": Place(needs_start),
    "FIPT_PT_photographs": Place(lambda context: has_photographs(context) and not has_views(context)),
    "FIPT_PT_photographs_done": Place(
        lambda context: has_photographs(context) and has_views(context), _photographs_state
    ),
    "FIPT_PT_capture": Place(has_views, _capture_state),
    "FIPT_PT_estimate": Place(has_run, _estimate_state),
    "FIPT_PT_materials": Place(has_results, _materials_state),
    "FIPT_PT_lights": Place(
        lambda context: (
            has_results(context) or bool(context.scene.fipt.lights.lights or linked_lamps(context.scene))
        ),
        _lights_state,
    ),
    "FIPT_PT_check": Place(has_results),
}
