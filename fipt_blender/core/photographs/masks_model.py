# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The model that makes id images of photographs: parts by SAM, semantic classes by the others."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np

from . import regions, sam_checkpoint, segmentation
from .local_models import ModelFolder


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
