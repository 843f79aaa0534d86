# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Semantic classes of photographs, by a Mask2Former, OneFormer or EoMT model.

The models' outputs are combined here, as their processors do it, because those need torchvision.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch

from ..capture.rig import SEMANTICS_FOLDER
from .local_models import ModelFolder, enlarged

CLASSES = {
    "mask2former": "Mask2FormerForUniversalSegmentation",
    "oneformer": "OneFormerForUniversalSegmentation",
    "eomt": "EomtForUniversalSegmentation",
}
_TASK = "the task is semantic"  # what OneFormer is asked for
_SHORT_SIDE = 800  # pixels, where the folder does not say how large images were in training
_MULTIPLE = 32  # of the sides that the backbones of all but EoMT need
_CLASSES_AT_ONCE = 16  # whose scores are enlarged together; all would take gigabytes


class Segmenter:
    """A segmentation model.

    Args:
        folder: of the model, of a type in `CLASSES`.

    Attributes:
        kind: of its id images, a folder of captures and a field of views.
        classes: their names by id.

    Raises:
        FiptError: ``model-unusable`` for an incomplete model, ``package-optional`` without transformers.
    """

    kind = SEMANTICS_FOLDER

    def __init__(self, folder: ModelFolder) -> None:
        config = folder.config
        if "id2label" not in config:
            raise folder.unusable("it names no classes")
        self._files = folder
        self._windows = folder.kind == "eomt"  # its input is a square of one size
        short = _short_side(folder.size)
        self._side = int(config.get("image_size", _SHORT_SIDE)) if self._windows else short
        self._more: dict[str, Any] = {}
        # Only its training needs OneFormer's encoder of texts.
        changes = {"is_training": False} if folder.kind == "oneformer" else {}
        self._model = folder.load(CLASSES[folder.kind], **changes)
        if folder.kind == "oneformer":
            words = int(config.get("task_seq_len", 77))
            self._more = {"task_inputs": folder.tokens(_TASK, words)}
        self.classes = {int(key): name for key, name in config["id2label"].items() if key.isdecimal()}

    def __call__(self, picture: np.ndarray) -> np.ndarray:
        """The class of each pixel.

        Args:
            picture: (height, width, 3) uint8, sRGB.

        Returns:
            (height, width) int32 keys of `classes`.
        """
        height, width = picture.shape[:2]
        scale = self._side / min(height, width)
        multiple = 1 if self._windows else _MULTIPLE
        size = (_rounded(height * scale, multiple), _rounded(width * scale, multiple))
        pixels = self._files.pixels(picture, size)
        with torch.no_grad():
            scores = self._scores_of_windows(pixels) if self._windows else self._scores(pixels)
            return _best_class(scores, (height, width)).cpu().numpy()

    def _scores(self, pixels: torch.Tensor) -> torch.Tensor:
        """(C, h, w) score of each class, at the resolution of the model's masks."""
        output = self._model(pixel_values=pixels, **self._more)
        weights = output.class_queries_logits[0].softmax(dim=-1)[:, :-1]  # the last one is "nothing"
        masks = output.masks_queries_logits[0].sigmoid()
        return torch.einsum("qc,qhw->chw", weights, masks)

    def _scores_of_windows(self, pixels: torch.Tensor) -> torch.Tensor:
        """(C, h, w) mean score of square windows along the longer side."""
        height, width = pixels.shape[-2:]
        side, longer = min(height, width), max(height, width)
        total, count = None, torch.zeros(height, width, device=pixels.device)
        for start in window_starts(longer, side):
            rows = slice(start, start + side) if height > width else slice(0, side)
            columns = slice(0, side) if height > width else slice(start, start + side)
            scores = self._scores(pixels[..., rows, columns])
            scores = enlarged(scores, (side, side))
            total = torch.zeros(len(scores), height, width, device=pixels.device) if total is None else total
            total[:, rows, columns] += scores
            count[rows, columns] += 1.0
        assert total is not None
        return total / count


def window_starts(longer: int, side: int) -> list[int]:
    """Where windows of a length begin that cover a longer one with equal overlaps."""
    count = math.ceil(longer / side)
    return [round(index * (longer - side) / max(count - 1, 1)) for index in range(count)]


def _short_side(size: dict[str, Any]) -> int:
    value = size.get("shortest_edge", size.get("height", _SHORT_SIDE))
    is_side = isinstance(value, int) and not isinstance(value, bool) and 2 * _MULTIPLE <= value <= 4096
    return value if is_side else _SHORT_SIDE


def _rounded(length: float, multiple: int) -> int:
    return max(multiple, round(length / multiple) * multiple)


def _best_class(scores: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    """(height, width) int32 class with the highest of the scores (C, h, w)."""
    highest = torch.full(size, -torch.inf, device=scores.device)
    best = torch.zeros(size, dtype=torch.int32, device=scores.device)
    for start in range(0, len(scores), _CLASSES_AT_ONCE):
        value, index = enlarged(scores[start : start + _CLASSES_AT_ONCE], size).max(dim=0)
        better = value > highest
        best[better] = (index[better] + start).to(torch.int32)
        highest = torch.maximum(highest, value)
    return best
