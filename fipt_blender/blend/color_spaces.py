"""Colours between the engine, which works in linear Rec.709, and Blender's scene-linear space.

The two are the same by default. The working space of a file (from Blender 5.0) and an OpenColorIO
configuration (environment variable OCIO) can make scene-linear another space, such as ACEScg, and a
configuration can give colour spaces any names.
"""

from __future__ import annotations

from functools import lru_cache

import bpy
import numpy as np
from mathutils import Color
from numpy.typing import ArrayLike

from ..core.run.errors import FiptError
from .png16 import decode_srgb, encode_png

_PROBE = np.array([[[0.5, 0.2, 0.8], [0.9, 0.6, 0.1], [0.05, 0.7, 0.4]]])


def scene_matrix() -> np.ndarray:
    """(3, 3) that turns linear Rec.709 into the open file's scene-linear space; the identity by default."""
    columns = [Color(row).from_rec709_linear_to_scene_linear() for row in np.eye(3).tolist()]
    matrix = np.array(columns).T
    return np.eye(3) if np.allclose(matrix, np.eye(3), atol=1e-4) else matrix


def to_scene_linear(rgb: ArrayLike) -> np.ndarray:
    """Linear Rec.709 (..., 3) as scene-linear values; the same values where the spaces are the same."""
    return _times(scene_matrix(), rgb)


def from_scene_linear(rgb: ArrayLike) -> np.ndarray:
    """Scene-linear values (..., 3) as linear Rec.709, negative where that has no such colour."""
    return _times(np.linalg.inv(scene_matrix()), rgb)


def _times(matrix: np.ndarray, rgb: ArrayLike) -> np.ndarray:
    values = np.asarray(rgb)
    return values if np.array_equal(matrix, np.eye(3)) else (values @ matrix.T).astype(values.dtype)


def linear_space() -> str:
    """The configuration's name of linear Rec.709."""
    return _named("linear Rec.709")


def encoded_space() -> str:
    """The configuration's name of sRGB's codes."""
    return _named("sRGB")


def set_view_transform(view: bpy.types.ColorManagedViewSettings, name: str) -> None:
    """Choose a view transform of Blender's own configuration; in others, which lack it, nothing changes."""
    try:
        view.view_transform = name
    except TypeError:
        return


def _named(meaning: str) -> str:
    name = _spaces()[meaning]
    if not name:
        raise FiptError("color-space-missing", meaning=meaning)
    return name


@lru_cache(maxsize=1)
def _spaces() -> dict[str, str]:
    """Names of colour spaces by what they do to a picture, since only its author knows what a name means."""
    image = bpy.data.images.new("FIPT Probe", 1, 1)
    try:
        content = encode_png(_PROBE)
        image.pack(data=content, data_len=len(content))
        image.source = "FILE"
        wanted = {
            "linear Rec.709": to_scene_linear(_PROBE[0]),
            "sRGB": to_scene_linear(decode_srgb(_PROBE[0])),
        }
        found = dict.fromkeys(wanted, "")
        settings = image.colorspace_settings
        names = [item.identifier for item in settings.bl_rna.properties["name"].enum_items]
        for name in sorted(names, key=lambda name: name not in ("Linear Rec.709", "sRGB")):
            settings.name = name
            if settings.is_data or len(image.pixels) != _PROBE.shape[1] * image.channels:
                continue
            values = np.empty(len(image.pixels), np.float32)
            image.pixels.foreach_get(values)
            values = values.reshape(-1, image.channels)[:, :3]
            for meaning, expected in wanted.items():
                if not found[meaning] and np.allclose(values, expected, rtol=2e-3, atol=1e-3):
                    found[meaning] = name
            if all(found.values()):
                break
        return found
    finally:
        bpy.data.images.remove(image)
