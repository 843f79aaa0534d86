# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The views of a run as the engine uses them: pinhole cameras in Blender's world, with linear images.

They are read from capture.json, which `ingest` writes after all its checks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from .. import conventions
from ..run.contents import CapturedView
from ..run.errors import FiptError
from ..run.run_files import read_capture
from ..run.runfolder import RunFolder
from .checks import check_view
from .images import read_ids, read_radiance
from .rig import Pinhole


@dataclass(frozen=True, eq=False)
class View:
    """One photograph: a pinhole camera and the paths of its images.

    Attributes:
        name: unique in the capture, e.g. ``"train/000"``.
        split: ``"train"`` or ``"held_back"`` (never shown to the estimation).
        image: scene-linear radiance (EXR; see `encoded`), undistorted, free of negative values.
        width, height: size in pixels.
        fx, fy, cx, cy: pinhole intrinsics in pixels; the centre of the first pixel is (0.5, 0.5).
        camera_to_world: (4, 4) float64, OpenCV axes, Blender world in metres.
        parts, semantics: id images of the same size, or None.
        mask: id image of the same size, 0 where the photograph must not be used, or None.
        encoded: whether the photograph is not HDR: the image holds a camera's codes by sRGB's curve.
        exposure: of such a photograph, the relative exposure stored in its file, or None.
        panorama: name of the panorama that the view is a face of, or None.
    """

    name: str
    split: str
    image: Path
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    camera_to_world: np.ndarray
    parts: Path | None = None
    semantics: Path | None = None
    mask: Path | None = None
    encoded: bool = False
    exposure: float | None = None
    panorama: str | None = None

    @property
    def files(self) -> list[Path]:
        """The image files that the view has."""
        return [path for path in (self.image, self.parts, self.semantics, self.mask) if path]

    @property
    def intrinsics(self) -> np.ndarray:
        """The camera matrix K (3, 3) float64 in pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def resized(self, width: int, height: int) -> View:
        """The same camera with other numbers of pixels."""
        x, y = width / self.width, height / self.height
        return replace(
            self, width=width, height=height, fx=self.fx * x, fy=self.fy * y, cx=self.cx * x, cy=self.cy * y
        )

    def rays(self, z_depth: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Origins and directions of the rays through all pixel centres; see `conventions.pixel_rays`."""
        return conventions.pixel_rays(self, z_depth)

    def radiance(self) -> np.ndarray:
        """The photograph, (height, width, 3) float32 scene-linear radiance.

        Raises:
            FiptError: ``image-size`` where the file has been replaced by one of another size, and those of
                `read_radiance`.
        """
        pixels = read_radiance(self.image)
        if pixels.shape[:2] != (self.height, self.width):
            raise FiptError(
                "image-size",
                f"{self.image} has {pixels.shape[1]} x {pixels.shape[0]} pixels; it had {self.width} x"
                f" {self.height} when the capture was imported.",
                "Import the capture again, or restore the photograph.",
            )
        return pixels

    def part_ids(self) -> np.ndarray | None:
        """Part ids (height, width) int32, or None where the view has none."""
        return self._ids(self.parts)

    def semantic_ids(self) -> np.ndarray | None:
        """Semantic ids (height, width) int32, or None where the view has none."""
        return self._ids(self.semantics)

    def masked(self) -> np.ndarray | None:
        """(height, width) bool, pixels that are left out, or None where all are used."""
        ids = self._ids(self.mask)
        return None if ids is None else ids == 0

    def _ids(self, path: Path | None) -> np.ndarray | None:
        """An id image, which must have the photograph's size.

        Raises:
            FiptError: ``mask-size`` and those of `read_ids`.
        """
        if path is None:
            return None
        ids = read_ids(path)
        if ids.shape != (self.height, self.width):
            raise FiptError(
                "mask-size",
                f"{path} is {ids.shape[1]} x {ids.shape[0]} pixels; the photograph of {self.name} has "
                f"{self.width} x {self.height}.",
                "Use masks of the photographs' size. If lens distortion was undone, put the original masks "
                "into the folder 'parts' beside the photographs and import the capture again.",
            )
        return ids


def photographs_of(views: Sequence[View]) -> np.ndarray:
    """(V,) int photograph of each view, numbered by the first: the faces of a panorama are one photograph."""
    number: dict[tuple[bool, str], int] = {}
    names = [(view.panorama is not None, view.panorama or view.name) for view in views]
    return np.array([number.setdefault(name, len(number)) for name in names], np.int64)


@dataclass(frozen=True, eq=False)
class Capture:
    """All views of a run, and the conversion from the source's coordinates to Blender's world.

    Attributes:
        source: the format it was read from.
        world_from_source: (4, 4) float64 similarity for anything in source coordinates, the mesh included.
        mesh: mesh file in source coordinates, or None where none was found.
        views: in the order of capture.json.
    """

    source: str
    world_from_source: np.ndarray
    mesh: Path | None
    views: tuple[View, ...]

    @property
    def train(self) -> list[View]:
        """The views that the estimation may use."""
        return [view for view in self.views if view.split == "train"]

    @property
    def held_back(self) -> list[View]:
        """The views that are held back to check the result."""
        return [view for view in self.views if view.split == "held_back"]


def load_capture(run: RunFolder) -> Capture:
    """Read capture.json of a run.

    Raises:
        FiptError: ``file-missing``, ``file-damaged``, ``capture-version``, ``path-outside``, or one of
            `check_view`.
    """
    capture = read_capture(run.capture_json)
    views = tuple(_view(run, view) for view in capture.views)
    for view in views:
        pinhole = Pinhole(view.width, view.height, view.fx, view.fy, view.cx, view.cy)
        check_view(view.name, pinhole, view.camera_to_world)
    return Capture(
        source=capture.source,
        world_from_source=np.array(capture.world_from_source),
        mesh=None if capture.mesh is None else run.resolve(capture.mesh),
        views=views,
    )


def _view(run: RunFolder, view: CapturedView) -> View:
    files = {name: getattr(view, name) for name in ("image", "parts", "semantics", "mask")}
    values = {item.name: getattr(view, item.name) for item in fields(View)}
    paths = {name: None if path is None else run.resolve(path) for name, path in files.items()}
    return View(**values | paths | {"camera_to_world": np.array(view.camera_to_world)})
