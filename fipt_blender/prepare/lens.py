"""What EXIF and lensfun's database know of a photograph's lens: focal length, vignetting, distortion.

Vignetting is divided out of the merged radiance. Distortion is only where the camera solve starts from: it
stays in the camera model, so that a photograph is resampled once, by `ingest`.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import lensfunpy
import numpy as np

from .preparation import Photograph

FULL_FRAME_DIAGONAL = math.hypot(36.0, 24.0)  # mm, to which EXIF's equivalent focal length refers
ROOM_DISTANCE = 3.0  # metres: EXIF rarely contains the distance of focus, and rooms are this large
RADII = 513  # of a profile of light: so many that straight lines between them are exact enough
LEAST_LIGHT = 0.05  # in a corner; less is a mistake of the database, and would amplify noise beyond use
_SAMPLES = 256  # pixels of the longer side of lensfun's maps, which are smooth
_FOCAL_TOLERANCE = 0.03  # a lens whose zoom range ends by more than this from EXIF's value is another one


def start(photograph: Photograph, width: int, height: int) -> tuple[float | None, tuple[float, float]]:
    """Where a solve starts for images of a size: focal length in pixels, and COLMAP's RADIAL coefficients.

    Where lensfun knows the lens, it is the RADIAL camera that comes closest to its distortion; None where
    EXIF does not give the focal length.

    Args:
        photograph: its EXIF.
        width, height: pixels of the image of the whole sensor, in either orientation.
    """
    focal = focal_pixels(photograph, width, height)
    if focal is None:
        return None, (0.0, 0.0)
    small_width, small_height = _small_size(width, height)
    modifier = _modifier(photograph, small_width, small_height, lensfunpy.ModifyFlags.DISTORTION)
    source = None if modifier is None else modifier.apply_geometry_distortion()
    if source is None:
        return focal, (0.0, 0.0)
    focal_small = focal * small_width / max(width, height)
    y, x = np.mgrid[0:small_height, 0:small_width]
    center = np.array([0.5 * (small_width - 1), 0.5 * (small_height - 1)])
    straight = (np.stack([x, y], axis=-1).reshape(-1, 2) - center) / focal_small
    bent = (source.reshape(-1, 2) - center) / focal_small
    radii = (straight**2).sum(axis=1, keepdims=True)
    # The least squares of bent = s · straight (1 + k1 r² + k2 r⁴).
    columns = np.stack([straight, straight * radii, straight * radii**2]).reshape(3, -1).T
    scale, first, second = map(float, np.linalg.lstsq(columns, bent.ravel(), rcond=None)[0])
    # s · x (1 + a r²) is a camera of the focal length s · f whose coefficients refer to the same x.
    return focal * scale, (first / scale, second / scale)


def focal_pixels(photograph: Photograph, width: int, height: int) -> float | None:
    """The focal length in pixels of an image of the whole sensor, None where it is unknown."""
    equivalent = photograph.focal_35mm
    if not equivalent and photograph.focal_length:
        camera, _ = _found(photograph.make, photograph.model, photograph.lens)
        equivalent = photograph.focal_length * camera.crop_factor if camera else None
    if not equivalent:
        return None
    return equivalent / FULL_FRAME_DIAGONAL * math.hypot(width, height)


def light_share(profile: np.ndarray, width: int, height: int) -> np.ndarray:
    """The share of the light that reaches each pixel (height, width) float32.

    Args:
        profile: (RADII,) share at equal steps of the radius from the center to the corner.
        width, height: pixels of the image.
    """
    x = (np.arange(width) + 0.5 - 0.5 * width) ** 2
    y = (np.arange(height) + 0.5 - 0.5 * height) ** 2
    radius = np.sqrt((y[:, None] + x[None, :]) / (0.25 * (width**2 + height**2)))
    return np.interp(radius, np.linspace(0.0, 1.0, RADII), profile).astype(np.float32)


@lru_cache(maxsize=64)
def _found(make: str, model: str, name: str) -> tuple[Any, Any]:
    """lensfun's camera and lens, each may be None; where no lens is named, the only one."""
    database = _database()
    cameras = database.find_cameras(make, model) if make and model else []
    lenses = database.find_lenses(cameras[0], None, name or None) if cameras else []
    return cameras[0] if cameras else None, lenses[0] if lenses and (name or len(lenses) == 1) else None


@lru_cache(maxsize=1)
def _database() -> Any:
    return lensfunpy.Database()


def _modifier(photograph: Photograph, width: int, height: int, flags: int) -> Any:
    """lensfun's correction of an image of this size, None where the lens is unknown."""
    camera, lens = _found(photograph.make, photograph.model, photograph.lens)
    focal = photograph.focal_length
    if lens is None or not focal:
        return None
    low, high = lens.min_focal, lens.max_focal or lens.min_focal
    if not low * (1.0 - _FOCAL_TOLERANCE) <= focal <= high * (1.0 + _FOCAL_TOLERANCE):
        return None
    modifier = lensfunpy.Modifier(lens, camera.crop_factor, width, height)
    aperture = photograph.aperture or lens.min_aperture or 8.0
    modifier.initialize(focal, aperture, ROOM_DISTANCE, scale=1.0, pixel_format=np.float32, flags=flags)
    return modifier


def _small_size(width: int, height: int) -> tuple[int, int]:
    """Of a landscape image with these proportions."""
    return _SAMPLES, max(2, round(_SAMPLES * min(width, height) / max(width, height)))


def vignetting(photograph: Photograph) -> np.ndarray | None:
    """(RADII,) profile of `light_share` by lensfun's database, None for unknown lenses."""
    width, height = _small_size(photograph.width, photograph.height)
    modifier = _modifier(photograph, width, height, lensfunpy.ModifyFlags.VIGNETTING)
    gain = np.ones((height, width, 3), np.float32)
    if modifier is None or not modifier.apply_color_modification(gain):
        return None
    # lensfun's radius is 1 in the middle of the corner's pixel, which a large image has in its corner.
    y, x = np.mgrid[1.0 - height : height : 2, 1.0 - width : width : 2]
    radius = np.hypot(x, y).ravel() / np.hypot(width - 1, height - 1)
    order = np.argsort(radius)
    profile = np.interp(np.linspace(0.0, 1.0, RADII), radius[order], 1.0 / gain[..., 1].ravel()[order])
    return profile if profile.min() > LEAST_LIGHT else None
