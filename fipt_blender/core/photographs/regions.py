# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Regions of single photographs, by a Segment Anything model (SAM or SAM 2).

Automatic mask generation as in Kirillov et al., Segment Anything (ICCV 2023, Sec. 5 and Appendix B), without
zoomed-in crops: a grid of points, three masks each, of which the confident, stable and distinct ones are
kept. A photograph's regions have numbers of their own, which mean nothing in other photographs.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import torch
from scipy.ndimage import find_objects, label

from ..capture.rig import PARTS_FOLDER
from .local_models import ModelFolder, enlarged

# SAM 2 models are published with the configuration of their tracker of videos, which contains that of images.
CLASSES = {"sam": "SamModel", "sam2": "Sam2Model", "sam2_video": "Sam2Model"}
# The paper's choices.
GRID = 32  # points along each side of a photograph
LEAST_CONFIDENCE = 0.88  # IoU with the true mask that the model predicts
LEAST_STABILITY = 0.95
STABILITY_OFFSET = 1.0  # of logits
MOST_COVER = 0.95  # share of a photograph, from which a mask shows no region
MOST_OVERLAP = 0.7  # IoU of two masks of different regions
# Pixels of a region's pieces as a share of the photograph's; the paper's 100 pixels at about 1 megapixel.
LEAST_PIECE = 1e-4
_POINTS_AT_ONCE = 64
_MASKS_AT_ONCE = 16  # that are enlarged together


