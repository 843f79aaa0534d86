# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh from photographs alone: dense stereo where pycolmap was built with CUDA, fused like depth images.

The models' image names are data: copies get names of our own.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image

from ..depth.extraction import FusedMesh
from ..run.documents import read_limited
from ..run.errors import FiptError
from ..run.runfolder import PRODUCT_VERSION
from .colmap import NAME as COLMAP
from .colmap import find, opened
from .depth_images import Fusion, fuse
from .encoded import MOST_PIXELS, srgb_encoded
from .images import is_encoded, read_radiance, write_exr
from .rig import DepthView, Note, Rig, RigView, damaged

MOST_MAP_BYTES = 4 * MOST_PIXELS + 64


def stereo_possible(rig: Rig, otherwise: bool) -> Note | None:
    """Check that dense stereo can run; the note says why it can't where something else is made `otherwise`.

    Raises:
        FiptError: ``stereo-cuda`` or ``stereo-format`` where it can't and there is nothing else.
    """
    if rig.source != COLMAP:
        code, text = "stereo-format", f"Dense stereo needs a COLMAP model, not the format {rig.source}."
    elif not pycolmap.has_cuda:
        code, text = (
            "stereo-cuda",
            "Dense stereo needs a pycolmap that was built with CUDA; this one was not.",
        )
    else:
        return None
    remedy = "Make a mesh in another program, or use Room from Points (--plane-room)."
    if not otherwise:
        raise FiptError(code, text, remedy)
    return Note(code, text, "The room of planes is used instead. A scan or a model gives better results.")


@dataclass(frozen=True, eq=False)
class StereoFusion(Fusion):
    """A mesh that is fused from depth maps of dense stereo.

    Attributes:
        capture: folder of the COLMAP model.
        photographs: all views of the model, in the order in which they are read.
    """

    capture: Path = Path()
    photographs: Sequence[RigView] = ()

    def mesh(self, progress: Callable[[float], None]) -> FusedMesh:
        """Find depths and fuse them; see `fuse`.

        Raises:
            FiptError: ``stereo-failed``, or one of `fuse`.
        """
        with tempfile.TemporaryDirectory(prefix="fipt-stereo-") as temporary:
            views = stereo_depths(self.capture, self.photographs, Path(temporary), self.scale)
            return fuse(views, self.options, self.scale, progress)

    def _key(self) -> str:
        files = [[str(view.image), view.image.stat().st_mtime_ns] for view in self.photographs]
        poses = [[*view.camera_to_world.ravel(), *view.lens.parameters] for view in self.photographs]
        data = [PRODUCT_VERSION, "stereo", astuple(self.options), self.scale, files, poses]
        return hashlib.sha256(json.dumps(data).encode()).hexdigest()


def stereo_depths(
    capture: Path, photographs: Sequence[RigView], folder: Path, scale: float
) -> tuple[DepthView, ...]:
    """Depth images of COLMAP's dense stereo.

    Args:
        capture: folder of the model.
        photographs: all views of the model, in the order of their names.
        folder: an empty folder for all files.
        scale: metres per unit of the model.

    Raises:
        FiptError: ``stereo-failed``, or one of the readers.
    """
    for name in ("images", "model", "depth"):
        (folder / name).mkdir()
    found = find(capture)
    if found is None:
        raise damaged(capture, "it contains no COLMAP model")
    model = opened(found)
    images = sorted((model.images[i] for i in model.reg_image_ids()), key=lambda image: image.name)
    for index, (image, view) in enumerate(zip(images, photographs, strict=True)):
        image.name = f"{index:06d}.png"
        Image.fromarray(_copy(view.image, view.layer)).save(folder / "images" / image.name)
    try:
        model.write(str(folder / "model"))
        pycolmap.undistort_images(folder / "dense", folder / "model", folder / "images")
        pycolmap.patch_match_stereo(folder / "dense")
        dense = pycolmap.Reconstruction(str(folder / "dense" / "sparse"))
        views = [
            _view(image, dense.cameras[image.camera_id], folder, scale) for image in dense.images.values()
        ]
    except (RuntimeError, ValueError, OSError) as error:
        raise FiptError(
            "stereo-failed",
            f"Dense stereo has failed ({error}).",
            "Check that the photographs overlap and that the GPU has enough memory, or give a mesh (--mesh).",
        ) from None
    return tuple(views)


def _copy(path: Path, layer: str) -> np.ndarray:
    """(H, W, 3) uint8 codes of a photograph."""
    radiance = read_radiance(path, layer)
    if not is_encoded(path):
        middle = float(np.median(radiance[radiance > 0.0])) if (radiance > 0.0).any() else 1.0
        # The median gets a code-linear value of 0.22.
        radiance = 1.0 - np.exp(-np.maximum(radiance, 0.0) * (0.22 / middle))
    return np.asarray(np.round(255.0 * np.clip(srgb_encoded(radiance), 0.0, 1.0)), np.uint8)


def _view(image: pycolmap.Image, camera: pycolmap.Camera, folder: Path, scale: float) -> DepthView:
    depth = read_depth_map(folder / "dense" / "stereo" / "depth_maps" / f"{image.name}.geometric.bin")
    if depth.shape != (camera.height, camera.width):
        raise ValueError(f"the depth map of {image.name} has another size than its camera")
    path = (folder / "depth" / image.name).with_suffix(".exr")
    write_exr(path, np.repeat(depth[..., None], 3, axis=2))
    pose = np.eye(4)
    pose[:3] = image.cam_from_world().inverse().matrix()
    fx, fy, cx, cy = (float(value) for value in camera.params)
    return DepthView(path, int(camera.width), int(camera.height), fx, fy, cx, cy, scale, pose, None)


def read_depth_map(path: Path) -> np.ndarray:
    """(H, W) float32 depths of a map as COLMAP writes it: its size as text, then the rows; 0 where unknown.

    Raises:
        ValueError: for other files.
        OSError: where it can't be read.
    """
    data = read_limited(path, MOST_MAP_BYTES)
    words = data[:64].split(b"&", 3)  # "WIDTH&HEIGHT&1&"
    if len(words) != 4 or not all(word.isdigit() for word in words[:3]):
        raise ValueError(f"{path.name} is no depth map")
    width, height, channels = (int(word) for word in words[:3])
    start = sum(len(word) + 1 for word in words[:3])
    if channels != 1 or len(data) - start != 4 * width * height:
        raise ValueError(f"{path.name} is cut off")
    depth = np.frombuffer(data, "<f4", width * height, start).reshape(height, width)
    return np.where(np.isfinite(depth) & (depth > 0.0), depth, 0.0).astype(np.float32)
