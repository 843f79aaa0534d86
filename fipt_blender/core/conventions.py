"""All conversions of axes, units and scale; no other module converts them.

Internal conventions: the world is Blender's (right-handed, Z up, metres); poses are camera-to-world with
OpenCV axes (X right, Y down, Z forward); pixel (0, 0) is top left, with its centre at (0.5, 0.5). Both
processes import this module, so that it needs only numpy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .run.shapes import SCALES
from .run.shapes import UP_AXES as UP_AXES

FloatArray = NDArray[np.floating]

# Other camera axes, expressed in OpenCV's; each matrix is its own inverse.
_OPENGL_AXES = np.diag([1.0, -1.0, -1.0, 1.0])  # X right, Y up, Z backward: Blender, OpenGL, NeRF
_FIPT_AXES = np.diag([-1.0, -1.0, 1.0, 1.0])  # X left, Y up, Z forward: the FIPT authors' synthetic data
# What camera axes are called, what they are, and their matrix.
CAMERA_AXES = {
    "opencv": ("of OpenCV (X right, Y down, Z forward)", np.eye(4)),
    "opengl": ("of OpenGL and Blender (X right, Y up, Z backward)", _OPENGL_AXES),
    "pytorch3d": ("of PyTorch3D (X left, Y up, Z forward)", _FIPT_AXES),
}


class PinholeView(Protocol):
    """A pinhole camera, as rays and projection need it; `core.capture.views.View` is one."""

    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def fx(self) -> float: ...
    @property
    def fy(self) -> float: ...
    @property
    def cx(self) -> float: ...
    @property
    def cy(self) -> float: ...
    @property
    def camera_to_world(self) -> FloatArray: ...


# --- camera axes -----------------------------------------------------------------------------------------


def opencv_to_blender_camera(camera_to_world: ArrayLike) -> FloatArray:
    """Camera-to-world (..., 4, 4) with OpenCV axes to a Blender camera's `matrix_world` (Y and Z negated).

    A Blender camera has OpenGL's axes, as those of NeRF and instant-ngp; the way back is the same.
    """
    return np.asarray(camera_to_world, np.float64) @ _OPENGL_AXES


blender_to_opencv_camera = opengl_to_opencv_camera = opencv_to_opengl_camera = opencv_to_blender_camera


def fipt_to_opencv_camera(camera_to_world: ArrayLike) -> FloatArray:
    """Camera-to-world (..., 4, 4) of the FIPT authors' synthetic data (X left, Y up, Z forward) to OpenCV."""
    return np.asarray(camera_to_world, np.float64) @ _FIPT_AXES


# --- world axes, scale -----------------------------------------------------------------------------------


