"""Shows the room with its estimated materials, with the artist's own, or with a single map, in any engine.

A map is shown as emission, with a view transform that does not change its values.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import bpy

from ...core.run.errors import FiptError
from ..capture.backdrop import show_photographs
from ..color_spaces import set_view_transform
from ..lights import light_state
from ..lights.world import show_original_world
from ..marks import MAP, room_with_results
from ..outliner import EMPTIED, FIXTURES, find_collection
from ..own_materials import own_materials
from ..room.originals import estimated_meshes, show_original
from ..shown import write_surface
from . import adjust
from .materials import MAPS, is_uniform, result_materials
from .replacing import show_replacements

# Colours are shown as in Blender's colour fields, other values as plain numbers.
_TRANSFORMS = {"BASE_COLOR": "Standard", "EMISSION": "Standard"}
_DATA_TRANSFORM = "Raw"
_VIEW = ("view_transform", "look", "exposure", "gamma", "use_curve_mapping")
_LABELS = {key.upper(): label for key, (label, _) in MAPS.items()}
_BLACK = (0.0, 0.0, 0.0, 1.0)


def show(scene: bpy.types.Scene, shown: str) -> None:
    """Show a map, the estimated materials or the original ones.

    Args:
        scene: the scene with results; nothing happens without results.
        shown: an identifier of `properties.materials.SHOWN`.
    """
    items = room_with_results(scene)
    if not items:
        return
    for item in items:
        if item.mode == "EDIT":
            raise FiptError("room-edited.show", name=item.name)
    own_materials(scene)
    for item in items:
        show_original(item, shown == "ORIGINAL")
    show_replacements(scene, shown)
    meshes = estimated_meshes(scene)
    for material in result_materials(meshes):
        _show_in_material(material, shown)
    for mesh in meshes:
        _show_in_mesh(mesh, shown)
    targets = (find_collection(scene, name) for name in (FIXTURES, EMPTIED))
    for target in filter(None, targets):
        target.hide_viewport = target.hide_render = shown == "ORIGINAL"
    show_original_world(scene, shown == "ORIGINAL")
    light_state.refresh(scene)
    show_photographs(scene)
    _show_in_view(scene, shown)
    _draw_in_solid_views(scene, shown)


def _show_in_material(material: bpy.types.Material, shown: str) -> None:
    nodes = material.node_tree.nodes
    label = _LABELS.get(shown, "")
    write_surface(material, shown, adjust.output(material, label) if label else None, _BLACK)
    active = nodes.get(MAP.format(label)) or nodes.get(MAP.format("Base Color"))
    # Solid shading draws the active texture, or the color of the material without one.
    material.diffuse_color = _BLACK if shown == "EMISSION" else (0.8, 0.8, 0.8, 1.0)
    if is_uniform(material):
        # Without a mark, Solid shading would draw any texture, also one in a group.
        nodes[MAP.format("Confidence")].show_texture = shown == "CONFIDENCE"
        nodes[MAP.format("Base Color")].show_texture = shown != "CONFIDENCE"
        constant = nodes.get(MAP.format(label or "Base Color"))
        if constant is not None and constant.bl_idname == "ShaderNodeRGB" and shown != "EMISSION":
            material.diffuse_color = constant.outputs["Color"].default_value
    elif active is not None:
        nodes.active = active


def _show_in_mesh(mesh: bpy.types.Mesh, shown: str) -> None:
    """Make a map's colour attribute active, since solid shading draws that one."""
    attribute = mesh.color_attributes.get(MAP.format(_LABELS.get(shown, "Base Color")))
    if attribute is not None:
        mesh.color_attributes.active_color = attribute


def _show_in_view(scene: bpy.types.Scene, shown: str) -> None:
    """Set view transform and exposure; the scene's own settings are restored after the last map."""
    settings, view = scene.fipt.materials, scene.view_settings
    if shown in ("ESTIMATED", "ORIGINAL"):
        if settings.kept_view:
            for name, value in json.loads(settings.kept_view).items():
                setattr(view, name, value)
            settings.kept_view = ""
        return
    if not settings.kept_view:
        settings.kept_view = json.dumps({name: getattr(view, name) for name in _VIEW})
    set_view_transform(view, _TRANSFORMS.get(shown, _DATA_TRANSFORM))
    view.look = "None"
    view.exposure, view.gamma, view.use_curve_mapping = 0.0, 1.0, False


def _draw_in_solid_views(scene: bpy.types.Scene, shown: str) -> None:
    """Let viewports in solid shading draw our textures or attributes, so that maps are visible there too."""
    if shown == "ORIGINAL":
        restore_solid_views(scene)
        return
    settings = scene.fipt.materials
    wanted = "VERTEX" if settings.applied_mode == "color_attribute" else "TEXTURE"
    if shown == "EMISSION":
        wanted = "MATERIAL"  # emission has no texture: lamps have their colour, everything else is black
    kept = {(screen, index): color for screen, index, color in json.loads(settings.kept_solid or "[]")}
    for screen, index, space in _solid_views():
        if space.shading.color_type != wanted:
            kept.setdefault((screen, index), space.shading.color_type)
            space.shading.color_type = wanted
    settings.kept_solid = json.dumps([[*key, color] for key, color in kept.items()]) if kept else ""


def restore_solid_views(scene: bpy.types.Scene) -> None:
    """Restore the colouring that viewports in solid shading had before `show`.

    Scenes share viewports: while another one still shows our textures, its are left to that.
    """
    settings = scene.fipt.materials
    kept = {(screen, index): color for screen, index, color in json.loads(settings.kept_solid or "[]")}
    settings.kept_solid = ""
    if any(each.fipt.materials.kept_solid for each in bpy.data.scenes):
        return
    for screen, index, space in _solid_views():
        if (screen, index) in kept:
            space.shading.color_type = kept[screen, index]


def _solid_views() -> Iterator[tuple[str, int, bpy.types.SpaceView3D]]:
    """Screen, index of the area and space of each 3D view in solid shading."""
    for window in bpy.context.window_manager.windows:
        for index, area in enumerate(window.screen.areas):
            for space in area.spaces:
                if space.type == "VIEW_3D" and space.shading.type == "SOLID":
                    yield window.screen.name, index, space
