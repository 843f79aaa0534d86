"""The capture's views as Blender cameras, each with its photograph as background image.

In Blender, resolution and pixel aspect belong to the scene: they are stored as custom properties of the
camera, and `use_view` sets them.
"""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Matrix

from ...core import conventions
from ...core.run.contents import CapturedView, CapturedViews
from ...core.run.errors import FiptError
from ...core.run.runfolder import RunFolder
from ..image_datablocks import load_radiance
from ..marks import LARGE_PHOTOGRAPH, PIXEL_ASPECT, RESOLUTION, SPLIT, VIEW, view_cameras
from ..outliner import CAMERAS, collection
from ..render_settings import fitted, is_set
from .view_geometry import ViewGeometry

_SIZE = 0.03  # display size of cameras, as a share of the extent of their positions
_UNEVEN = 1e-3  # tolerance for the axes of a camera: equal lengths and right angles
_LENS = ("lens", "sensor_width", "sensor_height", "sensor_fit", "shift_x", "shift_y")


def display_size(capture: CapturedViews) -> float:
    """Display size of a capture's cameras in metres, small enough for cameras in a small room."""
    positions = np.array([np.array(view.camera_to_world)[:3, 3] for view in capture.views])
    return float(np.clip(_SIZE * np.linalg.norm(np.ptp(positions, axis=0)), 1e-3, 1.0)) or 0.1


def add_camera(
    scene: bpy.types.Scene,
    run: RunFolder,
    view: CapturedView,
    photograph: bool = True,
    parent: bpy.types.Object | None = None,
) -> bpy.types.Object:
    """The camera of one view, added to "FIPT Cameras" or updated; the artist's own camera is not changed.

    Args:
        scene: the scene to add it to.
        run: the run folder, for the photograph's path.
        view: an entry of capture.json's views.
        photograph: show the photograph as the camera's background image.
        parent: parent of the camera; the view's pose is then in the parent's space.
    """
    target = collection(scene, CAMERAS)
    item = next((camera for camera in target.objects if camera.get(VIEW) == view.name), None)
    if item is None:
        camera_of_artist = view_cameras(scene).get(view.name)
        if camera_of_artist is not None:
            return camera_of_artist
        item = bpy.data.objects.new(view.name, bpy.data.cameras.new(view.name))
        target.objects.link(item)
    if parent is not None:
        item.parent = parent
        item.matrix_parent_inverse = Matrix.Identity(4)
    lens = conventions.intrinsics_to_blender(view.width, view.height, view.fx, view.fy, view.cx, view.cy)
    item.data.type = "PERSP"
    set_lens(item.data, lens)
    item.data.clip_start, item.data.clip_end = 0.001, 10000.0
    item.data.dof.use_dof = False
    matrix = Matrix(conventions.opencv_to_blender_camera(np.array(view.camera_to_world)).tolist())
    if parent is None:
        item.matrix_world = matrix
    else:
        item.matrix_basis = matrix
    mark_camera(item, view, lens)
    if photograph:
        _set_background(item.data, _load_photograph(run, view))
    return item


def set_lens(camera: bpy.types.Camera, parameters: conventions.BlenderCamera) -> None:
    """Set lens, sensor and shift; the pixel aspect is the scene's."""
    for name in _LENS:
        setattr(camera, name, getattr(parameters, name))


def mark_camera(item: bpy.types.Object, view: CapturedView, parameters: conventions.BlenderCamera) -> None:
    """Store with a camera object which view it shows, and its render size."""
    item[VIEW] = view.name
    item[SPLIT] = view.split
    item[RESOLUTION] = [view.width, view.height]
    item[PIXEL_ASPECT] = [parameters.pixel_aspect_x, parameters.pixel_aspect_y]


