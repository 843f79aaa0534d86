# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Composites what was added to a room into its photograph by differential rendering (Debevec 1998).

Three renders: the room with everything added, the estimated room alone, and the added objects alone, cut out
where the room hides them. The difference of the first two (shadows, reflections, new light) is applied to the
photograph; the third is laid over it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Collection
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np

from ...core.capture.averaging import means
from ..changed import all_changed
from ..marks import estimated_objects
from .cycles import RenderOptions
from .image_files import read_pixels
from .photographed import lights_as_photographed, unchanged_lights_as_surfaces
from .renders import Progress, render_view

# Changes below the first share of a pixel's radiance are noise or invisible and don't alter the photograph;
# above the second they are applied in full.
UNSEEN_CHANGE = (0.005, 0.02)
_SHAPES = {"MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME", "EMPTY"}


@dataclass(frozen=True)
class Layers:
    """Scene-linear images of one view, first row at the top.

    Attributes:
        photograph: (H, W, 3).
        full: (H, W, 3), the room with the added objects.
        empty: (H, W, 3), the estimated room alone, with the samples of `full`.
        added: (H, W, 4), the added objects, premultiplied, with their coverage as alpha.
    """

    photograph: np.ndarray
    full: np.ndarray
    empty: np.ndarray
    added: np.ndarray


def compose(layers: Layers) -> np.ndarray:
    """The photograph with the added objects, (H, W, 3) f32.

    Shadows multiply the photograph, so that its texture stays visible and nothing becomes negative; light is
    added to it. With a perfect estimate, either equals photograph + full - empty.
    """
    alpha = layers.added[..., 3:]
    uncovered = np.clip(1.0 - alpha, 0.0, 1.0)
    before = uncovered * layers.empty
    # Relative changes, since these vary less between pixels than the surfaces' colours do.
    # Changes of dark pixels are compared with a share of the mean radiance.
    level = np.maximum(before, 0.01 * float(before.mean()) + 1e-12)
    share = (layers.full - layers.added[..., :3] - before) / level
    change = _visible(_without_specks(share, alpha)) * level
    shadow = np.divide(before + change, before, out=np.ones_like(before), where=before > 0.0)
    background = uncovered * layers.photograph * np.clip(shadow, 0.0, 1.0) + np.maximum(change, 0.0)
    return (layers.added[..., :3] + np.where(uncovered > 0.0, background, 0.0)).astype(np.float32)


def _without_specks(change: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Clamp single pixels to the range of their neighbours, which removes fireflies.

    Pixels that added objects cover are kept, since their neighbours may show something else.
    """
    padded = np.pad(change, ((1, 1), (1, 1), (0, 0)), mode="edge")
    height, width = change.shape[:2]
    neighbours = [
        padded[row : row + height, column : column + width]
        for row in range(3)
        for column in range(3)
        if (row, column) != (1, 1)
    ]
    return np.where(
        alpha > 0.0, change, np.clip(change, np.min(neighbours, axis=0), np.max(neighbours, axis=0))
    )


def _visible(share: np.ndarray) -> np.ndarray:
    """Relative changes with those that are too small to see faded out."""
    low, high = UNSEEN_CHANGE
    x = np.clip((np.abs(share).max(axis=-1, keepdims=True) - low) / (high - low), 0.0, 1.0)
    return share * (x * x * (3.0 - 2.0 * x))


def added_objects(scene: bpy.types.Scene, room: Collection[str]) -> list[bpy.types.Object]:
    """Everything that a scene has besides the estimated room: renderable objects and lights.

    Args:
        scene: the scene.
        room: names of the room's objects; its fixtures and their Blender lights are left out too.
    """
    estimated = set(estimated_objects(scene, room))
    return [item for item in scene.objects if item.type in _SHAPES | {"LIGHT"} and item not in estimated]


def without(items: Collection[bpy.types.Object]) -> AbstractContextManager[None]:
    """Hide objects from renders for the length of a block."""
    return all_changed(items, {"hide_render": True})


def held_out(items: Collection[bpy.types.Object]) -> AbstractContextManager[None]:
    """Let objects light and hide others without being drawn, for the length of a block."""
    return all_changed(items, {"is_holdout": True})


def not_catching(scene: bpy.types.Scene, room: Collection[str]) -> AbstractContextManager[None]:
    """Draw the room whatever the backdrop is, for the length of a block."""
    return all_changed(estimated_objects(scene, room), {"is_shadow_catcher": False})


def render_layers(
    scene: bpy.types.Scene,
    view: str,
    photograph: np.ndarray,
    room: Collection[str],
    options: RenderOptions,
    progress: Progress = lambda low, high: None,
) -> Layers:
    """Render what `compose` needs; the scene is restored afterwards.

    Args:
        scene: the scene.
        view: name of the view.
        photograph: (H, W, 3) of that view.
        room: names of the room's objects.
        options: how to render; `transparent` is ignored.
        progress: called before each render.

    Raises:
        FiptError: see `render_view`.
    """
    estimated, added = estimated_objects(scene, room), added_objects(scene, room)
    with (
        tempfile.TemporaryDirectory(prefix="fipt-") as folder,
        not_catching(scene, room),
        unchanged_lights_as_surfaces(scene),
    ):
        path = Path(folder) / "layer.exr"

        def render(transparent: bool = False) -> np.ndarray:
            render_view(scene, view, path, replace(options, transparent=transparent))
            return read_pixels(path, 4 if transparent else 3)

        progress(0.0, 0.45)
        full = render()
        progress(0.45, 0.9)
        with without(added), lights_as_photographed(scene):
            empty = render()
        progress(0.9, 1.0)
        with held_out(estimated):
            added_only = render(transparent=True)
    return Layers(means(photograph, full.shape[1], full.shape[0]), full, empty, added_only)
