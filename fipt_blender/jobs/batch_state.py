# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The side panel's state in the .blend of a batch job, where the add-on may not be enabled."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import bpy

from .. import properties
from ..blend.capture.importing import fill_views
from ..blend.results.scene_state import note_results
from ..core.run.runfolder import RunFolder
from ..core.run.settings import make_settings
from .options import capture_source

if TYPE_CHECKING:
    from .options import MainJobOptions


@contextmanager
def panel_state() -> Iterator[None]:
    """Register the panel's state for a while; values set in that time are saved with the file."""
    if hasattr(bpy.types.Scene, "fipt"):
        yield
        return
    properties.register()
    try:
        yield
    finally:
        properties.unregister()


def remember_run(scene: bpy.types.Scene, options: MainJobOptions, run: RunFolder) -> None:
    """Fill the panel: the capture and its views, the settings, the results and the lights.

    Args:
        scene: with the capture's cameras and with applied results; inside `panel_state`.
        options: the job's options.
        run: its run folder.
    """
    state = scene.fipt
    state.run_folder = str(run.root)
    state.capture.path = state.capture.imported_path = str(capture_source(options.capture.absolute()))
    state.capture.format, state.capture.up_axis = options.format, options.up_axis
    state.capture.scale = options.scale
    state.capture.mesh = "" if options.mesh is None else str(options.mesh.absolute())
    state.capture.images = "" if options.images is None else str(options.images.absolute())
    state.capture.layer = options.layer
    if options.hold_back is not None:
        state.capture.hold_back = options.hold_back
    state.capture.clamp_negative = options.clamp_negative
    state.capture.triangles = options.triangles
    state.capture.undo_applied_transform = options.undo_applied_transform
    state.capture.panorama = "" if options.panorama is None else str(options.panorama.absolute())
    state.capture.panorama_place = options.panorama_place
    state.capture.panorama_heading = math.radians(options.panorama_heading)
    fill_views(scene, run)
    state.parts.source = options.parts
    _remember_settings(state, options)
    note_results(scene, run)


def _remember_settings(state: bpy.types.PropertyGroup, options: MainJobOptions) -> None:
    """The preset and the changed settings, as far as the panel has them."""
    settings, estimate, materials = options.settings, state.estimate, state.materials
    estimate.preset = settings.preset
    preset = make_settings(settings.preset)
    for name, choice in properties.estimate.CHOICES.items():
        value = getattr(settings, choice.fields[0])
        if value != getattr(preset, choice.fields[0]):
            setattr(estimate, name, value)
    if settings.device != "auto":
        estimate.device = settings.device
    materials.atlas_mode, materials.atlas_images = settings.atlas_mode, settings.atlas_images
    materials.write_back = settings.write_back
    materials.texel_density, materials.clean_mesh = settings.texel_density, settings.clean_mesh
    sizes = materials.bl_rna.properties["texture_size"].enum_items.keys()
    materials.texture_size = min(sizes, key=lambda size: abs(int(size) - settings.texture_size))