def _load_photograph(run: RunFolder, view: CapturedView) -> bpy.types.Image | None:
    """A view's photograph, or its smaller copy where it has one; None where the file is missing."""
    path = run.resolve(view.image)
    shown = run.resolve(view.preview) if view.preview else path
    image = load_radiance(shown, view.encoded) if path.is_file() else None
    if image is not None and view.preview:
        image[LARGE_PHOTOGRAPH] = str(path)
    return image


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


def find_camera(view_name: str, scene: bpy.types.Scene) -> bpy.types.Object:
    """The camera of a view in a scene."""
    camera = view_cameras(scene).get(view_name)
    if camera is None:
        raise FiptError("view-missing.find-camera", view_name=view_name)
    return camera


def lens_of(camera: bpy.types.Camera, pixel_aspect: Sequence[float]) -> conventions.BlenderCamera:
    """A camera's lens parameters, with the pixel aspect (x, y) of what it renders."""
    return conventions.BlenderCamera(*(getattr(camera, name) for name in _LENS), *pixel_aspect)


def camera_geometry(scene: bpy.types.Scene, camera: bpy.types.Object) -> ViewGeometry:
    """A camera's pinhole model at its photograph's resolution, or at the scene's where it has none."""
    data, render = camera.data, scene.render
    if data.type != "PERSP":
        raise FiptError("camera-kind", name=camera.name)
    share = render.resolution_percentage / 100.0
    scene_size = [int(render.resolution_x * share), int(render.resolution_y * share)]
    width, height = (int(value) for value in camera.get(RESOLUTION, scene_size))
    aspect = camera.get(PIXEL_ASPECT, (render.pixel_aspect_x, render.pixel_aspect_y))
    parameters = lens_of(data, aspect)
    pose = conventions.blender_to_opencv_camera(world_matrix(camera))
    lens = conventions.blender_to_intrinsics(width, height, parameters)
    return ViewGeometry(pose, width, height, *lens)


def camera_pose(camera: bpy.types.Object) -> np.ndarray:
    """Camera-to-world (4, 4) float64, OpenCV axes, without the scale of its parents."""
    matrix = world_matrix(camera)
    axes = matrix[:3, :3]
    lengths = np.linalg.norm(axes, axis=0)
    unit = axes / np.maximum(lengths, 1e-30)
    uneven = np.ptp(lengths) > _UNEVEN * lengths.mean() or np.abs(unit.T @ unit - np.eye(3)).max() > _UNEVEN
    if uneven or np.linalg.det(unit) < 0.0 or lengths.min() < 1e-20:
        raise FiptError("alignment-uneven", name=camera.name)
    u, _, vt = np.linalg.svd(unit)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = u @ vt, matrix[:3, 3]
    return conventions.blender_to_opencv_camera(pose)


def world_matrix(item: bpy.types.Object) -> np.ndarray:
    """An object's 4x4 world matrix, also where Blender has not evaluated it since it was moved.

    Blender does not update `matrix_world` of hidden objects.
    """
    if item.constraints or item.animation_data or (item.parent and item.parent_type != "OBJECT"):
        return np.array(item.matrix_world, np.float64)
    basis = np.array(item.matrix_basis, np.float64)
    if item.parent is None:
        return basis
    return world_matrix(item.parent) @ np.array(item.matrix_parent_inverse, np.float64) @ basis


def use_view(scene: bpy.types.Scene, camera: bpy.types.Object) -> None:
    """Make a camera the scene's, with its photograph's resolution and pixel aspect.

    Once the render settings are set up, the frame gets the photograph's proportions alone: how large pictures
    are is the artist's choice.
    """
    scene.camera = camera
    render, sized = scene.render, is_set(scene)
    if RESOLUTION in camera:
        size = (int(camera[RESOLUTION][0]), int(camera[RESOLUTION][1]))
        size = fitted(size, max(render.resolution_x, render.resolution_y)) if sized else size
        render.resolution_x, render.resolution_y = size
        render.pixel_aspect_x, render.pixel_aspect_y = (float(value) for value in camera[PIXEL_ASPECT])
    if not sized:
        render.resolution_percentage = 100
        render.use_border = False
