"""The artist's cameras with their background images as a capture, e.g. from a matchmove or fSpy.

They are written as transforms.json, so that the engine's `ingest` checks them like any other capture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core import conventions
from ...core.run.documents import read_document
from ...core.run.errors import FiptError
from ...core.run.run_files import read_capture
from ...core.run.runfolder import RunFolder, write_json
from ..marks import LARGE_PHOTOGRAPH, PIXEL_ASPECT, RESOLUTION
from . import cameras
from .importing import fill_views

SCENE_SOURCE = "scene-cameras"  # `imported_path` of such captures
_LEAST_SENSOR = 1.0  # mm; Blender takes no smaller ones
_SAME_SHAPE = 1e-6  # relative difference of two aspects that is only rounding


@dataclass(frozen=True)
class _Frame:
    """The name of a camera, and its lens."""

    name: str
    camera: conventions.BlenderCamera


@dataclass(frozen=True)
class _Frames:
    """What `adopt_cameras` reads of transforms.json."""

    frames: tuple[_Frame, ...]


def write_scene_cameras(scene: bpy.types.Scene, run: RunFolder) -> tuple[Path, list[str]]:
    """Write RUN/scene_cameras/transforms.json from the scene's cameras that have a photograph.

    Args:
        scene: its cameras with a background image are written, sorted by name.
        run: the run folder.

    Returns:
        The file, and the names of the cameras that were left out because they have no photograph.
    """
    items = sorted((item for item in scene.objects if item.type == "CAMERA"), key=lambda item: item.name)
    chosen = [item for item in items if photograph_of(item) is not None]
    if not chosen:
        raise FiptError(
            "cameras-none",
            value=f"None of the scene's {len(items)} cameras has a photograph as its background image."
            if items
            else "The scene has no cameras.",
        )
    path = run.scene_cameras / "transforms.json"
    write_json(path, {"up_axis": "z", "frames": [describe_camera(scene, item) for item in chosen]})
    return path, [item.name for item in items if item not in chosen]


def adopt_cameras(run: RunFolder) -> None:
    """Mark the cameras of the context's scene as views, with `photograph_lens`, and fill the list."""
    scene = bpy.context.scene
    path = run.scene_cameras / "transforms.json"
    frames = read_document(path, _Frames, "Import the cameras again.").frames
    views = read_capture(run.ingest_json).views
    if len(frames) != len(views):
        raise FiptError("file-damaged.adopt-cameras", path=path, ingest_json=run.ingest_json)
    for view, frame in zip(views, frames, strict=True):
        item = scene.objects.get(frame.name)
        if item is None:
            raise FiptError("camera-missing.adopt-cameras", name=frame.name)
        cameras.set_lens(item.data, frame.camera)
        cameras.mark_camera(item, view, frame.camera)
    fill_views(scene, run)
    scene.fipt.capture.imported_path, scene.fipt.capture.imported_up = SCENE_SOURCE, ""


def photograph_of(item: bpy.types.Object) -> bpy.types.CameraBackgroundImage | None:
    """The first background image of a camera; None without one."""
    for background in item.data.background_images:
        if background.source == "IMAGE" and background.image is not None:
            return background
    return None


def describe_camera(scene: bpy.types.Scene, item: bpy.types.Object) -> dict[str, Any]:
    """A camera as a frame of transforms.json: pose with OpenGL axes, intrinsics in pixels of its own."""
    background = photograph_of(item)
    assert background is not None
    if item.data.type != "PERSP":
        raise FiptError("camera-model.describe-camera", name=item.name)
    image = background.image
    path = photograph_path(item, image)
    size = item.get(RESOLUTION, image.size) if LARGE_PHOTOGRAPH in image else image.size
    width, height = (int(value) for value in size)
    if not width or not height:
        raise FiptError("image-unreadable.describe-camera", path=path)
    _check_background(item, background)
    frame = frame_of(scene, item, width, height)
    lens = photograph_lens(*frame, background.frame_method, width, height, image.display_aspect)
    motion = item.data.animation_data
    is_locked = item.data.library or (motion and (motion.action or motion.drivers))
    if is_locked and cameras.lens_of(item.data, (lens.pixel_aspect_x, lens.pixel_aspect_y)) != lens:
        raise FiptError("camera-locked", name=item.name, width=width, height=height)
    # To 1e-9 pixels: the same numbers again for a camera that already has this lens.
    fx, fy, cx, cy = (round(value, 9) for value in conventions.blender_to_intrinsics(width, height, lens))
    return {
        "name": item.name,
        "file_path": str(path),
        "w": width,
        "h": height,
        "fl_x": fx,
        "fl_y": fy,
        "cx": cx,
        "cy": cy,
        "camera": asdict(lens),  # for `adopt_cameras`
        "transform_matrix": conventions.opencv_to_opengl_camera(cameras.camera_pose(item)).tolist(),
    }


