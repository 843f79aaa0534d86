"""Equirectangular panoramas, which are read as six pinhole views: the faces of a cube around the camera.

The camera has the axes of COLMAP's model EQUIRECTANGULAR: Z points to the image's centre, X to the right of
it, Y down.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..run.errors import FiptError
from .rig import EQUIRECTANGULAR, Lens, Pinhole, RigView

_X, _Y, _Z = np.eye(3)
# The views' axes X, Y and Z (right, down, forward) in the panorama's camera, as columns.
FACES = {
    "front": np.stack([_X, _Y, _Z], axis=1),
    "right": np.stack([-_Z, _Y, _X], axis=1),
    "back": np.stack([-_X, _Y, -_Z], axis=1),
    "left": np.stack([_Z, _Y, -_X], axis=1),
    "up": np.stack([_X, _Z, -_Y], axis=1),
    "down": np.stack([_X, -_Z, _Y], axis=1),
}
HEAD_BYTES = 1 << 18  # of a file, among which its XMP is: EXIF with a thumbnail, 64 KB at most, goes before
_GPANO = re.compile(rb'GPano:ProjectionType\s*(?:=\s*"|>)\s*equirectangular', re.IGNORECASE)


def pinhole_views(view: RigView) -> list[RigView]:
    """The six views of a panorama; any other view itself."""
    if view.lens.model != EQUIRECTANGULAR or view.lens.face:
        return [view]
    if view.width != 2 * view.height:
        raise FiptError("panorama-shape", image=view.image, width=view.width, height=view.height)
    views = []
    for face, axes in FACES.items():
        pose = view.camera_to_world.copy()
        pose[:3, :3] = pose[:3, :3] @ axes
        lens = replace(view.lens, face=face)
        views.append(replace(view, name=f"{view.name}@{face}", lens=lens, camera_to_world=pose))
    return views


def face_pinhole(width: int) -> Pinhole:
    """The pinhole of a face of a panorama `width` pixels wide.

    The pixels in its middle have the solid angle of the panorama's at the horizon, where these are largest.
    """
    side = max(round(width / math.pi), 1)
    return Pinhole(side, side, *(4 * (0.5 * side,)))


def with_margin(pixels: np.ndarray) -> np.ndarray:
    """A panorama (H, W, ...) with one pixel more on each side: what it shows beyond its edges and poles."""
    half = pixels.shape[1] // 2
    rows = np.concatenate([np.roll(pixels[:1], half, 1), pixels, np.roll(pixels[-1:], half, 1)])
    return np.concatenate([rows[:, -1:], rows, rows[:, :1]], axis=1)


def placed_panorama(image: Path, size: tuple[int, int], place: tuple[float, ...], heading: float) -> RigView:
    """An upright panorama that the user has placed.

    Args:
        image: its file.
        size: width and height in pixels.
        place: of the camera, (3,) metres, Z up.
        heading: degrees by which the image's centre is turned from Y about Z, as a camera in Blender is.
    """
    sine, cosine = math.sin(math.radians(heading)), math.cos(math.radians(heading))
    pose = np.eye(4)
    # Right, down and forward
    pose[:3, :3] = np.stack([[cosine, sine, 0.0], -_Z, [-sine, cosine, 0.0]], axis=1)
    pose[:3, 3] = place
    lens = Lens(EQUIRECTANGULAR, (float(size[0]), float(size[1])))
    return RigView(image.stem, "train", image, *size, lens, pose)


def says_panorama(path: Path, size: tuple[int, int]) -> bool:
    """Whether a photograph of a size is an equirectangular panorama by Google's metadata (GPano)."""
    if size[0] != 2 * size[1]:
        return False
    with path.open("rb") as file:
        return _GPANO.search(file.read(HEAD_BYTES)) is not None
