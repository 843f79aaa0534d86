"""Resampling of images to pinhole views, with COLMAP's camera models from pycolmap: distorted ones to what a
lens without distortion sees, panoramas to the faces of a cube.

pycolmap's image undistortion quantises to 8 bit, so that only its camera models are used, and float images
are resampled here.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pycolmap

from ..run.errors import FiptError
from .panorama import FACES, face_pinhole, with_margin
from .rig import Lens, Pinhole

# Pixels that are resampled at a time: so few stay in the processor's cache.
_BAND = 1 << 15


def lens_camera(lens: Lens, width: int, height: int) -> pycolmap.Camera:
    """The pycolmap camera of a lens."""
    try:
        camera = pycolmap.Camera(
            model=lens.model, width=width, height=height, params=np.array(lens.parameters, np.float64)
        )
        valid = camera.verify_params() and camera.is_spherical() == bool(lens.face)
    except (RuntimeError, ValueError, TypeError, KeyError, AttributeError):
        valid = False
    if not valid:
        raise FiptError(
            "camera-model.lens-camera", model=lens.model, number_of_parameters=len(lens.parameters)
        )
    return camera


def lens_pinhole(lens: Lens, width: int, height: int) -> Pinhole:
    """The intrinsics of a lens without its distortion, for the original image."""
    camera = lens_camera(lens, width, height)
    return face_pinhole(width) if lens.face else _pinhole(camera)


def is_distorted(lens: Lens, width: int, height: int) -> bool:
    """Whether a lens maps straight lines to curves; a fisheye does even if all its coefficients are zero."""
    camera = lens_camera(lens, width, height)
    return not (camera.is_perspective_pinhole() and camera.is_undistorted())


def undistorted_pinhole(lens: Lens, width: int, height: int) -> Pinhole:
    """The pinhole that a distorted image is resampled to; all its pixels lie inside the distorted image."""
    if lens.face:
        return face_pinhole(width)
    camera = lens_camera(lens, width, height)
    pinhole = _pinhole(pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(blank_pixels=0.0), camera))
    x, y = np.linspace(0.5, pinhole.width - 0.5, 33), np.linspace(0.5, pinhole.height - 0.5, 33)
    positions = _source_positions(camera, pinhole, lens.face, x, y)
    inside = (positions > -1.0).all() and (positions < [width + 1.0, height + 1.0]).all()
    grid = positions.reshape(len(y), len(x), 2)
    folds = (np.diff(grid[..., 0], axis=1) <= 0.0).any() or (np.diff(grid[..., 1], axis=0) <= 0.0).any()
    if folds or not inside:  # NaN included
        raise FiptError("camera-model.undistorted-pinhole", model=lens.model, parameters=lens.parameters)
    return pinhole


class Undistortion:
    """Resampling of a distorted image or a panorama to its `undistorted_pinhole`."""

    def __init__(self, lens: Lens, width: int, height: int) -> None:
        self.pinhole = undistorted_pinhole(lens, width, height)
        self._source_shape, self._margin = (height, width), int(bool(lens.face))
        camera = lens_camera(lens, width, height)
        width, height = width + 2 * self._margin, height + 2 * self._margin
        count = self.pinhole.width * self.pinhole.height
        # The upper left one of the four pixels around each position; 32 bits hold the index of any pixel
        # (`encoded.MOST_PIXELS`). And where between them it is, 0 to 1.
        self._first = np.empty(count, np.int32)
        self._right, self._down = np.empty(count, np.float32), np.empty(count, np.float32)
        columns, lines = np.arange(self.pinhole.width) + 0.5, np.arange(self.pinhole.height) + 0.5
        step = max(1, _BAND // self.pinhole.width)
        for begin in range(0, self.pinhole.height, step):
            positions = _source_positions(
                camera, self.pinhole, lens.face, columns, lines[begin : begin + step]
            )
            positions += self._margin
            x = np.clip(positions[:, 0] - 0.5, 0.0, width - 1.0)
            y = np.clip(positions[:, 1] - 0.5, 0.0, height - 1.0)
            left = np.minimum(np.floor(x), max(width - 2, 0)).astype(np.int32)
            top = np.minimum(np.floor(y), max(height - 2, 0)).astype(np.int32)
            rows = slice(begin * self.pinhole.width, begin * self.pinhole.width + len(x))
            self._first[rows], self._right[rows], self._down[rows] = top * width + left, x - left, y - top
        # To the pixels on the right and below
        self._across, self._below = min(width - 1, 1), width * min(height - 1, 1)

    def image(self, pixels: np.ndarray) -> np.ndarray:
        """Resample an image (source height, source width, C) bilinearly to (height, width, C) float32."""
        source = self._source(pixels)
        channels = source.shape[2]
        flat = np.ascontiguousarray(source, np.float32).reshape(-1, channels)
        result = np.empty((len(self._first), channels), np.float32)
        for begin in range(0, len(result), _BAND):
            rows = slice(begin, begin + _BAND)
            first = self._first[rows]
            # A weight for each channel: numpy is slow along short axes.
            u, v = np.repeat(self._right[rows], channels), np.repeat(self._down[rows], channels)
            corners = (
                (first, (1.0 - u) * (1.0 - v)),
                (first + self._across, u * (1.0 - v)),
                (first + self._below, (1.0 - u) * v),
                (first + (self._across + self._below), u * v),
            )
            total = np.zeros(len(u), np.float32)
            for index, weight in corners:
                # No index is clipped; to check that would take longer.
                corner = flat.take(index, axis=0, mode="clip").reshape(-1)
                corner *= weight
                total += corner
            result[rows] = total.reshape(-1, channels)
        return result.reshape(self.pinhole.height, self.pinhole.width, -1)

    def ids(self, ids: np.ndarray) -> np.ndarray:
        """Resample an id image (source height, source width) by nearest neighbour."""
        nearest = self._first + self._across * (self._right >= 0.5) + self._below * (self._down >= 0.5)
        return self._source(ids).ravel()[nearest].reshape(self.pinhole.height, self.pinhole.width)

    def _source(self, pixels: np.ndarray) -> np.ndarray:
        if pixels.shape[:2] != self._source_shape:
            raise ValueError(f"an image of {pixels.shape[:2]} for a camera of {self._source_shape}")
        return with_margin(pixels) if self._margin else pixels


def undistortion(lens: Lens, width: int, height: int) -> Undistortion:
    """The resampling of a lens; the last ones are cached."""
    return (_of_face if lens.face else _of_lens)(lens, width, height)


# Usually there is one camera, in landscape and portrait; each entry is large.
_of_lens, _of_face = lru_cache(maxsize=2)(Undistortion), lru_cache(maxsize=len(FACES))(Undistortion)


def _pinhole(camera: pycolmap.Camera) -> Pinhole:
    return Pinhole(
        int(camera.width),
        int(camera.height),
        float(camera.focal_length_x),
        float(camera.focal_length_y),
        float(camera.principal_point_x),
        float(camera.principal_point_y),
    )


def _source_positions(
    camera: pycolmap.Camera, pinhole: Pinhole, face: str, columns: np.ndarray, rows: np.ndarray
) -> np.ndarray:
    """(rows * columns, 2) positions x, y in the distorted image or the panorama, in pixels.

    Args:
        face: of a panorama, or "".
        columns, rows: positions in the undistorted image, in pixels.
    """
    x, y = np.meshgrid((columns - pinhole.cx) / pinhole.fx, (rows - pinhole.cy) / pinhole.fy)
    points = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
    return np.array(camera.img_from_cam(points @ FACES[face].T if face else points))
