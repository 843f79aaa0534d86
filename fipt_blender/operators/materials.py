# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Materials: apply the results to the room, show their maps, revert."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..api import applying
from ..core.run.declared import Option
from ..core.run.errors import FiptError
from ..jobs.tasks import Task
from ..properties.materials import SHOWN
from .action import action, file_dialog, note, warning
from .polls import has_results, in_object_mode, is_own_room, needs, no_job
from .reporting import Messages


@action(
    "Apply Results",
    needs=(
        no_job,
        needs(lambda context: context.scene.fipt.run_folder, "Run Estimate first"),
        is_own_room,
        in_object_mode,
    ),
)
def apply_results(scene: bpy.types.Scene) -> Task:
    """Apply the estimated materials and lights to the room. Your own meshes, materials and world are set
    aside; Revert restores them.
    """
    return applying.application()


@action("Show Map", needs=(has_results, in_object_mode), bl_property="shown")
def show_map(
    scene: bpy.types.Scene,
    shown: Annotated[str, Option("What the room shows", "Show", choices=SHOWN)] = "ESTIMATED",
) -> None:
    """Show one of the estimated maps, the estimated materials or the original state on the whole room."""
    scene.fipt.materials.shown = shown


@action("Revert", needs=(has_results, in_object_mode))
def revert(
    scene: bpy.types.Scene,
    new_lights: Annotated[
        bool, Option("Also remove the lights that you added in the section Lights", "Remove New Lights")
    ] = False,
) -> Messages:
    """Remove the results from the room and restore your own meshes, materials and world. The run keeps its
    results, so they can be applied again.
    """
    from ..blend.results import reverting
    from ..blend.room.result_meshes import list_names

    restored, hidden = reverting.revert(scene, new_lights)
    messages = [note(iface_("{} objects restored").format(len(restored)))]
    if hidden:
        text = iface_("Hidden, since the restored meshes hold the faces that were separated: {}")
        messages.insert(0, warning("faces-hidden", text.format(list_names(hidden))))
    return messages


@action("Collect Room", needs=(has_results, no_job, in_object_mode), invoke=file_dialog)
def collect_room(
    scene: bpy.types.Scene,
    directory: Annotated[
        str, Option("Where the copy is saved", "Folder", shown={"subtype": "DIR_PATH"})
    ] = "",
    pack: Annotated[bool, Option("Pack the images into the copy", "One File")] = False,
) -> Messages:
    """Save a copy of the file into a folder of its own, with all images that it uses and the exports beside
    it, or as one packed file. It opens on another machine without this add-on. In a folder that is not empty,
    the folder NAME_collected is made for it.
    """
    from ..blend.export import collecting

    if not directory:
        raise FiptError("export-file", "No folder is chosen.", "Choose a folder.")
    done = collecting.collect_room(Path(bpy.path.abspath(directory)), pack)
    messages = [note(iface_("{} written, with {} files of exports").format(done.path, len(done.exports)))]
    if done.left:
        text = iface_("{} other files stay where they are, the first is {}")
        messages.insert(0, warning("files-left", text.format(len(done.left), done.left[0])))
    return messages


@action("Switch to Cycles")
def use_cycles(scene: bpy.types.Scene) -> None:
    """Make Cycles the scene's render engine. It renders the light of lamps' surfaces, and light groups."""
    from ..blend.render_settings import set_once

    if not set_once(scene, {"render.engine": "CYCLES"}, again=True):
        raise FiptError("cycles-missing", "Cycles is disabled.", "Enable its add-on in the preferences.")
