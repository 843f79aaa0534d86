"""The views of a run as the engine uses them: pinhole cameras in Blender's world, with linear images.

They are read from capture.json, which `ingest` writes after all its checks. A budget decides the resolution
at which light is solved: where a view has fewer pixels than its photograph, its images are averaged to these
when they are read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from .. import conventions
from ..run.contents import CapturedView
from ..run.errors import FiptError
from ..run.light_size import light_size, light_views_count
from ..run.run_files import read_capture
from ..run.runfolder import RunFolder
from ..run.threads import in_threads
from .averaging import majority, means
from .checks import check_view
from .encoded import is_clipped
from .images import Picture, open_picture, threads_for
from .rig import Pinhole

# From this share of clipped pixels on, the mean of codes is only a bound, and clipped, too.
CLIPPED_SHARE = 0.02
# Bytes of averaged images that a capture keeps: all of them with the budgets of the presets.
MOST_KEPT = 500_000_000
Result = TypeVar("Result")  # of a function of a view


class KeptImages(dict[tuple[Picture, str, tuple[int, int], bool], np.ndarray]):
    """The last images that were averaged, by the arguments of `_reduced`; processes share none."""

    def __reduce__(self) -> tuple[type[KeptImages], tuple[()]]:
        return KeptImages, ()

    def keep(self, key: tuple[Picture, str, tuple[int, int], bool], image: np.ndarray) -> None:
        """Keep an image, and of all only as many as `MOST_KEPT` allows."""
        self[key] = image
        for oldest in tuple(self):
            if sum(array.nbytes for array in tuple(self.values())) <= MOST_KEPT:
                break
            self.pop(oldest, None)


@dataclass(frozen=True, eq=False)
class View:
    """One photograph: a pinhole camera and the paths of its images."""

    name: str  # unique in the capture, e.g. ``"train/000"``.
    split: str  # ``"train"`` or ``"held_back"`` (never shown to the estimation)
    image: Path  # scene-linear radiance (EXR; see `encoded`), undistorted, free of negative values
    # width, height: size in pixels
    width: int
    height: int
    # fx, fy, cx, cy: pinhole intrinsics in pixels; the centre of the first pixel is (0.5, 0.5)
    fx: float
    fy: float
    cx: float
    cy: float
    camera_to_world: np.ndarray  # (4, 4) float64, OpenCV axes, Blender world in metres
    # parts, semantics: id images of the same size, or None
    parts: Path | None = None
    semantics: Path | None = None
    mask: Path | None = None  # id image of the same size, 0 where the photograph must not be used, or None
    # Whether the photograph is not HDR: the image holds a camera's codes by sRGB's curve
    encoded: bool = False
    exposure: float | None = None  # of such a photograph, the relative exposure stored in its file, or None
    panorama: str | None = None  # name of the panorama that the view is a face of, or None
    # Width and height of the photograph, where the view has fewer pixels; None where it has its size
    full: tuple[int, int] | None = None
    # Averaged images: of all views of a capture, at any resolution
    kept: KeptImages = field(default_factory=KeptImages, repr=False)

    @property
    def files(self) -> list[Path]:
        """The image files that the view has."""
        return [path for path in (self.image, self.parts, self.semantics, self.mask) if path]

    @property
    def intrinsics(self) -> np.ndarray:
        """The camera matrix K (3, 3) float64 in pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def resized(self, width: int, height: int) -> View:
        """The same camera with other numbers of pixels; the view itself where it has these."""
        if (width, height) == (self.width, self.height):
            return self
        x, y = width / self.width, height / self.height
        fx, fy, cx, cy = self.fx * x, self.fy * y, self.cx * x, self.cy * y
        full = self.full or (self.width, self.height)
        return replace(self, width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy, full=full)

    def rays(self, z_depth: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Origins and directions of the rays through all pixel centres; see `conventions.pixel_rays`."""
        return conventions.pixel_rays(self, z_depth)

    def radiance(self) -> np.ndarray:
        """(height, width, 3) float32 scene-linear radiance; read-only where it is averaged."""
        return self._read(self.image, "image")

    def keep(self, photograph: np.ndarray) -> None:
        """Average the photograph, which has been decoded, for a later `radiance`."""
        if self.full:
            self._reduced(open_picture(self.image), "image", photograph)

    def part_ids(self) -> np.ndarray | None:
        """Part ids (height, width) int32, or None where the view has none."""
        return None if self.parts is None else self._read(self.parts, "ids")

    def semantic_ids(self) -> np.ndarray | None:
        """Semantic ids (height, width) int32, or None where the view has none."""
        return None if self.semantics is None else self._read(self.semantics, "ids")

    def masked(self) -> np.ndarray | None:
        """(height, width) bool, pixels that are left out, or None where all are used."""
        return None if self.mask is None else self._read(self.mask, "mask")

    def _read(self, path: Path, kind: str) -> np.ndarray:
        """An image of the view's size, or of that of its photograph, which is reduced.

        Args:
            kind: "image", "ids" or "mask".
        """
        picture, size = open_picture(path), (self.width, self.height)
        if picture.size == size:
            return _pixels(picture, kind)
        if picture.size == self.full:
            return self._reduced(picture, kind)
        wanted = self.full or size
        remedy = "Import the capture again, or restore the photograph."
        if kind != "image":
            remedy = (
                "Use masks of the photographs' size. If lens distortion was undone, put the original masks"
                " into the folder 'parts' beside the photographs and import the capture again."
            )
        raise FiptError.of(
            "image-size" if kind == "image" else "mask-size",
            f"{path} has {picture.size[0]} x {picture.size[1]} pixels; the photograph of {self.name} had"
            f" {wanted[0]} x {wanted[1]} when the capture was imported.",
            remedy,
        )

    def _reduced(self, picture: Picture, kind: str, pixels: np.ndarray | None = None) -> np.ndarray:
        """An image with fewer pixels: the mean radiance of those that each covers, ids by majority.

        Of what must not be used, any share spoils a mean. Of photographs that are not HDR, pixels of which a
        relevant share is clipped in a channel are so, too.

        Args:
            kind: as of `_read`.
            pixels: of the picture, if they are decoded already.

        Returns:
            read-only.
        """
        size = self.width, self.height
        key = (picture, kind, size, self.encoded)
        if (kept := self.kept.get(key)) is not None:
            return kept
        pixels = _pixels(picture, kind) if pixels is None else pixels
        if kind == "ids":
            result = majority(pixels, *size)
        elif kind == "mask":
            result = means(pixels[..., None], *size)[..., 0] > 0.0
        else:
            result = means(pixels, *size)
            if self.encoded and (clipped := is_clipped(pixels)).any():
                result[means(clipped, *size) >= CLIPPED_SHARE] = 1.0
        result.flags.writeable = False
        self.kept.keep(key, result)
        return result


def _pixels(picture: Picture, kind: str) -> np.ndarray:
    """A view's image as it is stored; of a mask the pixels that are left out."""
    if kind == "image":
        return picture.shown()[0]
    return picture.ids() if kind == "ids" else picture.ids() == 0


def decoded(function: Callable[[View], Result], views: Sequence[View]) -> Iterator[Result]:
    """What a function that reads a view's photograph returns of each: the next ones are decoded meanwhile."""
    full = [view.full or (view.width, view.height) for view in views]
    return in_threads(function, views, threads_for(width * height for width, height in full))


def chosen_views(views: Sequence[View], light_pixels: float) -> list[View]:
    """All views, or those whose cameras differ most, where the budget can't serve all of them.

    Args:
        views: at full size.
        light_pixels: millions of pixels of all views together.
    """
    count = light_views_count([(view.width, view.height) for view in views], light_pixels)
    if count >= len(views):
        return list(views)
    poses = np.array([view.camera_to_world for view in views])
    places = poses[:, :3, 3] - np.median(poses[:, :3, 3], axis=0)
    extent = max(float(np.median(np.linalg.norm(places, axis=1))), 1e-9)
    # A turn by 60 degrees differs as much as a move by that extent.
    features = np.concatenate([places / extent, poses[:, :3, 2]], axis=1)
    chosen = [0]
    distance = np.full(len(views), np.inf)
    while len(chosen) < count:
        distance = np.minimum(distance, np.linalg.norm(features - features[chosen[-1]], axis=1))
        chosen.append(int(distance.argmax()))
    return [views[index] for index in sorted(set(chosen))]


def light_views(views: Sequence[View], light_pixels: float) -> list[View]:
    """The views of an estimation at the resolution of light: the same objects where the budget suffices.

    Args:
        views: at full size.
        light_pixels: the budget, millions of pixels of all views together.
    """
    views = chosen_views(views, light_pixels)
    sizes = light_size([(view.width, view.height) for view in views], light_pixels)
    return [view.resized(*size) for view, size in zip(views, sizes, strict=True)]


def photographs_of(views: Sequence[View]) -> np.ndarray:
    """(V,) int photograph of each view, numbered by the first: the faces of a panorama are one photograph."""
    number: dict[tuple[bool, str], int] = {}
    names = [(view.panorama is not None, view.panorama or view.name) for view in views]
    return np.array([number.setdefault(name, len(number)) for name in names], np.int64)


@dataclass(frozen=True, eq=False)
class Capture:
    """All views of a run, and the conversion from the source's coordinates to Blender's world."""

    source: str  # the format it was read from
    # (4, 4) float64 similarity for anything in source coordinates, the mesh included
    world_from_source: np.ndarray
    mesh: Path | None  # mesh file in source coordinates, or None where none was found
    views: tuple[View, ...]  # in the order of capture.json

    @property
    def train(self) -> list[View]:
        """The views that the estimation may use."""
        return [view for view in self.views if view.split == "train"]

    @property
    def held_back(self) -> list[View]:
        """The views that are held back to check the result."""
        return [view for view in self.views if view.split == "held_back"]


def load_capture(run: RunFolder) -> Capture:
    """Read capture.json of a run."""
    capture = read_capture(run.capture_json)
    kept = KeptImages()
    views = tuple(_view(run, view, kept) for view in capture.views)
    for view in views:
        pinhole = Pinhole(view.width, view.height, view.fx, view.fy, view.cx, view.cy)
        check_view(view.name, pinhole, view.camera_to_world)
    return Capture(
        source=capture.source,
        world_from_source=np.array(capture.world_from_source),
        mesh=None if capture.mesh is None else run.resolve(capture.mesh),
        views=views,
    )


def _view(run: RunFolder, view: CapturedView, kept: KeptImages) -> View:
    names = [item.name for item in fields(View) if item.name not in ("full", "kept")]
    values = {name: getattr(view, name) for name in names}
    for name in ("image", "parts", "semantics", "mask"):
        values[name] = None if values[name] is None else run.resolve(values[name])
    return View(**values | {"camera_to_world": np.array(view.camera_to_world), "kept": kept})
