"""Cycles renders to linear Rec.709 that can be compared with photographs: nothing clamped, box filter,
whatever the artist's settings are; and the saving of Blender's renders.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ...core.run.errors import FiptError
from ...core.run.runfolder import atomic_path
from ..changed import changed
from ..color_spaces import linear_space, scene_matrix
from ..export.stage import rendered_objects
from ..lights.calibration import scene_unit
from ..marks import PIXEL_ASPECT, RESOLUTION
from ..render_settings import LIGHT_PATHS, can_denoise
from ..save import check_space
from .image_files import STILL_IMAGE, write_image

CYCLES = {
    **LIGHT_PATHS,
    "use_adaptive_sampling": False,
    # Photographs average the radiance over a pixel; wider filters would blur.
    "pixel_filter_type": "BOX",
}
# What materials and meshes are in Cycles, and what the frame is in a scene, is the artist's.
_CONTENT = ("feature_set", "shading_system", "dicing_rate", "max_subdivisions")
_FRAME = ("resolution_x", "resolution_y", "pixel_aspect_x", "pixel_aspect_y")


@dataclass(frozen=True)
class RenderOptions:
    """How to render an image in Cycles.

    Attributes:
        spp: samples per pixel.
        seed: seed of the sampling pattern.
        denoise: None denoises where Open Image Denoise is available.
    """

    spp: int
    seed: int = 0
    denoise: bool | None = None


def render_exr(
    scene: bpy.types.Scene,
    path: Path,
    options: RenderOptions,
    camera: bpy.types.Object | None = None,
    widest: int | None = None,
) -> None:
    """Render a camera in Cycles to a float EXR with linear Rec.709 values.

    A new scene renders what this one's renders show, with Blender's settings in place of the artist's.

    Args:
        scene: the scene.
        path: ends in .exr.
        options: see there.
        camera: of a view, in the frame of its photograph; the scene's in the scene's frame by default.
        widest: the most columns, of a view.
    """
    fixed = {
        **CYCLES,
        **{name: getattr(scene.cycles, name) for name in _CONTENT if hasattr(scene.cycles, name)},
        "device": "CPU",
        "film_exposure": 1.0 / scene_unit(scene),  # the photographs' unit
        "samples": options.spp,
        "seed": options.seed,
        "use_denoising": can_denoise() if options.denoise is None else options.denoise,
    }
    exr = {"file_format": "OPEN_EXR", "color_mode": "RGB", "color_depth": "32", "exr_codec": "ZIP"}
    with _plain_scene(scene, camera, widest) as plain:
        for name, value in fixed.items():
            setattr(plain.cycles, name, value)
        render(plain)
        save_render(plain, path, {**STILL_IMAGE, **exr})


def render(scene: bpy.types.Scene) -> None:
    """Render a scene, as F12 does, and wait for the end."""
    try:
        bpy.ops.render.render(scene=scene.name)
    except RuntimeError as error:
        raise render_failed(str(error).strip()) from None


def save_render(scene: bpy.types.Scene, path: Path, file_settings: Mapping[str, str]) -> None:
    """Write Blender's render of a scene, atomically; an EXR in linear Rec.709."""
    result = next((image for image in bpy.data.images if image.type == "RENDER_RESULT"), None)
    if result is None:
        raise render_failed("there is no image")
    settings = scene.render.image_settings
    with ExitStack() as stack, atomic_path(path) as temporary:
        stack.enter_context(changed(settings, file_settings))
        if path.suffix == ".exr" and not np.array_equal(scene_matrix(), np.eye(3)):
            # Copies the scene's view into these settings.
            stack.enter_context(changed(settings, {"color_management": "OVERRIDE"}))
            stack.enter_context(changed(settings.linear_colorspace_settings, {"name": linear_space()}))
        # Not by the scene's output path, in which braces are templates from Blender 4.5.
        write_image(path, temporary, lambda: result.save_render(str(temporary), scene=scene))
        check_space(path)  # on a full disk Blender writes a part of the image and reports nothing


@contextmanager
def _plain_scene(
    scene: bpy.types.Scene, camera: bpy.types.Object | None, widest: int | None
) -> Iterator[bpy.types.Scene]:
    """A new scene for Cycles with what a scene's renders show, its world and a frame, for a block."""
    made = bpy.data.scenes.new("FIPT Render")
    try:
        used = [layer for layer in scene.view_layers if layer.use]
        for item in rendered_objects(scene, (used or list(scene.view_layers))[:1]):
            made.collection.objects.link(item)
        made.camera, made.world, made.render.engine = camera or scene.camera, scene.world, "CYCLES"
        made.render.resolution_percentage = 100
        frame = [getattr(scene.render, name) for name in _FRAME]
        if camera is not None:
            width, height = (int(value) for value in camera[RESOLUTION])
            if widest is not None and width > widest:
                width, height = widest, max(1, round(height * widest / width))
            frame = [width, height, *map(float, camera[PIXEL_ASPECT])]
        for name, value in zip(_FRAME, frame, strict=True):
            setattr(made.render, name, value)
        made.frame_set(scene.frame_current)
        yield made
    finally:
        bpy.data.scenes.remove(made)


def render_failed(reason: str) -> FiptError:
    """The error for a render that Blender did not make."""
    return FiptError("render-failed", reason=reason)
