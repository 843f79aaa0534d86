# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Regions of single photographs, by a Segment Anything model (SAM, SAM 2 or MobileSAM).

Automatic mask generation as in Kirillov et al., Segment Anything (ICCV 2023, Sec. 5 and Appendix B), without
zoomed-in crops: points, three masks each, of which the confident, stable and distinct ones are kept. Grids of
points become finer, and points in regions that are already sure are not asked for. A photograph's regions
have numbers of their own, which mean nothing in other photographs.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Protocol

import numpy as np
import torch
from scipy.ndimage import find_objects, label

from ..capture.rig import PARTS_FOLDER
from .local_models import ModelFolder, enlarged

# SAM 2 models are published with the configuration of their tracker of videos, which contains that of images.
CLASSES = {"sam": "SamModel", "sam2": "Sam2Model", "sam2_video": "Sam2Model"}
GRIDS = (6, 12, 24)  # points along the longer side of a photograph, one grid after the other
# Points are skipped in masks of this confidence, unless these are larger than some cells of the next grid:
# small things may lie on a wall that is sure.
SURE, SURE_CELLS = 0.93, 16.0
# The paper's choices, but for the stability: of 0.95, walls were left without a mask.
LEAST_CONFIDENCE = 0.88  # IoU with the true mask that the model predicts
LEAST_STABILITY = 0.9  # IoU of a mask at two thresholds
MOST_COVER = 0.95  # share of a photograph, from which a mask shows no region
MOST_OVERLAP = 0.7  # IoU of two masks of different regions
# Pixels of a region's pieces as a share of the photograph's; the paper's 100 pixels at about 1 megapixel.
LEAST_PIECE = 1e-4