def world_from_source(up_axis: str, metres_per_unit: float = 1.0) -> FloatArray:
    """Similarity (4, 4) from source coordinates to Blender's world: up is rotated to Z, then scaled.

    Args:
        up_axis: the source axis that points up, one of `UP_AXES`. For "y", (x, y, z) becomes (x, -z, y), as
            in Blender's importers.
        metres_per_unit: length of one source unit in metres.

    Raises:
        ValueError: for an unknown axis, or a scale outside of `SCALES`.
    """
    if up_axis not in UP_AXES:
        raise ValueError(f"up axis '{up_axis}' is not one of {', '.join(UP_AXES)}")
    if not SCALES[0] <= metres_per_unit <= SCALES[1]:
        raise ValueError(f"scale is {metres_per_unit:g}, not from {SCALES[0]:g} to {SCALES[1]:g}")
    rotations = {
        "x": [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        "-x": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
        "y": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
        "-y": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
        "z": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "-z": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    }
    similarity = np.eye(4)
    similarity[:3, :3] = np.array(rotations[up_axis], np.float64) * metres_per_unit
    return similarity


def split_similarity(similarity: ArrayLike) -> tuple[float, FloatArray, FloatArray]:
    """Split a similarity (4, 4) into scale (one positive number), rotation (3, 3) and translation (3,)."""
    matrix = np.asarray(similarity, np.float64)
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    return scale, matrix[:3, :3] / scale, matrix[:3, 3]


def transform_poses(similarity: ArrayLike, camera_to_world: ArrayLike) -> FloatArray:
    """Transform poses (..., 4, 4) by a similarity (4, 4); rotations stay orthonormal."""
    poses = np.array(camera_to_world, np.float64)
    _, rotation, _ = split_similarity(similarity)
    poses[..., :3, 3] = transform_points(similarity, poses[..., :3, 3])
    poses[..., :3, :3] = rotation @ poses[..., :3, :3]
    return poses


def transform_points(similarity: ArrayLike, points: ArrayLike) -> FloatArray:
    """Transform points (..., 3) by a similarity (4, 4)."""
    matrix = np.asarray(similarity, np.float64)
    return np.asarray(points, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def similarity_of_poses(source: FloatArray, target: FloatArray) -> FloatArray:
    """The similarity (4, 4) that maps poses (N, 4, 4) to others: rotation first, then scale and shift."""
    u, _, vt = np.linalg.svd(np.einsum("nij,nkj->ik", target[:, :3, :3], source[:, :3, :3]))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    start, end = source[:, :3, 3] @ rotation.T, target[:, :3, 3]
    spread = np.linalg.norm(start - start.mean(axis=0))
    scale = float(np.linalg.norm(end - end.mean(axis=0)) / spread) if spread > 0.0 else 1.0
    result = np.eye(4)
    result[:3, :3] = scale * rotation
    result[:3, 3] = end.mean(axis=0) - scale * start.mean(axis=0)
    return result


# --- pinhole rays ----------------------------------------------------------------------------------------


def rays_at(view: PinholeView, pixels: ArrayLike, z_depth: bool = False) -> tuple[FloatArray, FloatArray]:
    """World rays through image positions.

    Args:
        view: a pinhole view.
        pixels: (N, 2) image positions x, y in pixels; the centre of the first pixel is (0.5, 0.5).
        z_depth: scale each direction to length 1 along the camera's Z, so that a ray's parameter is the
            depth; otherwise directions are unit vectors and the parameter is the distance.

    Returns:
        origins (N, 3) and directions (N, 3), float32, Blender world.
    """
    positions = np.asarray(pixels, np.float64)
    camera = np.empty((len(positions), 3))
    camera[:, 0] = (positions[:, 0] - view.cx) / view.fx
    camera[:, 1] = (positions[:, 1] - view.cy) / view.fy
    camera[:, 2] = 1.0
    if not z_depth:
        camera /= np.linalg.norm(camera, axis=1, keepdims=True)
    pose = np.asarray(view.camera_to_world, np.float64)
    directions = (camera @ pose[:3, :3].T).astype(np.float32)
    origins = np.broadcast_to(pose[:3, 3].astype(np.float32), directions.shape).copy()
    return origins, directions


def pixel_rays(view: PinholeView, z_depth: bool = False) -> tuple[FloatArray, FloatArray]:
    """World rays through all pixel centres of a view, row by row from the top left.

    Returns:
        origins (height*width, 3) and directions (height*width, 3), float32; see `rays_at` for `z_depth`.
    """
    x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    return rays_at(view, np.stack([x.ravel(), y.ravel()], axis=1), z_depth)


def project(points: ArrayLike, view: PinholeView) -> tuple[FloatArray, FloatArray]:
    """Project world points into a view.

    Args:
        points: (N, 3) Blender world.
        view: a pinhole view.

    Returns:
        pixels (N, 2), NaN for points not in front of the camera, and depth (N,) along the camera's Z in
        metres, both float64. Points outside the field of view have positions outside the image.
    """
    pose = np.asarray(view.camera_to_world, np.float64)
    camera = (np.asarray(points, np.float64) - pose[:3, 3]) @ pose[:3, :3]
    depth = camera[:, 2]
    safe = np.where(depth > 0.0, depth, np.nan)
    x = view.fx * camera[:, 0] / safe + view.cx
    y = view.fy * camera[:, 1] / safe + view.cy
    return np.stack([x, y], axis=1), depth


# --- Blender's camera parameters -------------------------------------------------------------------------


@dataclass(frozen=True)
class BlenderCamera:
    """Blender's parameters of a pinhole camera: camera data (lens and sensor in mm, shifts), render settings.

    `pixel_aspect_x` and `pixel_aspect_y` belong to the scene's render settings, the rest to the camera.
    """

    lens: float
    sensor_width: float = 36.0
    sensor_height: float = 24.0
    sensor_fit: str = "HORIZONTAL"
    shift_x: float = 0.0
    shift_y: float = 0.0
    pixel_aspect_x: float = 1.0
    pixel_aspect_y: float = 1.0


def intrinsics_to_blender(
    width: int, height: int, fx: float, fy: float, cx: float, cy: float, sensor_width: float = 36.0
) -> BlenderCamera:
    """Blender's camera parameters of a pinhole camera with intrinsics in pixels.

    The sensor fit is always horizontal, so that landscape and portrait are not distinguished. fx != fy
    becomes the pixel aspect (both of Blender's values are at least 1), the principal point the shift.
    """
    aspect = fx / fy  # height of a pixel over its width
    return BlenderCamera(
        lens=fx * sensor_width / width,
        sensor_width=sensor_width,
        sensor_height=sensor_width * height * aspect / width,
        sensor_fit="HORIZONTAL",
        shift_x=(0.5 * width - cx) / width,
        shift_y=(cy - 0.5 * height) * aspect / width,
        pixel_aspect_x=max(1.0, 1.0 / aspect),
        pixel_aspect_y=max(1.0, aspect),
    )


def fits_width(sensor_fit: str, width: float, height: float) -> bool:
    """Whether Blender fits a sensor to the width of a frame of this displayed size, or to its height."""
    return sensor_fit == "HORIZONTAL" or (sensor_fit == "AUTO" and width >= height)


def blender_to_intrinsics(
    width: int, height: int, camera: BlenderCamera
) -> tuple[float, float, float, float]:
    """Intrinsics (fx, fy, cx, cy) in pixels of a Blender perspective camera of any sensor fit."""
    aspect = camera.pixel_aspect_y / camera.pixel_aspect_x
    # Lens and shift are relative to the fitted side, in pixel widths; AUTO uses the sensor's width for the
    # longer side.
    is_wide = fits_width(camera.sensor_fit, width, aspect * height)
    side = float(width) if is_wide else aspect * height
    sensor = camera.sensor_height if camera.sensor_fit == "VERTICAL" else camera.sensor_width
    fx = camera.lens * side / sensor
    return (
        fx,
        fx / aspect,
        0.5 * width - camera.shift_x * side,
        0.5 * height + camera.shift_y * side / aspect,
    )


# --- environment maps ------------------------------------------------------------------------------------


def direction_to_equirect(directions: ArrayLike) -> FloatArray:
    """Texture coordinates of directions in Blender's equirectangular world texture (Z up).

    Args:
        directions: (..., 3) Blender world, away from the scene, of any length above zero.

    Returns:
        (..., 2) u to the right and v upward, both in [0, 1]; u = 0.5 - atan2(y, x)/(2 pi),
        v = 0.5 + asin(z)/pi: the centre is +X, and -Y is at u = 0.75.
    """
    vectors = np.asarray(directions, np.float64)
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    u = 0.5 - np.arctan2(y, x) / (2.0 * np.pi)
    v = 0.5 + np.arctan2(z, np.hypot(x, y)) / np.pi
    return np.stack([u, v], axis=-1)


def equirect_to_direction(uv: ArrayLike) -> FloatArray:
    """Unit directions (..., 3), Blender world, at positions (..., 2) of an equirectangular map (V up)."""
    positions = np.asarray(uv, np.float64)
    azimuth = (0.5 - positions[..., 0]) * 2.0 * np.pi
    elevation = (positions[..., 1] - 0.5) * np.pi
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1)


def equirect_pixel_directions(width: int, height: int) -> FloatArray:
    """Unit directions (height, width, 3) of the pixel centres of an equirectangular image, top row first."""
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, 1.0 - (np.arange(height) + 0.5) / height)
    return equirect_to_direction(np.stack([u, v], axis=-1))
