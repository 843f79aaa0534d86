"""The panel's state, stored in the scene: `scene.fipt`, one group per section.

Members stand before their groups. The modules import bpy and light modules only: they are imported while
Blender starts.
"""

from __future__ import annotations

from collections.abc import Iterable
from types import FunctionType, ModuleType

import bpy

from . import alignment, capture, check, estimate, hints, lights, materials, photographs

_MODULES = (photographs, capture, alignment, estimate, hints, materials, lights, check)


def classes_of(modules: Iterable[ModuleType]) -> list[type]:
    """The classes of modules that Blender has to know, in the order in which they stand there.

    They are those whose names begin with ``FIPT_``, and the operators of functions (`operators.action`).
    """
    found = []
    for module in modules:
        for name, each in vars(module).items():
            if isinstance(each, FunctionType) and "operator" in vars(each):
                each, name = each.operator, each.operator.__name__  # type: ignore[attr-defined]
            if name.startswith("FIPT_") and each.__module__ == module.__name__:
                found.append(each)
    return found


class FIPT_SceneSettings(bpy.types.PropertyGroup):
    """The side panel's state for a scene."""

    run_folder: bpy.props.StringProperty(
        name="Run Folder",
        description="Folder of the engine's files for this scene: checkpoints, results, textures, renders",
        subtype="DIR_PATH",
    )
    photographs: bpy.props.PointerProperty(type=photographs.FIPT_PhotographsSettings)
    capture: bpy.props.PointerProperty(type=capture.FIPT_CaptureSettings)
    alignment: bpy.props.PointerProperty(type=alignment.FIPT_AlignmentSettings)
    parts: bpy.props.PointerProperty(type=estimate.FIPT_PartsSettings)
    estimate: bpy.props.PointerProperty(type=estimate.FIPT_EstimateSettings)
    hints: bpy.props.PointerProperty(type=hints.FIPT_HintsSettings)
    materials: bpy.props.PointerProperty(type=materials.FIPT_MaterialsSettings)
    lights: bpy.props.PointerProperty(type=lights.FIPT_LightsSettings)
    insert: bpy.props.PointerProperty(type=check.FIPT_InsertSettings)
    check: bpy.props.PointerProperty(type=check.FIPT_CheckSettings)


_register_classes, _unregister_classes = bpy.utils.register_classes_factory(
    [*classes_of(_MODULES), FIPT_SceneSettings]
)


def register() -> None:
    """Register the groups and `Scene.fipt`."""
    _register_classes()
    bpy.types.Scene.fipt = bpy.props.PointerProperty(type=FIPT_SceneSettings)


def unregister() -> None:
    """Unregister them; the values stay in the .blend files."""
    del bpy.types.Scene.fipt
    _unregister_classes()