class PromptNetwork(Protocol):
    """A network that answers points with masks.

    Attributes:
        side: pixels of the square in which photographs lie.
        longest: pixels of their longer side within it.
        keeps_shape: whether photographs keep their proportions; others are stretched.
        resolution: rows and columns of logits that show the square.
        at_once: points that are answered together fastest.
    """

    side: int
    resolution: int
    longest: int
    keeps_shape: bool
    at_once: int

    def normalized(self, picture: np.ndarray, size: tuple[int, int]) -> torch.Tensor:
        """(1, 3, *size) of a picture (height, width, 3) uint8, sRGB."""

    def encode(self, pixels: torch.Tensor) -> Any:
        """A normalized photograph in the top left of the square, ready for points."""

    def answer(self, image: Any, points: torch.Tensor, least: float) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits (N, h, w) and confidence (N,) above `least` of the masks at points (P, 2) of the square.

        The logits may show the square's top left part alone, as far as the photograph reaches.
        """


class FolderNetwork:
    """A network of transformers.

    Args:
        folder: of the model, of a type in `CLASSES`.

    Raises:
        FiptError: ``model-unusable`` for an incomplete model, ``package-optional`` without transformers.
    """

    at_once = 64

    def __init__(self, folder: ModelFolder) -> None:
        self._files = folder
        self._model = folder.load(CLASSES[folder.kind])
        self.side = int(self._model.config.prompt_encoder_config.image_size)
        # SAM was trained on photographs that keep their proportions, SAM 2 on stretched ones.
        self.keeps_shape = folder.kind == "sam"
        self.resolution = 4 * (self.side // int(self._model.config.prompt_encoder_config.patch_size))
        longest = folder.size.get("longest_edge")
        self.longest = longest if isinstance(longest, int) and 0 < longest < self.side else self.side

    def normalized(self, picture: np.ndarray, size: tuple[int, int]) -> torch.Tensor:
        """See `PromptNetwork`."""
        return self._files.pixels(picture, size)

    def encode(self, pixels: torch.Tensor) -> Any:
        """See `PromptNetwork`."""
        height, width = pixels.shape[-2:]
        square = torch.nn.functional.pad(pixels, (0, self.side - width, 0, self.side - height))
        return self._model.get_image_embeddings(square)

    def answer(self, image: Any, points: torch.Tensor, least: float) -> tuple[torch.Tensor, torch.Tensor]:
        """See `PromptNetwork`."""
        output = self._model(
            image_embeddings=image, input_points=points[None, :, None], multimask_output=True
        )
        logits, confidence = output.pred_masks[0].flatten(0, 1), output.iou_scores[0].flatten()
        return logits[confidence > least], confidence[confidence > least]


class RegionFinder:
    """The regions of photographs by a network.

    Args:
        network: that answers points.

    Attributes:
        kind: of its id images, a folder of captures and a field of views.
        classes: none, as its ids have no names.
    """

    kind = PARTS_FOLDER

    def __init__(self, network: PromptNetwork) -> None:
        self.classes: dict[int, str] = {}
        self._network = network

    def __call__(self, picture: np.ndarray) -> np.ndarray:
        """The regions of a photograph.

        Args:
            picture: (height, width, 3) uint8, sRGB.

        Returns:
            (height, width) int32, from 1; 0 where no region is.
        """
        height, width = picture.shape[:2]
        size = self._inner_size(height, width)
        with torch.inference_mode():
            image = self._network.encode(self._network.normalized(picture, size))
            logits, confidence = self._candidates(image, size)
            cover = (logits > 0.0).flatten(1)
            kept = distinct_masks(cover, confidence)
            kept = kept[torch.argsort(cover[kept].sum(dim=1), descending=True, stable=True)]
            masks = (self._mask(logits[index], size, (height, width)) for index in kept)
            return flattened(masks, (height, width))

    def _inner_size(self, height: int, width: int) -> tuple[int, int]:
        """Height and width of a photograph within the network's square."""
        if not self._network.keeps_shape:
            return self._network.side, self._network.side
        scale = self._network.longest / max(height, width)
        return max(1, int(height * scale + 0.5)), max(1, int(width * scale + 0.5))

    def _candidates(self, image: Any, size: tuple[int, int]) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits (N, h, w) of the confident and stable masks, and their confidence (N,)."""
        logits: list[torch.Tensor] = []
        confidence: list[torch.Tensor] = []
        sure: torch.Tensor | None = None
        for grid, following in zip(GRIDS, (*GRIDS[1:], GRIDS[-1]), strict=True):
            points = grid_points(grid, size)
            if sure is not None:
                rows = (points[:, 1] * sure.shape[0] / size[0]).long()
                columns = (points[:, 0] * sure.shape[1] / size[1]).long()
                points = points[~sure[rows, columns]]
            most = SURE_CELLS / len(grid_points(following, size))
            for batch in points.split(self._network.at_once):
                found, how_sure = self._network.answer(image, batch, LEAST_CONFIDENCE)
                found = _inner(found, size, self._network)
                cover = (found > 0.0).flatten(1).float().mean(dim=1)
                good = (stability(found) >= LEAST_STABILITY) & (cover > 0.0) & (cover < MOST_COVER)
                found, how_sure, cover = found[good], how_sure[good], cover[good]
                logits.append(found)
                confidence.append(how_sure)
                small = found[(how_sure > SURE) & (cover < most)] > 0.0
                if len(small):
                    union = small.any(dim=0)
                    sure = union if sure is None else sure | union
        return torch.cat(logits), torch.cat(confidence)

    def _mask(self, logits: torch.Tensor, size: tuple[int, int], shape: tuple[int, int]) -> np.ndarray:
        """A mask (*shape) bool of a photograph from its logits (h, w)."""
        stride = self._network.side // self._network.resolution
        # The last row and column of logits may reach past the photograph.
        whole = (logits.shape[0] * stride, logits.shape[1] * stride)
        full = enlarged(logits[None], whole)[:, : size[0], : size[1]]
        return (enlarged(full, shape)[0] > 0.0).cpu().numpy()


def grid_points(count: int, size: tuple[int, int]) -> torch.Tensor:
    """(P, 2) x and y of a grid of points in a photograph, at the centers of cells that are about square.

    Args:
        count: points along the longer side.
        size: height and width of the photograph.
    """
    rows, columns = (max(1, round(count * length / max(size))) for length in size)
    y, x = torch.meshgrid(torch.arange(rows) + 0.5, torch.arange(columns) + 0.5, indexing="ij")
    return torch.stack([x.flatten() * (size[1] / columns), y.flatten() * (size[0] / rows)], dim=1)


def stability(logits: torch.Tensor) -> torch.Tensor:
    """How little masks of logits (N, h, w) depend on the threshold: the IoU (N,) of those at 1 and -1.

    It is 0 for empty masks.
    """
    # Rows first, as 32-bit counts, is three times as fast as all at once.
    rows = [(logits > limit).sum(dim=2, dtype=torch.int32) for limit in (1.0, -1.0)]
    inner, outer = (count.sum(dim=1) for count in rows)
    return inner / outer.clamp(min=1)


def distinct_masks(masks: torch.Tensor, confidence: torch.Tensor) -> torch.Tensor:
    """Greedy non-maximum suppression by the IoU of masks.

    The authors' code compares boxes, of which a picture and its frame have the same.

    Args:
        masks: (N, P) bool, pixels of N masks.
        confidence: (N,), the highest is kept; of equal ones the first.

    Returns:
        Indices of the kept masks, by falling confidence.
    """
    order = torch.argsort(confidence, descending=True, stable=True)
    cover = masks[order].float()
    area = cover.sum(dim=1)
    shared = cover @ cover.T
    similar = shared > MOST_OVERLAP * (area[:, None] + area[None] - shared)
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


def _inner(logits: torch.Tensor, size: tuple[int, int], network: PromptNetwork) -> torch.Tensor:
    """The part of logits (N, h, w) that shows the photograph, without the padding."""
    height, width = (-(-length * network.resolution // network.side) for length in size)
    return logits[:, :height, :width]
