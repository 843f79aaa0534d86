# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Composites what was added to a room into its photograph by differential rendering (Debevec 1998).

Three renders: the room with everything added, the estimated room alone, and the added objects alone, cut out
where the room hides them. The difference of the first two (shadows, reflections, new light) is applied to the
photograph, the plate; the third is laid over it. The result has all of them as layers, so that any compositor
can take over: picture = object + (1 - alpha of the object) plate shadow + light.
"""

from __future__ import annotations

from collections.abc import Collection
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...core.capture.averaging import means
from ..changed import all_changed
from ..marks import estimated_objects
from .cycles import RenderOptions, render_depth, render_pixels
from .photographed import lights_as_photographed, unchanged_lights_as_surfaces
from .renders import Progress

# Changes below the first share of a pixel's radiance are noise or invisible and don't alter the photograph;
# above the second they are applied in full.
UNSEEN_CHANGE = (0.005, 0.02)
# Values by sRGB's curve that say how bright a photograph is: neither clipped nor lost in its darkest codes
_EXPOSED = (0.02, 0.9)
_SHAPES = {"MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME", "EMPTY"}


@dataclass(frozen=True)
class Layers:
    """Scene-linear images of one view, first row at the top.

    Attributes:
        plate: (H, W, 3), the photograph.
        full: (H, W, 3), the room with the added objects.
        empty: (H, W, 3), the estimated room alone, with the samples of `full`.
        added: (H, W, 4), the added objects, premultiplied, with their coverage as alpha.
    """

    plate: np.ndarray
    full: np.ndarray
    empty: np.ndarray
    added: np.ndarray


@dataclass(frozen=True)
class Composite:
    """The layers of a composite, f32, first row at the top.

    Attributes:
        plate: (H, W, 3), the photograph in the unit of the renders.
        object: (H, W, 4), the added objects, premultiplied.
        shadow: (H, W, 3), 0 to 1, by which they darken the plate.
        light: (H, W, 3), what they add to it.
    """

    plate: np.ndarray
    object: np.ndarray
    shadow: np.ndarray
    light: np.ndarray

    def picture(self) -> np.ndarray:
        """The photograph with the added objects, (H, W, 3) f32."""
        uncovered = np.clip(1.0 - self.object[..., 3:], 0.0, 1.0)
        picture: np.ndarray = self.object[..., :3] + uncovered * self.plate * self.shadow + self.light
        return picture


def compose(layers: Layers) -> Composite:
    """Shadows multiply the photograph, so that its texture stays visible and nothing becomes negative; light
    is added to it. With a perfect estimate, either equals photograph + full - empty.
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
    light = np.where(uncovered > 0.0, np.maximum(change, 0.0), 0.0)
    one = np.float32
    return Composite(
        layers.plate.astype(one),
        layers.added.astype(one),
        np.clip(shadow, 0.0, 1.0).astype(one),
        light.astype(one),
    )


def plate_gain(encoded: np.ndarray, empty: np.ndarray) -> float:
    """Radiance of the renders for a value of 1 of a photograph that is not HDR: by the pixels' median.

    Its exposure is its own, and the values have no unit.

    Args:
        encoded: (H, W, 3), linear by sRGB's curve.
        empty: (H, W, 3), the room as it was photographed, rendered.
    """
    value, radiance = encoded.mean(axis=-1), empty.mean(axis=-1)
    used = (encoded.min(axis=-1) > _EXPOSED[0]) & (encoded.max(axis=-1) < _EXPOSED[1]) & (radiance > 0.0)
    return float(np.median(radiance[used] / value[used])) if used.any() else 1.0


def _without_specks(change: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Clamp single pixels to the range of their neighbours, which removes fireflies.

    Pixels that added objects cover are kept, since their neighbours may show something else.
    """
    padded = np.pad(change, ((1, 1), (1, 1), (0, 0)), mode="edge")
    height, width = change.shape[:2]
    lowest, highest = np.full_like(change, np.inf), np.full_like(change, -np.inf)
    for row, column in ((r, c) for r in range(3) for c in range(3) if (r, c) != (1, 1)):
        neighbour = padded[row : row + height, column : column + width]
        np.minimum(lowest, neighbour, out=lowest)
        np.maximum(highest, neighbour, out=highest)
    return np.where(alpha > 0.0, change, np.clip(change, lowest, highest))


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


def render_composite(
    scene: bpy.types.Scene,
    photograph: np.ndarray,
    encoded: bool,
    room: Collection[str],
    options: RenderOptions,
    progress: Progress = lambda low, high: None,
) -> dict[str, np.ndarray]:
    """Render the scene's camera into its photograph; the scene is restored afterwards.

    Args:
        scene: the scene, with the frame of the photograph.
        photograph: (H, W, 3) of that view, linear, of any size of the frame's proportions.
        encoded: whether it is not HDR, see `plate_gain`.
        room: names of the room's objects.
        options: how to render; `layer` and `transparent` are ignored.
        progress: called before each render.

    Returns:
        The picture, by the name "", and its layers, of the frame's size: `Composite`, and "depth".

    Raises:
        FiptError: see `render_exr`.
    """
    estimated, added = estimated_objects(scene, room), added_objects(scene, room)
    options = replace(options, layer=True, transparent=False)
    with not_catching(scene, room), unchanged_lights_as_surfaces(scene):
        progress(0.0, 0.45)
        full = render_pixels(scene, options)
        progress(0.45, 0.9)
        with without(added), lights_as_photographed(scene):
            empty = render_pixels(scene, options)
        progress(0.9, 0.98)
        with held_out(estimated):
            added_only = render_pixels(scene, replace(options, transparent=True))
        progress(0.98, 1.0)
        depth = render_depth(scene)
    plate = means(photograph, full.shape[1], full.shape[0])
    if encoded:
        plate = plate * plate_gain(plate, empty)
    made = compose(Layers(plate, full, empty, added_only))
    layers = {"plate": made.plate, "object": made.object, "shadow": made.shadow, "light": made.light}
    return {"": made.picture(), **layers, "depth": depth}