class RegionFinder:
    """A Segment Anything model.

    Args:
        folder: of the model, of a type in `CLASSES`.

    Attributes:
        kind: of its id images, a folder of captures and a field of views.
        classes: none, as its ids have no names.

    Raises:
        FiptError: ``model-unusable`` for an incomplete model, ``package-optional`` without transformers.
    """

    kind = PARTS_FOLDER

    def __init__(self, folder: ModelFolder) -> None:
        self.classes: dict[int, str] = {}
        self._files = folder
        self._model = folder.load(CLASSES[folder.kind])
        self._side = int(self._model.config.prompt_encoder_config.image_size)
        longest = folder.size.get("longest_edge")
        self._longest = self._side
        if isinstance(longest, int) and 0 < longest < self._side:
            self._longest = longest

    def __call__(self, picture: np.ndarray) -> np.ndarray:
        """The regions of a photograph.

        Args:
            picture: (height, width, 3) uint8, sRGB.

        Returns:
            (height, width) int32, from 1; 0 where no region is.
        """
        height, width = picture.shape[:2]
        size = self._inner_size(height, width)
        with torch.no_grad():
            pixels = self._files.pixels(picture, size)
            pixels = torch.nn.functional.pad(pixels, (0, self._side - size[1], 0, self._side - size[0]))
            candidates, confidence = self._candidates(self._model.get_image_embeddings(pixels), size)
            cover = _inner(candidates, size, self._side) > 0.0
            kept = distinct_masks(cover.flatten(1), confidence)
            kept = kept[torch.argsort(cover[kept].flatten(1).sum(dim=1), descending=True, stable=True)]
            masks = (self._mask(candidates[index], size, (height, width)) for index in kept)
            return flattened(masks, (height, width))

    def _inner_size(self, height: int, width: int) -> tuple[int, int]:
        """Height and width of a photograph within the model's square.

        SAM was trained on photographs that keep their proportions, SAM 2 on stretched ones.
        """
        if self._files.kind != "sam":
            return self._side, self._side
        scale = self._longest / max(height, width)
        return max(1, int(height * scale + 0.5)), max(1, int(width * scale + 0.5))

    def _candidates(self, embeddings: Any, size: tuple[int, int]) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits (N, h, w) of the confident and stable masks, and their confidence (N,)."""
        points = grid_points(GRID) * torch.tensor([size[1], size[0]])
        found = []
        for start in range(0, len(points), _POINTS_AT_ONCE):
            batch = points[None, start : start + _POINTS_AT_ONCE, None]
            output = self._model(image_embeddings=embeddings, input_points=batch, multimask_output=True)
            logits, confidence = output.pred_masks[0].flatten(0, 1), output.iou_scores[0].flatten()
            sure = confidence > LEAST_CONFIDENCE
            logits, confidence = logits[sure], confidence[sure]
            good = self._is_good(logits, size)
            found.append((logits[good], confidence[good]))
        return torch.cat([logits for logits, _ in found]), torch.cat([confidence for _, confidence in found])

    def _is_good(self, logits: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
        """(N,) bool, whether masks are stable and do not cover all of the photograph."""
        good = [torch.zeros(0, dtype=torch.bool)]
        for part in logits.split(_MASKS_AT_ONCE) if len(logits) else ():
            full = enlarged(part, (self._side, self._side))[:, : size[0], : size[1]]
            cover = (full > 0.0).flatten(1).float().mean(dim=1)
            good.append((stability(full) >= LEAST_STABILITY) & (cover > 0.0) & (cover < MOST_COVER))
        return torch.cat(good)

    def _mask(self, logits: torch.Tensor, size: tuple[int, int], shape: tuple[int, int]) -> np.ndarray:
        """A mask (*shape) bool of a photograph from its logits (h, w)."""
        full = enlarged(logits[None], (self._side, self._side))[:, : size[0], : size[1]]
        return (enlarged(full, shape)[0] > 0.0).cpu().numpy()


def grid_points(count: int) -> torch.Tensor:
    """(count * count, 2) x and y of a grid of points in a unit square, at the centers of equal cells."""
    along = (torch.arange(count) + 0.5) / count
    y, x = torch.meshgrid(along, along, indexing="ij")
    return torch.stack([x.flatten(), y.flatten()], dim=1)


def stability(logits: torch.Tensor, offset: float = STABILITY_OFFSET) -> torch.Tensor:
    """How little masks depend on the threshold: the IoU of those at thresholds of +offset and -offset.

    Args:
        logits: (N, h, w).
        offset: distance of the two thresholds from 0.

    Returns:
        (N,) 0 to 1; 0 for empty masks.
    """
    # Rows first, as 32-bit counts, is three times as fast as all at once.
    rows = [(logits > limit).sum(dim=2, dtype=torch.int32) for limit in (offset, -offset)]
    inner, outer = (count.sum(dim=1) for count in rows)
    return inner / outer.clamp(min=1)


def distinct_masks(masks: torch.Tensor, confidence: torch.Tensor, most: float = MOST_OVERLAP) -> torch.Tensor:
    """Greedy non-maximum suppression by the IoU of masks.

    The authors' code compares boxes, of which a picture and its frame have the same.

    Args:
        masks: (N, P) bool, pixels of N masks.
        confidence: (N,), the highest is kept; of equal ones the first.
        most: IoU with a kept mask, above which a mask is left out.

    Returns:
        Indices of the kept masks, by falling confidence.
    """
    order = torch.argsort(confidence, descending=True, stable=True)
    cover = masks[order].float()
    area = cover.sum(dim=1)
    shared = cover @ cover.T
    similar = shared > most * (area[:, None] + area[None] - shared)
    kept: list[int] = []
    left = torch.ones(len(order), dtype=torch.bool)
    for index in range(len(order)):
        if left[index]:
            kept.append(index)
            left &= ~similar[index]
    return order[kept]


def flattened(masks: Iterable[np.ndarray], shape: tuple[int, int], least: float = LEAST_PIECE) -> np.ndarray:
    """One id image of masks that overlap: later ones lie over earlier ones.

    Args:
        masks: (*shape) bool each, the largest first, so that small regions are seen.
        shape: of the photograph.
        least: share of its pixels; connected pieces of regions that have fewer become 0.

    Returns:
        (*shape) int32 ids without gaps, in the order of the masks.
    """
    ids = np.zeros(shape, np.int32)
    for number, mask in enumerate(masks, start=1):
        ids[mask] = number
    for number, rows, columns in _boxes(ids):
        inside = ids[rows, columns]
        pieces, count = label(inside == number)
        small = np.bincount(pieces.ravel(), minlength=count + 1) < least * ids.size
        small[0] = False
        inside[small[pieces]] = 0
    used = np.unique(ids[ids > 0])
    return np.searchsorted(used, ids).astype(np.int32) + (ids > 0)


def _boxes(ids: np.ndarray) -> Iterator[tuple[int, slice, slice]]:
    """Each id of an image and the rows and columns in which it occurs."""
    for number, box in enumerate(find_objects(ids), start=1):
        if box is not None:
            yield number, box[0], box[1]


def _inner(logits: torch.Tensor, size: tuple[int, int], side: int) -> torch.Tensor:
    """The part of logits (N, h, w) that shows the photograph, without the padding."""
    height, width = logits.shape[-2:]
    return logits[:, : -(-size[0] * height // side), : -(-size[1] * width // side)]
