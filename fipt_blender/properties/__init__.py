# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel's state, kept with the scene: `scene.fipt`, one group a section.

Each module lists its classes in CLASSES, members before their groups. bpy and light modules only:
this is imported while Blender starts.
"""

from __future__ import annotations

import bpy

from . import capture, check, estimate, insert, lights, materials, parts

_MODULES = (capture, parts, estimate, materials, lights, insert, check)


class FIPT_SceneSettings(bpy.types.PropertyGroup):
    """Everything that the side panel remembers of a scene."""

    run_folder: bpy.props.StringProperty(
        name="Run Folder",
        description="Where the engine's work on this scene lies: checkpoints, results, textures and renders",
        subtype="DIR_PATH",
    )
    capture: bpy.props.PointerProperty(type=capture.FIPT_CaptureSettings)
    parts: bpy.props.PointerProperty(type=parts.FIPT_PartsSettings)
    estimate: bpy.props.PointerProperty(type=estimate.FIPT_EstimateSettings)
    materials: bpy.props.PointerProperty(type=materials.FIPT_MaterialsSettings)
    lights: bpy.props.PointerProperty(type=lights.FIPT_LightsSettings)
    insert: bpy.props.PointerProperty(type=insert.FIPT_InsertSettings)
    check: bpy.props.PointerProperty(type=check.FIPT_CheckSettings)


_register_classes, _unregister_classes = bpy.utils.register_classes_factory(
    [*(each for module in _MODULES for each in module.CLASSES), FIPT_SceneSettings]
)


def register() -> None:
    """Register the groups and `Scene.fipt`."""
    _register_classes()
    bpy.types.Scene.fipt = bpy.props.PointerProperty(type=FIPT_SceneSettings)


def unregister() -> None:
    """Take them back; what scenes hold stays in their files."""
    del bpy.types.Scene.fipt
    _unregister_classes()
