"""Conditions that operators poll; each sets the message that explains a disabled button."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..blend.marks import is_room_linked
from ..jobs import running, runstate

Condition = Callable[[Any, bpy.types.Context], bool]


def needs(test: Callable[[bpy.types.Context], object], message: str) -> Condition:
    """The condition that a test holds, and what a disabled button says where it does not."""

    def holds(cls: Any, context: bpy.types.Context) -> bool:
        if not test(context):
            cls.poll_message_set(message)
            return False
        return True

    return holds


def all_of(*conditions: Condition) -> Any:
    """The `poll` of an operator: all conditions hold; the first that does not says why."""

    def poll(cls: Any, context: bpy.types.Context) -> bool:
        return all(condition(cls, context) for condition in conditions)

    return classmethod(poll)


def no_job(cls: Any, context: bpy.types.Context) -> bool:
    """No job is running."""
    job = running.current()
    text = "{} is running. Wait for its end, or stop it with Esc"
    return job is None or needs(lambda _: False, iface_(text).format(iface_(job.title)))(cls, context)


def run_state(context: bpy.types.Context) -> runstate.RunState:
    """What the scene's run folder holds."""
    return runstate.known(context.scene.fipt.run_folder)


in_object_mode = needs(lambda context: context.mode == "OBJECT", "Switch to Object Mode first")
# The contents of the run folder are checked when the operator runs.
has_run = needs(lambda context: context.scene.fipt.run_folder, "Import a capture and run Estimate first")
has_views = needs(lambda context: context.scene.fipt.capture.views, "Import a capture first")
has_meshes = needs(
    lambda context: context.scene.fipt.capture.room_objects(context.scene), "The room has no meshes"
)
# What is changed of another file's data would be lost without a word.
is_own_room = needs(
    lambda context: not is_room_linked(context.scene),
    "The room is linked from another file. Open that file, or use Object > Relations > Make Local",
)
views_checked = needs(lambda context: context.scene.fipt.capture.unseen_share >= 0.0, "Use Check Views first")


def has_results(cls: Any, context: bpy.types.Context) -> bool:
    """The scene has results of its own."""
    applied = needs(lambda context: context.scene.fipt.materials.object_count, "Use Apply Results first")
    return is_own_room(cls, context) and applied(cls, context)


# A room comes into a scene of its own.
has_no_capture = needs(
    lambda context: not context.scene.fipt.capture.views, "The scene has a capture already. Use a new scene"
)


def over_sidebar(context: bpy.types.Context) -> bool:
    """The pointer drops files on the 3D Viewport's sidebar; elsewhere there, Blender takes dropped images."""
    area, region = context.area, context.region
    return area is not None and area.type == "VIEW_3D" and region is not None and region.type == "UI"
