"""Writing pictures as PNG and JPEG files, and the files of what a result was judged by."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from ..run.runfolder import RunFolder, atomic_path, write_json

if TYPE_CHECKING:  # the report shows the files without the renderer and torch, which take seconds to load
    from ..checks.quality import Quality

KINDS = ("photograph", "render", "projection")  # of the pictures of a judged view


def write_png(path: Path, display: np.ndarray) -> None:
    """Write display values in [0, 1], (H, W, 3) or (H, W), as an 8-bit PNG, completely or not at all.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    with atomic_path(path) as temporary:
        _image(display).save(temporary, format="PNG", optimize=True)


def write_jpeg(path: Path, display: np.ndarray, quality: int = 88) -> None:
    """Write display values in [0, 1], (H, W, 3), as a JPEG, completely or not at all.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    with atomic_path(path) as temporary:
        _image(display).save(temporary, format="JPEG", quality=quality)


def _image(display: np.ndarray) -> Image.Image:
    return Image.fromarray(np.round(np.clip(display, 0.0, 1.0) * 255.0).astype(np.uint8))


def write_quality(run: RunFolder, quality: Quality) -> None:
    """Write results/quality.json and the pictures of the judged views in results/quality.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    document = quality.document()
    for index, (entry, view) in enumerate(zip(document["views"], quality.views, strict=True)):
        for kind, picture in zip(KINDS, view.pictures, strict=True):
            entry[kind] = f"{index:03d}-{kind}.png"
            write_png(run.quality / entry[kind], picture)
    write_json(run.quality_json, document)
