"""What is behind inserted objects, the rendered room or the photograph with the room as shadow catcher; and
the image that a view's camera shows as its background.
"""

from __future__ import annotations

from collections.abc import Iterable

import bpy

from ..marks import (
    CATCHER,
    KEPT_FILM,
    all_view_cameras,
    estimated_objects,
    remove_marks,
    shadow_catchers,
)


def set_backdrop(scene: bpy.types.Scene, mode: str, room: Iterable[bpy.types.Object]) -> None:
    """Choose what is seen behind inserted objects in viewport and renders.

    Args:
        scene: whose render and object settings change.
        mode: "ROOM", or "PHOTOGRAPH": the photograph is then seen in place of the room, darkened by shadows.
        room: the room's objects; its fixtures become shadow catchers too.
    """
    scene.fipt.insert.backdrop = mode
    for item in shadow_catchers(scene):
        item.is_shadow_catcher = False
        remove_marks(item, CATCHER)
    if mode == "PHOTOGRAPH":
        for item in estimated_objects(scene, {item.name for item in room}):
            if not item.is_shadow_catcher:
                # Cycles would treat a fixture that is not a shadow catcher, and its light, as inserted.
                item.is_shadow_catcher = True
                item[CATCHER] = True
        if KEPT_FILM not in scene:
            scene[KEPT_FILM] = scene.render.film_transparent
        scene.render.film_transparent = True
    elif KEPT_FILM in scene:
        scene.render.film_transparent = bool(scene[KEPT_FILM])
        remove_marks(scene, KEPT_FILM)
    show_photographs(scene)


def show_photographs(scene: bpy.types.Scene) -> None:
    """`show_photograph` for all views."""
    for camera in all_view_cameras(scene):
        show_photograph(scene, camera)


def show_photograph(scene: bpy.types.Scene, camera: bpy.types.Object) -> None:
    """Show a view's photograph in front of the room, if the panel says so, or as the backdrop behind it."""
    data = camera.data
    behind = scene.fipt.insert.backdrop == "PHOTOGRAPH"
    settings = scene.fipt.capture
    shown = behind or getattr(settings, settings.photograph_switch())
    opacity = 1.0 if behind else settings.photograph_opacity
    data.show_background_images = shown and opacity > 0.0
    for background in data.background_images:
        # Behind a closed room it would be hidden, except where the room is transparent.
        background.display_depth = "BACK" if behind else "FRONT"
        background.alpha = opacity
