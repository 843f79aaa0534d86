# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What EXIF and lensfun's database know of a photograph's lens: focal length, vignetting, distortion.

Vignetting is divided out of the merged radiance. Distortion is only where the camera solve starts from: it
stays in the camera model, so that a photograph is resampled once, by `ingest`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import lensfunpy
import numpy as np

FULL_FRAME_DIAGONAL = math.hypot(36.0, 24.0)  # mm, to which EXIF's equivalent focal length refers
ROOM_DISTANCE = 3.0  # metres: EXIF rarely contains the distance of focus, and rooms are this large
LEAST_LIGHT = 0.05  # in a corner; less is a mistake of the database, and would amplify noise beyond use
_SAMPLES = 256  # pixels of the longer side of lensfun's maps, which are smooth
_FOCAL_TOLERANCE = 0.03  # a lens whose zoom range ends by more than this from EXIF's value is another one


class Exif(Protocol):
    """What the lens needs of a photograph; `preparation.Photograph` is one."""

    @property
    def make(self) -> str: ...
    @property
    def model(self) -> str: ...
    @property
    def lens(self) -> str: ...
    @property
    def focal_length(self) -> float | None: ...
    @property
    def focal_35mm(self) -> float | None: ...
    @property
    def aperture(self) -> float | None: ...


@dataclass(frozen=True)
class RadialStart:
    """Intrinsics to start a solve from: focal length in pixels and COLMAP's RADIAL coefficients."""

    focal: float
    distortion: tuple[float, float]


def start(photograph: Exif, width: int, height: int) -> RadialStart | None:
    """Where a solve starts for images of a size; None where EXIF does not give the focal length.

    Args:
        photograph: its EXIF.
        width, height: pixels of the image of the whole sensor, in either orientation.
    """
    focal = focal_pixels(photograph, width, height)
    if focal is None:
        return None
    fitted = _fitted_distortion(photograph, focal, max(width, height), min(width, height))
    return RadialStart(focal, (0.0, 0.0)) if fitted is None else fitted


def focal_pixels(photograph: Exif, width: int, height: int) -> float | None:
    """The focal length in pixels of an image of the whole sensor, None where it is unknown."""
    equivalent = photograph.focal_35mm
    if not equivalent and photograph.focal_length:
        camera = _camera(photograph.make, photograph.model)
        equivalent = photograph.focal_length * camera.crop_factor if camera else None
    if not equivalent:
        return None
    return equivalent / FULL_FRAME_DIAGONAL * math.hypot(width, height)


def vignetting(photograph: Exif, width: int, height: int) -> np.ndarray | None:
    """Factors that undo a lens's vignetting: 1 in the center, more in the corners.

    Args:
        photograph: its EXIF.
        width, height: pixels of the image of the whole sensor, in either orientation.

    Returns:
        (height, width) float32; None where lensfun's database does not know the lens.
    """
    falloff = _falloff(photograph, max(width, height), min(width, height))
    return None if falloff is None else 1.0 / light_share(falloff, width, height)


def light_share(falloff: np.ndarray, width: int, height: int) -> np.ndarray:
    """The share of the light that reaches each pixel (height, width) float32, 1 in the center.

    Args:
        falloff: (3,) coefficients of r², r⁴ and r⁶, where r is 1 in the corner.
        width, height: pixels of the image.
    """
    x = (np.arange(width, dtype=np.float32) + 0.5 - 0.5 * width) ** 2
    y = (np.arange(height, dtype=np.float32) + 0.5 - 0.5 * height) ** 2
    squared = (y[:, None] + x[None, :]) / np.float32(0.25 * (width**2 + height**2))
    first, second, third = (np.float32(value) for value in falloff)
    return 1.0 + squared * (first + squared * (second + squared * third))


@lru_cache(maxsize=1)
def _database() -> Any:
    return lensfunpy.Database()


@lru_cache(maxsize=64)
def _camera(make: str, model: str) -> Any:
    """lensfun's camera, or None."""
    found = _database().find_cameras(make, model) if make and model else []
    return found[0] if found else None


