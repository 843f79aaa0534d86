"""A photograph while it is imported: its file, the views that show it, and their images that must be written.

What Blender could not show is written: views without distortion, faces of panoramas, curves, layers and
primaries that only the engine reads. All else stays where it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import conventions
from ..run.contents import CapturedView
from ..run.kinds import as_matrix
from ..run.runfolder import RunFolder
from ..run.threads import cached_property
from . import checks
from .averaging import means
from .distortion import Undistortion, is_distorted, lens_pinhole, undistorted_pinhole, undistortion
from .encoded import srgb_encoded
from .images import (
    EXR_SUFFIX,
    HALF_MAX,
    MAX_PNG_ID,
    Picture,
    open_picture,
    read_ids,
    write_codes,
    write_exr,
    write_ids,
)
from .mistakes import small
from .rig import Pinhole, RigView

# Photographs with more pixels than these are rewritten with the bits that they have, 8 (PNG) or 16 (EXR),
# instead of 32: of 12 megapixels 144 MB would be written. Smaller ones keep all bits.
EXACT_PIXELS = 1_000_000
# The smallest value with all digits of a half float; a photograph's median must be so many times that.
LEAST_HALF, DARKER = 2.0**-14, 100.0
# Longer side of the copies that Blender's windows show of larger photographs, and their usual size: what a
# screen can show, and what the pictures beside them are rendered at.
PREVIEW_SIDE = 1920
ID_IMAGES = ("parts", "semantics", "mask")  # fields of views
Files = dict[str, Path]  # images that were written of a view, by kind, relative to their folder


@dataclass(frozen=True, eq=False)
class Photograph:
    """A file, and the pinhole views that are made of it."""

    views: tuple[RigView, ...]  # one, or the six faces of a panorama
    compared: bool = False  # whether it is compared with others (:mod:`.mistakes`)

    @cached_property
    def picture(self) -> Picture:
        """The file by its header."""
        return open_picture(self.views[0].image, self.views[0].layer, self.views[0].colorspace)

    @cached_property
    def distorted(self) -> tuple[bool, ...]:
        """Of each view, whether it must be resampled."""
        return tuple(is_distorted(view.lens, view.width, view.height) for view in self.views)

    @cached_property
    def pinholes(self) -> tuple[Pinhole, ...]:
        """Of each view, undistorted where necessary."""
        found = []
        for view, distorted in zip(self.views, self.distorted, strict=True):
            found.append(lens_pinhole(view.lens, view.width, view.height))
            checks.check_intrinsics(view.name, found[-1])
            if distorted:
                found[-1] = undistorted_pinhole(view.lens, view.width, view.height)
        return tuple(found)

    @property
    def rewritten_bytes(self) -> int:
        """Expected size of what is written of it."""
        total = 0
        for pinhole, distorted in zip(self.pinholes, self.distorted, strict=True):
            pixels = pinhole.width * pinhole.height
            total += 2_000_000 if max(pinhole.width, pinhole.height) > PREVIEW_SIDE else 0
            if distorted or not self.picture.is_plain:
                total += pixels * (12 if pixels <= EXACT_PIXELS else 2 if self.picture.type == "uint8" else 6)
        return total

    def resamplings(self) -> list[Undistortion | None]:
        """What undoes the distortion of each view, or cuts it out of a panorama; None where it has none."""
        pairs = zip(self.views, self.distorted, strict=True)
        return [undistortion(view.lens, view.width, view.height) if away else None for view, away in pairs]

    def convert(
        self, folder: Path, resamplings: Sequence[Undistortion | None]
    ) -> tuple[checks.PixelStatistics, list[Files], list[np.ndarray | None]]:
        """Statistics of its values, the images written of its views, and what is compared of each.

        Bilinear weights are positive, so that no value is negative if clamping precedes the resampling. Id
        images are read, for their errors, also where they stay as they are.

        Args:
            folder: for the images that are written.
            resamplings: of this photograph.
        """
        pixels, clear = self.picture.shown()
        found = checks.pixel_statistics(self.picture.path, pixels)
        if self.picture.is_encoded:  # clipped and of 8 bits, as is said of all of them at once
            found = replace(found, looks_ldr=False, clipped=0.0)
        plain = self.picture.is_plain and found.minimum >= 0.0
        if found.minimum < 0.0:
            pixels = np.maximum(pixels, 0.0)
        first = self.views[0]
        ids = {kind: read_ids(path) for kind in ID_IMAGES if (path := getattr(first, kind)) is not None}
        if clear is not None:
            ids["mask"] = np.where(clear, 0, ids.get("mask", 1)).astype(np.int32)
            found = replace(found, transparent=float(clear.mean()))
        files, shown = [], []
        for view, resampling in zip(self.views, resamplings, strict=True):
            image, cut = pixels, {"mask": ids["mask"]} if clear is not None else {}
            if resampling is not None:
                image, cut = resampling.image(pixels), {kind: resampling.ids(ids[kind]) for kind in ids}
            files.append(self._write(folder, view.name, image, resampling is not None or not plain, cut))
            mask = cut.get("mask", ids.get("mask"))
            shown.append(small(image, None if mask is None else mask == 0) if self.compared else None)
        return found, files, shown

    def _write(
        self, folder: Path, name: str, pixels: np.ndarray, is_new: bool, ids: dict[str, np.ndarray]
    ) -> Files:
        """Write the images of a view.

        Args:
            name: of the view.
            pixels: (height, width, 3).
            is_new: whether they are not those that the file shows to any program.
            ids: that are new.
        """
        written: Files = {}

        def target(kind: str, suffix: str = EXR_SUFFIX) -> Path:
            written[kind] = Path(kind) / f"{name}{suffix}"
            return folder / written[kind]

        if is_new and pixels[..., 0].size > EXACT_PIXELS and self.picture.type == "uint8":
            write_codes(target("image", ".png"), srgb_encoded(pixels))
        elif is_new:
            write_exr(target("image"), pixels, half=_fits_half(pixels))
        for kind, values in ids.items():
            if values.min() >= 0 and values.max() <= MAX_PNG_ID:  # faster to read, and smaller
                write_ids(target(kind, ".png"), values)
            else:
                write_exr(target(kind), values)
        if max(pixels.shape) > PREVIEW_SIDE:  # a copy with which Blender's windows show it
            shrink = PREVIEW_SIDE / max(pixels.shape)
            height, width = (max(1, round(shrink * side)) for side in pixels.shape[:2])
            smaller = means(pixels, width, height)
            if self.picture.is_encoded:
                write_codes(target("preview", ".jpg"), srgb_encoded(smaller))
            else:
                write_exr(target("preview"), smaller, half=True, lossy=True)
        return written

    def captured(
        self, run: RunFolder, files: Sequence[Files], world_from_source: np.ndarray
    ) -> list[CapturedView]:
        """The entries of its views in capture.json.

        Args:
            files: that were written of each.
            world_from_source: (4, 4) similarity.
        """
        encoded, entries = self.picture.is_encoded, []
        for view, pinhole, written in zip(self.views, self.pinholes, files, strict=True):
            paths = {"image": view.image, **{kind: getattr(view, kind) for kind in ID_IMAGES}}
            paths |= {kind: run.images / path for kind, path in written.items()}
            names: dict[str, Any] = {kind: _stored_path(run, path) for kind, path in paths.items()}
            pose = conventions.transform_poses(world_from_source, view.camera_to_world)
            entry = CapturedView(
                name=view.name,
                split=view.split or "train",
                **asdict(pinhole),
                camera_to_world=as_matrix(pose),
                **names,
                encoded=encoded,
                exposure=self.picture.exposure,
                panorama=view.name.removesuffix(f"@{view.lens.face}") if view.lens.face else None,
            )
            entries.append(entry)
        return entries


def _fits_half(pixels: np.ndarray) -> bool:
    """Whether a large image's values may be stored with 16 bits, whose relative error is at most 0.05 %."""
    if pixels[..., 0].size <= EXACT_PIXELS or pixels.max() > HALF_MAX:
        return False
    sample = checks.pixel_sample(pixels)
    positive = sample[sample > 0.0]
    # Smaller values than LEAST_HALF have larger errors.
    return positive.size > 0 and float(np.median(positive)) > DARKER * LEAST_HALF


def _stored_path(run: RunFolder, path: Path | None) -> str | None:
    """A path as capture.json stores it: relative to the run folder if inside it, else absolute."""
    if path is None:
        return None
    path = path.absolute()
    return path.relative_to(run.root).as_posix() if path.is_relative_to(run.root) else str(path)
