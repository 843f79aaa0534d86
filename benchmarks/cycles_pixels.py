"""Cycles renders as arrays."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy
import numpy as np

from fipt_blender.blend.pictures.cycles import RenderOptions, render_exr
from fipt_blender.blend.pictures.image_files import read_pixels


def render_pixels(
    scene: bpy.types.Scene,
    options: RenderOptions,
    camera: bpy.types.Object | None = None,
    widest: int | None = None,
) -> np.ndarray:
    """As `render_exr`; returns the image, (H, W, 3) f32, first row at the top."""
    with tempfile.TemporaryDirectory(prefix="fipt-") as folder:
        path = Path(folder) / "render.exr"
        render_exr(scene, path, options, camera, widest)
        return read_pixels(path)