@lru_cache(maxsize=64)
def _lens(make: str, model: str, name: str, focal: float) -> Any:
    """lensfun's lens, or None; a camera without a lens's name has one where it is built in."""
    camera = _camera(make, model)
    if camera is None:
        return None
    found = _database().find_lenses(camera, None, name or None)
    if not found or (not name and len(found) > 1):
        return None
    low, high = found[0].min_focal, found[0].max_focal
    within = low * (1.0 - _FOCAL_TOLERANCE) <= focal <= (high or low) * (1.0 + _FOCAL_TOLERANCE)
    return found[0] if within else None


def _modifier(photograph: Exif, width: int, height: int, flags: int) -> Any:
    """lensfun's correction of an image of this size, None where the lens is unknown."""
    if not photograph.focal_length:
        return None
    lens = _lens(photograph.make, photograph.model, photograph.lens, photograph.focal_length)
    if lens is None:
        return None
    camera = _camera(photograph.make, photograph.model)
    modifier = lensfunpy.Modifier(lens, camera.crop_factor, width, height)
    aperture = photograph.aperture or lens.min_aperture or 8.0
    modifier.initialize(
        photograph.focal_length, aperture, ROOM_DISTANCE, scale=1.0, pixel_format=np.float32, flags=flags
    )
    return modifier


def _small_size(width: int, height: int) -> tuple[int, int]:
    return _SAMPLES, max(2, round(_SAMPLES * height / width))


def _falloff(photograph: Exif, width: int, height: int) -> np.ndarray | None:
    """(3,) coefficients of `light_share`, None where lensfun does not know them.

    lensfun's model is the same polynomial, whose radius is in its own unit: a fit finds ours exactly.
    """
    width, height = _small_size(width, height)
    modifier = _modifier(photograph, width, height, lensfunpy.ModifyFlags.VIGNETTING)
    if modifier is None:
        return None
    gain = np.ones((height, width, 3), np.float32)
    if not modifier.apply_color_modification(gain):
        return None
    # lensfun's radius is 1 in the middle of the corner's pixel, which a large image has in its corner.
    y, x = np.mgrid[0:height, 0:width]
    squared = ((2.0 * x - (width - 1)) ** 2 + (2.0 * y - (height - 1)) ** 2).ravel()
    squared /= (width - 1) ** 2 + (height - 1) ** 2
    columns = np.stack([squared, squared**2, squared**3], axis=1)
    falloff, *_ = np.linalg.lstsq(columns, 1.0 / gain[..., 1].ravel().astype(np.float64) - 1.0, rcond=None)
    usable = light_share(falloff, width, height).min() > LEAST_LIGHT
    return falloff if usable else None


def _fitted_distortion(photograph: Exif, focal: float, width: int, height: int) -> RadialStart | None:
    """COLMAP's RADIAL camera that comes closest to lensfun's distortion, None where the lens is unknown."""
    small_width, small_height = _small_size(width, height)
    modifier = _modifier(photograph, small_width, small_height, lensfunpy.ModifyFlags.DISTORTION)
    if modifier is None:
        return None
    source = modifier.apply_geometry_distortion()
    if source is None:
        return None
    focal_small = focal * small_width / width
    y, x = np.mgrid[0:small_height, 0:small_width]
    center = np.array([0.5 * (small_width - 1), 0.5 * (small_height - 1)])
    straight = np.stack([x, y], axis=-1).reshape(-1, 2) - center
    bent = source.reshape(-1, 2) - center
    radii = (straight**2).sum(axis=1) / focal_small**2
    return fit_radial(straight / focal_small, bent / focal_small, radii, focal)


def fit_radial(straight: np.ndarray, bent: np.ndarray, radii: np.ndarray, focal: float) -> RadialStart:
    """The focal length and coefficients with which `bent` = s · `straight` (1 + k1 r² + k2 r⁴).

    Args:
        straight, bent: (N, 2) positions over the focal length, without and with distortion.
        radii: (N,) r² of `straight`.
        focal: in pixels, of both.
    """
    columns = np.stack([straight * factor[:, None] for factor in (np.ones_like(radii), radii, radii**2)])
    solution, *_ = np.linalg.lstsq(columns.reshape(3, -1).T, bent.ravel(), rcond=None)
    scale, first, second = (float(value) for value in solution)
    # s · x (1 + a r²) is a camera of the focal length s · f whose coefficients refer to the same x.
    return RadialStart(focal * scale, (first / scale, second / scale))
