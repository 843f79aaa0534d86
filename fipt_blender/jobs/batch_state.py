# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The side panel's state in the .blend of a batch job, where the add-on may not be enabled."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import bpy

from .. import properties
from ..core.capture.options import CaptureOptions
from ..core.run.runfolder import RunFolder
from ..core.run.settings import make_settings
from ..core.run.stage_settings import TextureSettings
from ..properties.declared import fill
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


def show_options(scene: bpy.types.Scene, options: MainJobOptions, run: RunFolder) -> None:
    """Set the panel's state to a job's options, as far as the panel has them.

    Args:
        scene: inside `panel_state`.
        options: the job's options.
        run: its run folder.
    """
    state, settings = scene.fipt, options.settings
    state.run_folder = str(run.root)
    state.capture.path = str(capture_source(options.capture.absolute()))
    fill(state.capture, CaptureOptions, vars(options))
    state.parts.source = options.parts
    estimate, materials = state.estimate, state.materials
    estimate.preset = settings.preset
    preset = make_settings(settings.preset)
    for name, (of, *_) in properties.estimate.CHOICES.items():
        value = getattr(settings, of)
        if value != getattr(preset, of):
            setattr(estimate, name, value)
    if settings.device != "auto":
        estimate.device = settings.device
    fill(materials, TextureSettings, {**vars(settings), "texture_size": materials.texture_size})
    sizes = materials.bl_rna.properties["texture_size"].enum_items.keys()
    materials.texture_size = min(sizes, key=lambda size: abs(int(size) - settings.texture_size))