def photograph_path(item: bpy.types.Object, image: bpy.types.Image) -> Path:
    """The file of a camera's photograph."""
    name = image.get(LARGE_PHOTOGRAPH, image.filepath)
    path = Path(bpy.path.abspath(name, library=image.library)) if name else None
    if path is None or not path.is_file():
        shown_name = path or f"'{image.name}'"
        raise FiptError("image-missing.photograph-path", shown_name=shown_name, name=item.name)
    return path


def frame_of(
    scene: bpy.types.Scene, item: bpy.types.Object, width: int, height: int
) -> tuple[conventions.BlenderCamera, int, int]:
    """Lens and size of the frame that a camera renders: its view's if that fits the photograph."""
    render = scene.render
    size, aspect = item.get(RESOLUTION), item.get(PIXEL_ASPECT)
    if size is None or abs(size[0] * height - size[1] * width) >= max(width, height, *size):
        size = (render.resolution_x, render.resolution_y)
        aspect = (render.pixel_aspect_x, render.pixel_aspect_y)
    return cameras.lens_of(item.data, tuple(aspect)), int(size[0]), int(size[1])


def photograph_lens(
    lens: conventions.BlenderCamera,
    frame_width: int,
    frame_height: int,
    frame_method: str,
    width: int,
    height: int,
    display_aspect: Sequence[float] = (1.0, 1.0),
) -> conventions.BlenderCamera:
    """The lens with which a camera at its photograph's resolution renders what the photograph shows.

    In its present frame the camera shows the same as before: the focal length stays, sensor and shift become
    relative to the side that the photograph and the frame share.

    Args:
        lens: the camera's lens, with the pixel aspect of its frame.
        frame_width, frame_height: size of the frame in pixels.
        frame_method: how the photograph lies over the frame, "FIT", "CROP" or "STRETCH".
        width, height: size of the photograph in pixels.
        display_aspect: width and height of the photograph's pixels as Blender shows them.

    Returns:
        Lengths in mm as Blender stores them (float32), and the pixel aspect of the photograph in the frame.
    """
    # Sizes as displayed: neither the frame's pixels nor the photograph's need be square.
    frame = np.array([frame_width * lens.pixel_aspect_x, frame_height * lens.pixel_aspect_y])
    shown = np.multiply((width, height), display_aspect)
    scales = frame / shown
    fitted = shared = 0 if conventions.fits_width(lens.sensor_fit, *frame) else 1  # side: width or height
    if frame_method == "STRETCH" or abs(scales[0] / scales[1] - 1.0) < _SAME_SHAPE:
        shown = frame
    else:
        shared = int(np.argmin(scales) if frame_method == "FIT" else np.argmax(scales))
        shown = shown * scales[shared]
    if fitted != shared or conventions.fits_width(lens.sensor_fit, *shown) != (shared == 0):
        ratio = frame[shared] / frame[fitted]
        sensor = ratio * (lens.sensor_height if lens.sensor_fit == "VERTICAL" else lens.sensor_width)
        sizes = sensor * shown / shown[shared]
        larger = max(1.0, _LEAST_SENSOR / sizes.min())
        lens = conventions.BlenderCamera(
            lens.lens * larger,
            sizes[0] * larger,
            sizes[1] * larger,
            ("HORIZONTAL", "VERTICAL")[shared],
            lens.shift_x / ratio,
            lens.shift_y / ratio,
        )
    values: dict[str, Any] = asdict(lens)
    values |= {name: float(np.float32(value)) for name, value in values.items() if name != "sensor_fit"}
    aspect = shown[0] / width / (shown[1] / height)
    values |= {"pixel_aspect_x": float(max(1.0, aspect)), "pixel_aspect_y": float(max(1.0, 1.0 / aspect))}
    return replace(lens, **values)


def _check_background(item: bpy.types.Object, background: bpy.types.CameraBackgroundImage) -> None:
    """Refuse a photograph that is shifted, scaled, rotated or flipped (``background-moved``)."""
    moved = max(abs(value) for value in background.offset) > 1e-6 or abs(background.scale - 1.0) > 1e-6
    if moved or background.rotation or background.use_flip_x or background.use_flip_y:
        raise FiptError("background-moved", name=item.name)
