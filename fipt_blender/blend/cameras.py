# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The capture's views as Blender cameras, each with its photograph behind it.

Resolution and pixel aspect belong to the scene, not to a camera: they are kept as custom properties and
set by `use_view`.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from ..core import conventions
from ..core.job.errors import FiptError
from ..core.job.runfolder import RunFolder, read_json
from ..properties.capture import VIEW_KEY, view_cameras
from .images import load_radiance
from .outliner import CAMERAS, collection
from .placement import ViewGeometry

VIEW = VIEW_KEY
RESOLUTION = "fipt_resolution"
PIXEL_ASPECT = "fipt_pixel_aspect"
SPLIT = "fipt_split"


def add_cameras(run: RunFolder, scene: bpy.types.Scene | None = None, photographs: bool = True) -> list[str]:
    """Add a camera for every view of the run's capture to the collection "FIPT Cameras".

    A camera that is there already is set anew instead of doubled.

    Args:
        run: the run folder; capture.json is read.
        scene: the context's scene by default.
        photographs: show the photographs as camera background images.

    Returns:
        Names of the camera objects in the order of the views; Blender may shorten or number them, so
        `find_camera` looks a view up.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    scene = scene or bpy.context.scene
    return [add_camera(scene, run, view, photographs).name for view in read_json(run.capture_json)["views"]]


def add_camera(
    scene: bpy.types.Scene,
    run: RunFolder,
    view: dict[str, Any],
    photograph: bool = True,
    parent: bpy.types.Object | None = None,
) -> bpy.types.Object:
    """The camera of one view, added to "FIPT Cameras" or set anew; one of the artist's own stays as it is.

    Args:
        scene: where it goes.
        run: the run folder, for the photograph's path.
        view: an entry of capture.json's views.
        photograph: show the photograph as the camera's background image.
        parent: what carries the camera: the view's pose is then in the parent's space.
    """
    target = collection(scene, CAMERAS)
    item = next((each for each in target.objects if each.get(VIEW) == view["name"]), None)
    if item is None:
        own = view_cameras(scene).get(view["name"])
        if own is not None:
            return own
        item = bpy.data.objects.new(view["name"], bpy.data.cameras.new(view["name"]))
        target.objects.link(item)
    if parent is not None:
        item.parent = parent
        item.matrix_parent_inverse = Matrix.Identity(4)
    set_camera(item, view, local=parent is not None)
    if photograph:
        _set_background(item.data, load_radiance(run.resolve(view["image"])))
    return item


def set_camera(item: bpy.types.Object, view: dict[str, Any], local: bool = False) -> None:
    """Give a camera object the exact projection of a view.

    Args:
        item: a camera object.
        view: an entry of capture.json's views.
        local: whether its pose is in the space of the camera's parent.
    """
    parameters = conventions.intrinsics_to_blender(
        view["width"], view["height"], view["fx"], view["fy"], view["cx"], view["cy"]
    )
    camera = item.data
    camera.type = "PERSP"
    for name in ("sensor_fit", "sensor_width", "sensor_height", "lens", "shift_x", "shift_y"):
        setattr(camera, name, getattr(parameters, name))
    camera.clip_start, camera.clip_end = 0.001, 10000.0
    camera.dof.use_dof = False
    matrix = conventions.opencv_to_blender_camera(np.array(view["camera_to_world"], np.float64))
    if local:
        item.matrix_basis = Matrix(matrix.tolist())
    else:
        item.matrix_world = Matrix(matrix.tolist())
    mark_camera(item, view, parameters)


def mark_camera(item: bpy.types.Object, view: dict[str, Any], parameters: conventions.BlenderCamera) -> None:
    """Note on a camera object which view it shows, and with which render size."""
    item[VIEW] = view["name"]
    item[SPLIT] = view.get("split", "train")
    item[RESOLUTION] = [int(view["width"]), int(view["height"])]
    item[PIXEL_ASPECT] = [parameters.pixel_aspect_x, parameters.pixel_aspect_y]


def _set_background(camera: bpy.types.Camera, image: bpy.types.Image | None) -> None:
    camera.background_images.clear()
    if image is None:
        return
    background = camera.background_images.new()
    background.image = image
    background.frame_method = "STRETCH"
    background.display_depth = "FRONT"
    background.alpha = 0.5
    camera.show_background_images = True


def find_camera(view_name: str, scene: bpy.types.Scene | None = None) -> bpy.types.Object:
    """The camera of a view in a scene (the context's by default).

    Raises:
        FiptError: ``view-missing``.
    """
    for item in (scene or bpy.context.scene).objects:
        if item.type == "CAMERA" and item.get(VIEW) == view_name:
            return item
    raise FiptError(
        "view-missing",
        f"The file has no camera for the view '{view_name}'.",
        "Import the capture's cameras again, or name one of its views.",
    )


def camera_geometry(scene: bpy.types.Scene, camera: bpy.types.Object) -> ViewGeometry:
    """The pinhole of a camera with its photograph's resolution, or the scene's where it has none.

    Raises:
        FiptError: ``camera-kind`` for a camera without perspective.
    """
    data, render = camera.data, scene.render
    if data.type != "PERSP":
        raise FiptError(
            "camera-kind", f"'{camera.name}' is no perspective camera.", "Look through one that is."
        )
    share = render.resolution_percentage / 100.0
    own = [int(render.resolution_x * share), int(render.resolution_y * share)]
    width, height = (int(value) for value in camera.get(RESOLUTION, own))
    aspect = camera.get(PIXEL_ASPECT, (render.pixel_aspect_x, render.pixel_aspect_y))
    parameters = conventions.BlenderCamera(
        data.lens, data.sensor_width, data.sensor_height, data.sensor_fit, data.shift_x, data.shift_y, *aspect
    )
    pose = conventions.blender_to_opencv_camera(np.array(camera.matrix_world, np.float64))
    lens = conventions.blender_to_intrinsics(width, height, parameters)
    return ViewGeometry(pose, width, height, *lens)


def use_view(scene: bpy.types.Scene, camera: bpy.types.Object) -> None:
    """Make a camera active with its photograph's resolution and pixel shape."""
    scene.camera = camera
    render = scene.render
    if RESOLUTION in camera:
        render.resolution_x, render.resolution_y = (int(value) for value in camera[RESOLUTION])
        render.pixel_aspect_x, render.pixel_aspect_y = (float(value) for value in camera[PIXEL_ASPECT])
    render.resolution_percentage = 100
    render.use_border = False
