# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What was added to a room, composited into its photograph by differential rendering (Debevec 1998).

Three renders: the room with everything added, the estimated room alone, and what was added alone, cut out
where the room hides it. What the additions change in the room (shadows, reflections, new light) is taken
from the first two and put onto the photograph; the third covers it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..core.report.comparison import resize_to
from ..properties.lights import FIXTURE
from .photographed import lights_as_photographed
from .renders import changed, read_pixels, render_view

# Changes below the first share of a pixel's radiance are noise or invisible and leave the photograph as it
# is; above the second they count in full.
UNSEEN_CHANGE = (0.005, 0.02)
_DARK = 0.01  # share of the mean below which a pixel's own radiance says nothing about a change's size
_SHAPES = {"MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME", "EMPTY"}


@dataclass(frozen=True)
class Layers:
    """Scene-linear images of one view, first row at the top.

    Attributes:
        photograph: (H, W, 3).
        full: (H, W, 3), the room with what was added.
        empty: (H, W, 3), the estimated room alone; same samples as `full`.
        added: (H, W, 4), what was added, premultiplied, with its coverage as alpha.
    """

    photograph: np.ndarray
    full: np.ndarray
    empty: np.ndarray
    added: np.ndarray


def compose(layers: Layers) -> np.ndarray:
    """The photograph with what was added, (H, W, 3) f32.

    Less light multiplies the photograph, so that its own texture stays in a shadow and nothing becomes
    negative; more light is added to it. With a perfect estimate both are the photograph + full - empty.
    """
    alpha = layers.added[..., 3:]
    open_ = np.clip(1.0 - alpha, 0.0, 1.0)
    before = open_ * layers.empty
    # As shares, since light and shadow vary less from pixel to pixel than the surfaces' own colours.
    level = np.maximum(before, _DARK * float(before.mean()) + 1e-12)
    share = (layers.full - layers.added[..., :3] - before) / level
    change = _visible(_without_specks(share, alpha)) * level
    less = np.divide(before + change, before, out=np.ones_like(before), where=before > 0.0)
    background = open_ * layers.photograph * np.clip(less, 0.0, 1.0) + np.maximum(change, 0.0)
    return (layers.added[..., :3] + np.where(open_ > 0.0, background, 0.0)).astype(np.float32)


def _without_specks(change: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Single pixels brought into the range of their neighbours: samples that few paths found.

    Where the added things' edges are the change is kept: neighbours there show something else.
    """
    padded = np.pad(change, ((1, 1), (1, 1), (0, 0)), mode="edge")
    height, width = change.shape[:2]
    around = [
        padded[row : row + height, column : column + width]
        for row in range(3)
        for column in range(3)
        if (row, column) != (1, 1)
    ]
    return np.where(alpha > 0.0, change, np.clip(change, np.min(around, axis=0), np.max(around, axis=0)))


def _visible(share: np.ndarray) -> np.ndarray:
    """Changes too small to see faded out."""
    low, high = UNSEEN_CHANGE
    x = np.clip((np.abs(share).max(axis=-1, keepdims=True) - low) / (high - low), 0.0, 1.0)
    return share * (x * x * (3.0 - 2.0 * x))


def added_objects(scene: bpy.types.Scene, room: Collection[str]) -> list[bpy.types.Object]:
    """What a scene has besides the estimated room: everything that can be seen in a render, and lights.

    Args:
        room: names of the room's objects; fixtures belong to it as well.
    """
    return [
        item
        for item in scene.objects
        if item.type in _SHAPES | {"LIGHT"} and item.name not in room and not is_fixture(item)
    ]


def is_fixture(item: bpy.types.Object) -> bool:
    """Whether an object is a light of the photographed room."""
    return FIXTURE in item


def estimated_objects(scene: bpy.types.Scene, room: Collection[str]) -> list[bpy.types.Object]:
    """The room's objects and its fixtures."""
    return [item for item in scene.objects if item.name in room or is_fixture(item)]


@contextmanager
def without(items: Collection[bpy.types.Object]) -> Iterator[None]:
    """Objects left out of renders for a while."""
    with ExitStack() as stack:
        for item in items:
            stack.enter_context(changed(item, {"hide_render": True}))
        yield


@contextmanager
def held_out(items: Collection[bpy.types.Object]) -> Iterator[None]:
    """Objects that light and hide, but are not drawn themselves, for a while."""
    with ExitStack() as stack:
        for item in items:
            stack.enter_context(changed(item, {"is_holdout": True}))
        yield


@contextmanager
def not_catching(scene: bpy.types.Scene, room: Collection[str]) -> Iterator[None]:
    """The room drawn as it is, whatever the backdrop, for a while."""
    with ExitStack() as stack:
        for item in estimated_objects(scene, room):
            stack.enter_context(changed(item, {"is_shadow_catcher": False}))
        yield


def render_layers(
    scene: bpy.types.Scene,
    view: str,
    photograph: np.ndarray,
    room: Collection[str],
    spp: int,
    seed: int = 0,
    denoise: bool | None = None,
    device: str = "CPU",
    progress: Callable[[float, float], None] = lambda low, high: None,
) -> Layers:
    """Render what `compose` needs; the scene is as before afterwards.

    Args:
        view: name of the view.
        photograph: (H, W, 3) of that view.
        room: names of the room's objects.
        spp, seed, denoise, device: see `render_exr`.
        progress: told from which to which share the render reaches that starts now.

    Raises:
        FiptError: see `render_view`.
    """
    estimated, added = estimated_objects(scene, room), added_objects(scene, room)
    with tempfile.TemporaryDirectory(prefix="fipt-") as folder, not_catching(scene, room):
        path = Path(folder) / "layer.exr"

        def render(transparent: bool = False) -> np.ndarray:
            render_view(scene, view, path, spp, seed, denoise, transparent, device)
            return read_pixels(path, 4 if transparent else 3)

        progress(0.0, 0.45)
        full = render()
        progress(0.45, 0.9)
        with without(added), lights_as_photographed(scene):
            empty = render()
        progress(0.9, 1.0)
        with held_out(estimated):
            only = render(transparent=True)
    return Layers(resize_to(photograph, full.shape[1], full.shape[0]), full, empty, only)
