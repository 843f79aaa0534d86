# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""python benchmarks/eevee_views.py room.blend OUT [N]: compare EEVEE with Cycles on a finished room.

Sets the room up for EEVEE, bakes the light probe volume and renders the first N held-back views with both, in
Blender's Python module, which needs OpenGL (EGL). OUT/eevee.json gets the figures, OUT the pictures.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

WIDTH = 240  # pixels
CYCLES_SAMPLES, EEVEE_SAMPLES = 64, 16


def main(argv: list[str]) -> int:
    """Render both, compare and write."""
    out, count = Path(argv[1]).absolute(), int(argv[2]) if len(argv) > 2 else 3
    out.mkdir(parents=True, exist_ok=True)
    figures = compare(*opened(argv[0], count), out)
    (out / "eevee.json").write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(figures, indent=1), flush=True)
    return 0


def opened(blend_file: str, count: int) -> tuple[bpy.types.Scene, list[bpy.types.Object]]:
    """The scene of a .blend file with results, and the cameras of the first held-back views."""
    import fipt_blender

    fipt_blender.register()
    bpy.ops.wm.open_mainfile(filepath=blend_file)
    scene = bpy.context.scene
    views = [view for view in scene.fipt.capture.views if view.split == "held_back"][:count]
    return scene, [view.camera_object() for view in views]


def compare(scene: bpy.types.Scene, cameras: list[bpy.types.Object], out: Path) -> dict[str, object]:
    """Seconds, and for each view the ratio of the mean radiances and the PSNR of the pictures in sRGB."""
    from fipt_blender.blend.lights.eevee import prepare
    from fipt_blender.blend.marks import light_probe

    set_size(scene, cameras[0])
    scene.cycles.samples, scene.cycles.use_denoising = CYCLES_SAMPLES, False
    scene.cycles.use_adaptive_sampling = False
    scene.render.engine = "CYCLES"
    cycles = [render(scene, camera, out / f"cycles_{n}.exr") for n, camera in enumerate(cameras)]
    inexact = prepare(scene)
    scene.eevee.taa_render_samples = EEVEE_SAMPLES
    converted = scene.render.engine
    scene.render.engine = "CYCLES"  # how much of the difference is the lights' shape
    lights = [render(scene, camera, out / f"lights_{n}.exr") for n, camera in enumerate(cameras)]
    scene.render.engine = converted
    started = time.monotonic()
    volume = light_probe(scene)
    bpy.context.view_layer.update()
    with bpy.context.temp_override(active_object=volume, object=volume):
        bpy.ops.object.lightprobe_cache_bake(subset="ALL")
    baked = time.monotonic() - started
    started = time.monotonic()
    eevee = [render(scene, camera, out / f"eevee_{n}.exr") for n, camera in enumerate(cameras)]
    seconds = (time.monotonic() - started) / len(cameras)
    exposure = 0.18 / float(np.median(np.concatenate([image.reshape(-1) for image in cycles])))
    return {
        "version": bpy.app.version_string,
        "bake_seconds": baked,
        "render_seconds": seconds,
        "inexact": inexact,
        "eevee": [figures(a, b, exposure) for a, b in zip(eevee, cycles, strict=True)],
        "converted_in_cycles": [figures(a, b, exposure) for a, b in zip(lights, cycles, strict=True)],
    }


def set_size(scene: bpy.types.Scene, camera: bpy.types.Object) -> None:
    """Small pictures of the camera's proportions, as scene-linear EXR."""
    render = scene.render
    render.resolution_y = round(WIDTH * render.resolution_y / render.resolution_x)
    render.resolution_x, render.resolution_percentage = WIDTH, 100
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"


def render(scene: bpy.types.Scene, camera: bpy.types.Object, path: Path) -> np.ndarray:
    """(H, W, 3) radiance that a camera sees."""
    scene.camera = camera
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    width, height = image.size
    pixels = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, -1)[::-1, :, :3]


def figures(ours: np.ndarray, theirs: np.ndarray, exposure: float) -> dict[str, float]:
    """Ratio of the means without pixels that are white in either, and PSNR, of two pictures."""
    one, other = exposure * ours, exposure * theirs
    dark = (one.max(axis=2) < 1.0) & (other.max(axis=2) < 1.0)
    error = np.square(srgb(one) - srgb(other)).mean()
    return {
        "ratio": float(one[dark].mean() / other[dark].mean()),
        "psnr": float(-10.0 * np.log10(error)),
    }


def srgb(values: np.ndarray) -> np.ndarray:
    """sRGB's curve, clipped."""
    values = np.clip(values, 0.0, 1.0)
    return np.where(values <= 0.0031308, 12.92 * values, 1.055 * values ** (1.0 / 2.4) - 0.055)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
