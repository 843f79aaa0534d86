# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The artist's cameras with their background images as a capture, e.g. from a matchmove or fSpy.

They are written as transforms.json, so that the engine's `ingest` checks them like any other capture.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from ...core import conventions
from ...core.run.documents import Fields, Items, read_json
from ...core.run.errors import FiptError
from ...core.run.run_files import read_capture
from ...core.run.runfolder import RunFolder, write_json
from ..marks import LARGE_PHOTOGRAPH, PIXEL_ASPECT, RESOLUTION
from . import cameras
from .exporting import camera_pose
from .importing import fill_views

SCENE_SOURCE = "scene-cameras"  # `imported_path` of such captures
_FRAMES = Fields({"frames": Items(Fields({"name": str}))})


@dataclass(frozen=True)
class Frame:
    """The image that a camera renders: size in pixels, and Blender's lens parameters."""

    width: int
    height: int
    camera: conventions.BlenderCamera


def write_scene_cameras(scene: bpy.types.Scene, run: RunFolder) -> tuple[Path, list[str]]:
    """Write RUN/scene_cameras/transforms.json from the scene's cameras that have a photograph.

    Args:
        scene: its cameras with a background image are written, sorted by name.
        run: the run folder.

    Returns:
        The file, and the names of the cameras that were left out because they have no photograph.

    Raises:
        FiptError: ``cameras-none``, ``camera-model`` for one that is not perspective,
            ``image-missing``, ``background-moved``, ``alignment-uneven``.
    """
    items = sorted((item for item in scene.objects if item.type == "CAMERA"), key=lambda item: item.name)
    chosen = [item for item in items if photograph_of(item) is not None]
    if not chosen:
        raise FiptError(
            "cameras-none",
            f"None of the scene's {len(items)} cameras has a photograph as its background image."
            if items
            else "The scene has no cameras.",
            "Give each camera its photograph: Camera properties > Background Images > Add Image.",
        )
    path = run.scene_cameras / "transforms.json"
    write_json(path, {"up_axis": "z", "frames": [describe_camera(scene, item) for item in chosen]})
    return path, [item.name for item in items if item not in chosen]


def adopt_cameras(run: RunFolder) -> None:
    """Mark the cameras of the context's scene as views, and fill the list; they don't change otherwise.

    Raises:
        FiptError: ``camera-missing`` where one was removed since `write_scene_cameras`.
    """
    scene = bpy.context.scene
    path = run.scene_cameras / "transforms.json"
    frames = read_json(path, _FRAMES, "Import the cameras again.")["frames"]
    views = read_capture(run.ingest_json)["views"]
    if len(frames) != len(views):
        text = f"{path} does not fit {run.ingest_json}."
        raise FiptError("file-damaged", text, "Import the cameras again.")
    for view, frame in zip(views, frames, strict=True):
        item = scene.objects.get(frame["name"])
        if item is None:
            raise FiptError(
                "camera-missing", f"The camera '{frame['name']}' was removed meanwhile.", "Import again."
            )
        lens = [view[name] for name in ("fx", "fy", "cx", "cy")]
        parameters = conventions.intrinsics_to_blender(view["width"], view["height"], *lens)
        cameras.mark_camera(item, view, parameters)
    fill_views(scene, run)
    scene.fipt.capture.imported_path = SCENE_SOURCE


def photograph_of(item: bpy.types.Object) -> bpy.types.CameraBackgroundImage | None:
    """The first background image of a camera; None without one."""
    for background in item.data.background_images:
        if background.source == "IMAGE" and background.image is not None:
            return background
    return None


