# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The whole room between its estimated materials, the artist's own and single maps, in every engine.

A map is shown as light of its own, and through a view transform that leaves its values alone.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import bpy

from ..core.job.errors import FiptError
from . import light_state
from .backdrop import clear_view
from .materials import MAPS, own_materials
from .originals import has_results, own_mesh, show_original
from .outliner import FIXTURES, find_collection
from .shown import write_surface
from .world import show_original_world

# Base colours and the colour of light read as in Blender's colour fields; other values as plain numbers.
_TRANSFORMS = {"BASE_COLOR": "Standard", "EMISSION": "Standard"}
_DATA_TRANSFORM = "Raw"
_VIEW = ("view_transform", "look", "exposure", "gamma", "use_curve_mapping")
_LABELS = {key.upper(): label for key, (label, _) in MAPS.items()}
_BLACK = (0.0, 0.0, 0.0, 1.0)


def room_with_results(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's objects that carry results."""
    return [item for item in scene.objects if has_results(item)]


def show(scene: bpy.types.Scene, shown: str) -> None:
    """Show a map, the estimated room or the original one.

    Args:
        scene: with results; without any nothing happens.
        shown: an identifier of `properties.materials.SHOWN`.

    Raises:
        FiptError: ``room-edited`` where an object of the room is in edit mode.
    """
    items = room_with_results(scene)
    if not items:
        return
    for item in items:
        if item.mode == "EDIT":
            raise FiptError(
                "room-edited", f"'{item.name}' is in edit mode.", "Leave edit mode, and choose again."
            )
    for item in items:
        show_original(item, shown == "ORIGINAL")
    meshes = [mesh for mesh in map(own_mesh, items) if mesh is not None]
    for material in own_materials(meshes).values():
        _show_in_material(material, shown)
    for mesh in meshes:
        _show_in_mesh(mesh, shown)
    target = find_collection(scene, FIXTURES)
    if target is not None:
        target.hide_viewport = target.hide_render = shown == "ORIGINAL"
    show_original_world(scene, shown == "ORIGINAL")
    light_state.refresh(scene)
    clear_view(scene, shown != "ORIGINAL")
    _show_in_view(scene, shown)
    _draw_in_solid_views(scene, shown)


def _show_in_material(material: bpy.types.Material, shown: str) -> None:
    nodes = material.node_tree.nodes
    source = nodes.get(f"FIPT {_LABELS.get(shown, '')}")
    write_surface(material, shown, source, _BLACK)
    drawn = source or nodes.get("FIPT Base Color")
    if drawn is not None:
        nodes.active = drawn  # solid shading draws the active texture
    material.diffuse_color = _BLACK if shown == "EMISSION" else (0.8, 0.8, 0.8, 1.0)


def _show_in_mesh(mesh: bpy.types.Mesh, shown: str) -> None:
    """Solid shading draws the active colour attribute, where there are attributes of ours."""
    attribute = mesh.color_attributes.get(f"FIPT {_LABELS.get(shown, 'Base Color')}")
    if attribute is not None:
        mesh.color_attributes.active_color = attribute


def _show_in_view(scene: bpy.types.Scene, shown: str) -> None:
    """View transform and exposure: the scene's own ones come back after the last map."""
    settings, view = scene.fipt.materials, scene.view_settings
    if shown in ("ESTIMATED", "ORIGINAL"):
        if settings.kept_view:
            for name, value in json.loads(settings.kept_view).items():
                setattr(view, name, value)
            settings.kept_view = ""
        return
    if not settings.kept_view:
        settings.kept_view = json.dumps({name: getattr(view, name) for name in _VIEW})
    view.view_transform = _TRANSFORMS.get(shown, _DATA_TRANSFORM)
    view.look = "None"
    view.exposure, view.gamma, view.use_curve_mapping = 0.0, 1.0, False


def _draw_in_solid_views(scene: bpy.types.Scene, shown: str) -> None:
    """Let viewports in solid shading draw our textures or attributes, so that maps are seen there too."""
    if shown == "ORIGINAL":
        restore_solid_views(scene)
        return
    settings = scene.fipt.materials
    wanted = "VERTEX" if settings.applied_mode == "color_attribute" else "TEXTURE"
    if shown == "EMISSION":
        wanted = "MATERIAL"  # there is no texture of it: lamps have their colour, the others are black
    kept = {(screen, index): color for screen, index, color in json.loads(settings.kept_solid or "[]")}
    for screen, index, space in _solid_views():
        if space.shading.color_type != wanted:
            kept.setdefault((screen, index), space.shading.color_type)
            space.shading.color_type = wanted
    settings.kept_solid = json.dumps([[*place, color] for place, color in kept.items()]) if kept else ""


def restore_solid_views(scene: bpy.types.Scene) -> None:
    """Colour viewports in solid shading as before `show`."""
    settings = scene.fipt.materials
    for screen, index, color in json.loads(settings.kept_solid or "[]"):
        for name, place, space in _solid_views():
            if (name, place) == (screen, index):
                space.shading.color_type = color
    settings.kept_solid = ""


def _solid_views() -> Iterator[tuple[str, int, bpy.types.SpaceView3D]]:
    for window in bpy.context.window_manager.windows:
        for index, area in enumerate(window.screen.areas):
            for space in area.spaces:
                if space.type == "VIEW_3D" and space.shading.type == "SOLID":
                    yield window.screen.name, index, space
