# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles renders that can be compared with photographs: scene-linear EXR, nothing clamped, box filter."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder, atomic_path, read_json, write_json
from .cameras import find_camera, use_view
from .lights import add_area_light, set_estimated_lights

CYCLES = {
    "device": "CPU",
    "use_adaptive_sampling": False,
    "sample_clamp_direct": 0.0,
    "sample_clamp_indirect": 0.0,
    "blur_glossy": 0.0,
    "light_sampling_threshold": 0.0,
    "caustics_reflective": True,
    "caustics_refractive": True,
    # Light rooms: Blender's 12 leave out 0.4 % of a bright living room. Paths mostly end by chance before, so
    # that further ones cost little.
    "max_bounces": 32,
    "diffuse_bounces": 32,
    "glossy_bounces": 32,
    # Photographs average the radiance over a pixel; wider filters would blur.
    "pixel_filter_type": "BOX",
}


def can_denoise() -> bool:
    """Whether this Blender was built with Open Image Denoise; some builds offer it but lack it."""
    try:
        import _cycles
    except ImportError:
        return False
    return bool(getattr(_cycles, "with_openimagedenoise", False))


def set_up_scene(scene: bpy.types.Scene, exposure: float = 0.0) -> None:
    """Settings with which a re-render compares with the photographs by eye, kept in the file.

    Args:
        exposure: stops, e.g. from `exposure_of`; the view transform is Standard (sRGB), without a look.
    """
    scene.render.engine = "CYCLES"
    for name, value in CYCLES.items():
        if name != "device":  # the artist's own choice
            setattr(scene.cycles, name, value)
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.look = "None"
    scene.view_settings.exposure = exposure
    scene.view_settings.gamma = 1.0


def exposure_of(radiance: np.ndarray) -> float:
    """Stops that bring the median of positive radiances to middle grey (0.18); 0 where there is none."""
    positive = radiance[radiance > 0.0]
    return float(np.log2(0.18 / np.median(positive))) if positive.size else 0.0


@contextmanager
def changed(target: Any, values: Mapping[str, Any]) -> Iterator[None]:
    """Attributes of something with other values for a while."""
    kept = {name: getattr(target, name) for name in values}
    try:
        for name, value in values.items():
            setattr(target, name, value)
        yield
    finally:
        for name, value in kept.items():
            setattr(target, name, value)


def render_exr(
    scene: bpy.types.Scene,
    path: Path,
    spp: int,
    seed: int = 0,
    denoise: bool | None = None,
    transparent: bool = False,
    device: str = "CPU",
) -> None:
    """Render the scene's active camera in Cycles to a float EXR with scene-linear values.

    The scene's own render settings are as before afterwards.

    Args:
        path: ends in .exr.
        spp: samples a pixel.
        seed: of the sampling pattern.
        denoise: None denoises where Open Image Denoise works.
        transparent: write what covers a pixel as alpha, colours premultiplied; the world does not.
        device: of Cycles: "CPU" or "GPU".

    Raises:
        FiptError: ``render-failed``, or the write errors of the run folder.
    """
    if denoise is None:
        denoise = can_denoise()
    render = scene.render
    with ExitStack() as stack, atomic_path(path) as temporary:
        stack.enter_context(
            changed(
                render,
                {
                    "engine": "CYCLES",
                    "filepath": str(temporary),
                    "use_file_extension": False,
                    "use_compositing": False,
                    "use_sequencer": False,
                    "use_motion_blur": False,
                    "film_transparent": transparent,
                },
            )
        )
        cycles = {**CYCLES, "samples": spp, "seed": seed, "use_denoising": denoise, "device": device}
        stack.enter_context(changed(scene.cycles, cycles))
        settings = render.image_settings
        if "media_type" in settings.bl_rna.properties:  # from 5.0; decides which formats exist
            stack.enter_context(changed(settings, {"media_type": "IMAGE"}))
        mode = "RGBA" if transparent else "RGB"
        exr = {"file_format": "OPEN_EXR", "color_mode": mode, "color_depth": "32", "exr_codec": "ZIP"}
        stack.enter_context(changed(settings, exr))
        try:
            bpy.ops.render.render(write_still=True, scene=scene.name)
        except RuntimeError as error:
            raise _render_failed(str(error).strip()) from None
        if not temporary.exists():
            raise _render_failed("no image was written")