def describe_camera(scene: bpy.types.Scene, item: bpy.types.Object) -> dict[str, Any]:
    """A camera as a frame of transforms.json: pose with OpenGL axes, intrinsics in pixels of its photograph.

    Raises:
        FiptError: see `write_scene_cameras`.
    """
    background = photograph_of(item)
    assert background is not None
    if item.data.type != "PERSP":
        raise FiptError(
            "camera-model",
            f"The camera '{item.name}' is not a perspective camera.",
            "Set its lens type to Perspective, or remove its background image.",
        )
    path = photograph_path(item, background.image)
    size = item[RESOLUTION] if LARGE_PHOTOGRAPH in background.image else background.image.size
    width, height = (int(value) for value in size)
    if not width or not height:
        raise FiptError("image-unreadable", f"The photograph {path} can't be read.", "Export it again.")
    fx, fy, cx, cy = photograph_lens(item, background, frame_of(scene, item), width, height)
    return {
        "name": item.name,
        "file_path": str(path),
        "w": width,
        "h": height,
        "fl_x": fx,
        "fl_y": fy,
        "cx": cx,
        "cy": cy,
        "transform_matrix": conventions.opencv_to_opengl_camera(camera_pose(item)).tolist(),
    }


def photograph_path(item: bpy.types.Object, image: bpy.types.Image) -> Path:
    """The file of a camera's photograph.

    Raises:
        FiptError: ``image-missing``.
    """
    name = image.get(LARGE_PHOTOGRAPH, image.filepath)
    path = Path(bpy.path.abspath(name, library=image.library)) if name else None
    if path is None or not path.is_file():
        shown_name = path or f"'{image.name}'"
        raise FiptError(
            "image-missing",
            f"The photograph {shown_name} of the camera '{item.name}' is not a file on disk.",
            "Save or unpack the image, or restore the file.",
        )
    return path


def frame_of(scene: bpy.types.Scene, item: bpy.types.Object) -> Frame:
    """The frame that a camera renders: its own where it is a view already, else the scene's."""
    render = scene.render
    if RESOLUTION in item:
        width, height = (int(value) for value in item[RESOLUTION])
        aspect = [float(value) for value in item[PIXEL_ASPECT]]
    else:
        width, height = render.resolution_x, render.resolution_y
        aspect = [render.pixel_aspect_x, render.pixel_aspect_y]
    return Frame(width, height, cameras.lens_of(item.data, aspect))


def photograph_lens(
    item: bpy.types.Object, background: bpy.types.CameraBackgroundImage, frame: Frame, width: int, height: int
) -> tuple[float, float, float, float]:
    """Intrinsics fx, fy, cx, cy in pixels of the photograph, as it lies over the camera's frame.

    Args:
        item: the camera.
        background: its background image, the photograph.
        frame: the frame that the camera renders.
        width, height: size of the photograph in pixels.

    Raises:
        FiptError: ``background-moved`` where the photograph is shifted, scaled, rotated or flipped.
    """
    moved = max(abs(value) for value in background.offset) > 1e-6 or abs(background.scale - 1.0) > 1e-6
    if moved or background.rotation or background.use_flip_x or background.use_flip_y:
        raise FiptError(
            "background-moved",
            f"The photograph of the camera '{item.name}' is shifted, scaled, rotated or flipped.",
            "Reset offset, scale, rotation and flip of its background image; use the camera's shift instead.",
        )
    fx, fy, cx, cy = conventions.blender_to_intrinsics(frame.width, frame.height, frame.camera)
    # Sizes as displayed: the pixels of a frame may be non-square, those of an image are square.
    shown = (frame.width * frame.camera.pixel_aspect_x, frame.height * frame.camera.pixel_aspect_y)
    scale_x, scale_y = shown[0] / width, shown[1] / height
    if background.frame_method != "STRETCH" and abs(scale_x / scale_y - 1.0) > 2e-3:
        scale_x = scale_y = (min if background.frame_method == "FIT" else max)(scale_x, scale_y)
    x, y = frame.camera.pixel_aspect_x / scale_x, frame.camera.pixel_aspect_y / scale_y
    return (
        fx * x,
        fy * y,
        (cx - 0.5 * frame.width) * x + 0.5 * width,
        (cy - 0.5 * frame.height) * y + 0.5 * height,
    )
