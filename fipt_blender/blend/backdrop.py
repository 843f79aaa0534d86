# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands behind inserted objects: the room rendered again, or the photograph, with the room catching
shadows; and which picture lies on a view's camera.
"""

from __future__ import annotations

from collections.abc import Iterable

import bpy

from .cameras import VIEW
from .composite import estimated_objects

KEPT_PHOTOGRAPH = "fipt_photograph"  # of a camera's data: its photograph, while another picture lies there
CATCHER = "fipt_catcher"  # marks an object that we made a shadow catcher
COVERED = "fipt_covered"  # of a camera's data: its picture is not drawn while results are shown
KEPT_FILM = "fipt_kept_film_transparent"  # of a scene


def set_backdrop(scene: bpy.types.Scene, mode: str, room: Iterable[bpy.types.Object]) -> None:
    """Choose what is seen behind inserted objects in viewport and renders.

    Args:
        mode: "ROOM", or "PHOTOGRAPH": the room is then drawn as the photograph behind it, darkened by
            shadows. Cycles' viewport shows no reflections there; `composite` does.
        room: the room's objects; fixtures are added.
    """
    scene.fipt.insert.backdrop = mode
    for item in scene.objects:
        if CATCHER in item:
            item.is_shadow_catcher = False
            del item[CATCHER]
    if mode == "PHOTOGRAPH":
        for item in estimated_objects(scene, {each.name for each in room}):
            if not item.is_shadow_catcher:
                # A fixture that were none would count as added, and its light as added light.
                item.is_shadow_catcher = True
                item[CATCHER] = True
        if KEPT_FILM not in scene:
            scene[KEPT_FILM] = scene.render.film_transparent
        scene.render.film_transparent = True
    elif KEPT_FILM in scene:
        scene.render.film_transparent = bool(scene[KEPT_FILM])
        del scene[KEPT_FILM]
    for item in scene.objects:
        if item.type == "CAMERA" and VIEW in item:
            show_photograph(scene, item)
    results = scene.fipt.materials
    if results.object_count and results.shown != "ORIGINAL":
        clear_view(scene, True)


def show_photograph(scene: bpy.types.Scene, camera: bpy.types.Object) -> None:
    """Lay a view's photograph over the room or, as the backdrop, behind it."""
    data = camera.data
    data.pop(COVERED, None)
    kept = data.get(KEPT_PHOTOGRAPH)
    if kept is not None:
        if data.background_images:
            data.background_images[0].image = kept
        del data[KEPT_PHOTOGRAPH]
    behind = scene.fipt.insert.backdrop == "PHOTOGRAPH"
    opacity = 1.0 if behind else scene.fipt.capture.photograph_opacity
    data.show_background_images = opacity > 0.0
    for background in data.background_images:
        # Behind a closed room nobody would see it, unless the room is transparent.
        background.display_depth = "BACK" if behind else "FRONT"
        background.alpha = opacity


def show_picture(camera: bpy.types.Object, image: bpy.types.Image) -> None:
    """Lay another picture over the view, opaque, until `show_photograph`."""
    data = camera.data
    data.pop(COVERED, None)
    if not data.background_images:
        data.background_images.new().frame_method = "STRETCH"
    background = data.background_images[0]
    if KEPT_PHOTOGRAPH not in data and background.image is not None:
        data[KEPT_PHOTOGRAPH] = background.image
    background.image, background.display_depth, background.alpha = image, "FRONT", 1.0
    data.show_background_images = True


def clear_view(scene: bpy.types.Scene, clear: bool) -> None:
    """Take the pictures away that lie over the room, so that its materials or maps are seen; or back again.

    Looking through a view, or a change of the photograph's opacity, brings that one back as well.
    """
    behind = scene.fipt.insert.backdrop == "PHOTOGRAPH"
    for data in {item.data for item in scene.objects if item.type == "CAMERA" and VIEW in item}:
        if clear and data.show_background_images and not behind:
            data.show_background_images = False
            data[COVERED] = True
        elif not clear and data.pop(COVERED, None) is not None:
            data.show_background_images = True
