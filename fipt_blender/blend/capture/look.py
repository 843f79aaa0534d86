"""Looking through a view's camera, with its photograph, in the open 3D views."""

from __future__ import annotations

from collections.abc import Iterable

import bpy
import numpy as np
from mathutils import Vector

from ..marks import VIEW, room_with_results
from ..render_settings import follow_exposure
from .backdrop import show_photograph
from .cameras import use_view
from .other_cameras import watch

# Furniture faces a point inside with half of its area, walls with all of it if their normals point inwards.
INWARD_SHARE = 0.5


def look_through(
    scene: bpy.types.Scene, view: bpy.types.PropertyGroup, context: bpy.types.Context
) -> bpy.types.Object | None:
    """Make a view's camera the scene's and look through it in 3D views; None where the camera was deleted."""
    camera, before = view.camera_object(), scene.camera
    if camera is None:
        return None
    use_view(scene, camera)
    follow_exposure(scene, view.exposure)
    if before is not None and before != camera and VIEW in before:
        _free_photograph(before)
    show_photograph(scene, camera)
    enter_camera(context, scene)
    return camera


def stand_in_photograph(scene: bpy.types.Scene, context: bpy.types.Context) -> None:
    """Look through the first view that is used: the artist stands in the room while it is computed."""
    if (first := _first_used(scene)) is not None:
        look_through(scene, first, context)


def _first_used(scene: bpy.types.Scene) -> bpy.types.PropertyGroup | None:
    return next((view for view in scene.fipt.capture.views if view.enabled), None)


def _free_photograph(camera: bpy.types.Object) -> None:
    """Free the pixels of a view's photograph, which Blender reads again where it shows them.

    It would keep those of all views that were looked through, of floats 16 bytes a pixel.
    """
    for background in camera.data.background_images:
        image = background.image
        if image is not None and image.source == "FILE" and not image.is_dirty:
            image.buffers_free()


def shows_photograph(
    scene: bpy.types.Scene, view: bpy.types.PropertyGroup, context: bpy.types.Context
) -> bool:
    """Whether 3D views look through a view's camera now, with its photograph."""
    camera, spaces = view.camera_object(), view_spaces(context, scene)
    inside = all(space.region_3d.view_perspective == "CAMERA" for space in spaces)
    return camera is not None and scene.camera == camera and inside and camera.data.show_background_images


def enter_camera(context: bpy.types.Context, scene: bpy.types.Scene) -> None:
    """Let 3D views look through the scene's camera, without the cameras of other views in the picture."""
    for space in view_spaces(context, scene):
        space.region_3d.view_perspective = "CAMERA"
    watch(scene)


def enter_room(context: bpy.types.Context, scene: bpy.types.Scene) -> None:
    """Show the estimated room and its light from inside, through its first held-back view or the first one.

    3D views that look through another view than `stand_in_photograph` has chosen stay there: the artist did.
    """
    views = [view for view in scene.fipt.capture.views if view.camera_object() is not None]
    views.sort(key=lambda view: (not view.enabled, view.split != "held_back"))
    spaces, first = view_spaces(context, scene), _first_used(scene)
    inside = all(space.region_3d.view_perspective == "CAMERA" for space in spaces)
    chosen = [view.camera_object() for view in views if view != first]
    if views and not (inside and scene.camera in chosen):
        look_through(scene, views[0], context)
    culled = is_culled(scene)
    for space in spaces:
        if space.shading.type == "SOLID":  # Blender's own; in EEVEE the light of lamps' surfaces is missing
            space.shading.type = "RENDERED" if scene.render.engine == "CYCLES" else "MATERIAL"
        space.shading.show_backface_culling = culled


def cull_outside(scene: bpy.types.Scene) -> None:
    """Let viewports, but not Cycles, hide the room's surfaces from behind, where their normals point inwards.

    A room whose walls face outwards would vanish from inside.
    """
    room = room_with_results(scene)
    cameras = [view.camera_object() for view in scene.fipt.capture.views]
    eyes = [camera.matrix_world.translation for camera in cameras if camera is not None]
    culled = bool(eyes) and inward_share(room, np.mean(eyes, axis=0)) > INWARD_SHARE
    for material in _materials(room):
        material.use_backface_culling = culled


def is_culled(scene: bpy.types.Scene) -> bool:
    """Whether `cull_outside` lets viewports hide the room's surfaces from behind."""
    return any(material.use_backface_culling for material in _materials(room_with_results(scene)))


def _materials(objects: Iterable[bpy.types.Object]) -> list[bpy.types.Material]:
    slots = [slot for item in objects for slot in item.material_slots]
    return [slot.material for slot in slots if slot.material is not None]


def inward_share(objects: Iterable[bpy.types.Object], eye: np.ndarray) -> float:
    """Share of the objects' area that faces a point.

    Args:
        objects: meshes.
        eye: (3,) world position.
    """
    facing = total = 0.0
    for item in objects:
        faces = item.data.polygons
        areas, normals, centers = (np.empty(len(faces) * size, np.float32) for size in (1, 3, 3))
        faces.foreach_get("area", areas)
        faces.foreach_get("normal", normals)
        faces.foreach_get("center", centers)
        local = np.array(item.matrix_world.inverted_safe() @ Vector(eye), np.float32)
        toward = ((local - centers.reshape(-1, 3)) * normals.reshape(-1, 3)).sum(1) > 0.0
        scale = abs(item.matrix_world.determinant()) ** (2.0 / 3.0)
        facing += scale * float(areas[toward].sum())
        total += scale * float(areas.sum())
    return facing / total if total > 0.0 else 0.0


def enter_camera_on_opening() -> None:
    """Let the 3D views of a file written without a window show its scene's camera and the materials."""
    for screen in bpy.data.screens:
        for space in (area.spaces.active for area in screen.areas if area.type == "VIEW_3D"):
            space.region_3d.view_perspective = "CAMERA"
            space.shading.type = "MATERIAL"


def view_spaces(context: bpy.types.Context, scene: bpy.types.Scene) -> list[bpy.types.SpaceView3D]:
    """The context's 3D view, else the first one of each window that shows the scene."""
    area = getattr(context, "area", None)
    if area is not None and area.type == "VIEW_3D":
        return [area.spaces.active]
    spaces = []
    for window in context.window_manager.windows:
        if window.scene == scene:
            views = [area for area in window.screen.areas if area.type == "VIEW_3D"]
            spaces += [area.spaces.active for area in views[:1]]
    return spaces


def redraw_views() -> None:
    """Redraw all 3D views, for what is drawn on top of them."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


def refresh_photograph(scene: bpy.types.Scene) -> None:
    """Show the photograph with the panel's opacity, if the scene's camera belongs to a view."""
    camera = scene.camera
    if camera is not None and any(view.camera == camera.name for view in scene.fipt.capture.views):
        show_photograph(scene, camera)
