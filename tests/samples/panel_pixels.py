"""Pixels of any number of views of a box with a bright panel, each wall and the panel one object."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fipt_blender.core.capture.views import View
from fipt_blender.core.parts.labels import Parts
from fipt_blender.core.pixels.mixed_pixels import mark_pure
from fipt_blender.core.pixels.store import PixelStore, create_pixels, trace_view
from fipt_blender.core.pixels.unmixing import unmix_pixels
from fipt_blender.core.run.settings import make_settings
from samples.camera_poses import look_at
from samples.small_captures import CAMERAS, PANEL, pinhole
from samples.small_rooms import BOX, make_room

SCALE = 3  # of the cameras' size in pixels
SETTINGS = make_settings("draft", {"voxel_resolution": 32})
ROOM = make_room([*BOX, PANEL], objects=np.arange(7))
PARTS = Parts(ROOM.triangle_object, "part")
IS_PANEL = np.arange(len(ROOM.triangles)) >= 12
PANEL_RADIANCE, WALL_RADIANCE = 50.0, 1.0


def make_pixels(folder: Path, views: int) -> PixelStore:
    """Pixels of views that see a box with a bright panel."""
    cameras = [look_at(*CAMERAS[i % len(CAMERAS)]) for i in range(views)]
    pixels = create_pixels(
        folder, [View(str(i), "train", Path("none"), **vars(pinhole(pose, SCALE))) for i, pose in enumerate(cameras)]
    )
    for index, view in enumerate(pixels.views):
        rows, traced = pixels.rows(index), trace_view(ROOM, view)
        for name in ("position", "normal", "triangle", "front"):
            getattr(pixels, name)[rows] = getattr(traced, name)
        pixels.radiance[rows] = np.where(traced.triangle >= 12, PANEL_RADIANCE, WALL_RADIANCE)[:, None]
    mark_pure(pixels, ROOM, PARTS.triangle_part, lambda done: None)
    unmix_pixels(pixels, ROOM, PARTS.triangle_part, lambda done: None)
    return pixels