def _render_failed(reason: str) -> FiptError:
    return FiptError(
        "render-failed", f"Cycles could not render ({reason}).", "Look at Blender's console output."
    )


def render_pixels(scene: bpy.types.Scene, spp: int, seed: int = 0, denoise: bool = False) -> np.ndarray:
    """Like `render_exr`, but return the image: (H,W,3) f32, first row at the top."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "render.exr"
        render_exr(scene, path, spp, seed, denoise)
        return read_pixels(path)


def read_pixels(path: Path, channels: int = 3) -> np.ndarray:
    """Pixels of a scene-linear image file, (H,W,channels) f32, first row at the top."""
    image = bpy.data.images.load(str(path))
    try:
        image.colorspace_settings.is_data = True
        width, height = image.size
        pixels = np.empty(width * height * image.channels, np.float32)
        image.pixels.foreach_get(pixels)
        return pixels.reshape(height, width, image.channels)[::-1, :, :channels].copy()
    finally:
        bpy.data.images.remove(image)


def render_view(
    scene: bpy.types.Scene,
    view: str,
    path: Path,
    spp: int,
    seed: int = 0,
    denoise: bool | None = None,
    transparent: bool = False,
    device: str = "CPU",
) -> None:
    """Render one view of the capture; see `render_exr`.

    Raises:
        FiptError: ``view-missing`` too.
    """
    render = scene.render
    kept = {
        name: getattr(render, name)
        for name in ("resolution_x", "resolution_y", "pixel_aspect_x", "pixel_aspect_y",
                     "resolution_percentage", "use_border")
    }  # fmt: skip
    camera = scene.camera
    use_view(scene, find_camera(view))
    try:
        render_exr(scene, path, spp, seed, denoise, transparent, device)
    finally:
        scene.camera = camera
        for name, value in kept.items():
            setattr(render, name, value)


def add_to_list(run: RunFolder, entries: Sequence[Mapping[str, str]]) -> None:
    """Add renders to renders.json; one of the same kind and view is replaced."""
    listed = read_json(run.renders_json)["renders"] if run.renders_json.exists() else []
    new = {(entry["kind"], entry["view"]) for entry in entries}
    kept = [entry for entry in listed if (entry["kind"], entry["view"]) not in new]
    write_json(run.renders_json, {"renders": [*kept, *(dict(entry) for entry in entries)]})


def render_list(
    run: RunFolder,
    scene: bpy.types.Scene,
    kind: str,
    views: Sequence[str],
    spp: int,
    seed: int = 0,
    denoise: bool | None = None,
) -> list[Path]:
    """Render views into renders/KIND/ and list them in renders.json.

    Args:
        kind: "rerender", "relight" or "insert".
    """
    paths = []
    for view in views:
        path = run.renders / kind / f"{view.replace('/', '_')}.exr"
        render_view(scene, view, path, spp, seed, denoise)
        add_to_list(run, [{"kind": kind, "view": view, "image": path.relative_to(run.root).as_posix()}])
        paths.append(path)
    return paths


def render_cycles_views(
    run: RunFolder,
    blend_file: Path,
    views: Sequence[str],
    relight: Mapping[str, Any] | None = None,
    spp: int = 128,
    seed: int = 0,
    denoise: bool | None = None,
) -> list[Path]:
    """Open a result's .blend and render views as they are, or lit by one new light only.

    Meant for a process of its own: the open file is replaced.

    Args:
        relight: {"vertices": four corners in Blender's world, counter-clockwise seen from its front,
            "radiance": rgb}; the estimated lights are then off.
    """
    bpy.ops.wm.open_mainfile(filepath=str(blend_file), load_ui=False)
    scene = bpy.context.scene
    if relight is None:
        return render_list(run, scene, "rerender", views, spp, seed, denoise)
    set_estimated_lights(False)
    add_area_light(
        "FIPT Relight", relight["radiance"], vertices=relight["vertices"], as_mesh=True, scene=scene
    )
    return render_list(run, scene, "relight", views, spp, seed, denoise)
