# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The model that makes id images of photographs: parts by SAM, semantic classes by the others."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np

from ..capture.averaging import means
from . import regions, sam_checkpoint, segmentation
from .local_models import ModelFolder

# Longer side of the pictures that models see, in pixels: their networks see fewer, but masks are made at the
# picture's size, one after the other.
MOST_SIDE = 2048


class MasksModel(Protocol):
    """A model that makes an id image of a photograph.

    Attributes:
        kind: ``parts`` or ``semantics``, a folder of captures and a field of views.
        classes: names of the ids; empty where they have none.
    """

    kind: str
    classes: dict[int, str]

    def __call__(self, picture: np.ndarray) -> np.ndarray:
        """(height, width) int32 ids of a picture (height, width, 3) uint8, sRGB."""


def open_masks_model(path: Path) -> MasksModel:
    """The model in a folder, or MobileSAM in a file of weights.

    Raises:
        FiptError: ``model-unusable`` for another, a damaged or an incomplete model, ``package-optional``
            without transformers, which all but MobileSAM need.
    """
    if path.suffix.lower() in sam_checkpoint.SUFFIXES and not path.is_dir():
        return regions.RegionFinder(sam_checkpoint.open_checkpoint(path))
    folder = ModelFolder(path)
    if folder.kind in regions.CLASSES:
        return regions.RegionFinder(regions.FolderNetwork(folder))
    if folder.kind in segmentation.CLASSES:
        return segmentation.Segmenter(folder)
    raise folder.unusable(f"it is of the type '{folder.kind}'")


def find_masks(
    model: MasksModel, radiance: np.ndarray, picture: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """(height, width) int32 ids of a photograph; a large one is averaged before a model sees it.

    Args:
        radiance: (height, width, 3) float.
        picture: what models see of such an image, (h, w, 3) uint8 sRGB.
    """
    height, width = radiance.shape[:2]
    shrink = MOST_SIDE / max(height, width)
    if shrink >= 1.0:
        return model(picture(radiance))
    smaller = means(radiance, max(1, round(shrink * width)), max(1, round(shrink * height)))
    ids = model(picture(smaller))
    rows, columns = (
        ((np.arange(count) + 0.5) * of / count).astype(np.int64)
        for count, of in zip((height, width), ids.shape, strict=True)
    )
    return ids[np.ix_(rows, columns)]
