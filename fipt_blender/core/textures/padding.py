# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Filling the texels between UV islands, so that filtering and mipmaps never read an empty one.

Near the islands the border grows outwards texel by texel; what is left is filled by push-pull.
"""

from __future__ import annotations

import numpy as np


def pad(image: np.ndarray, filled: np.ndarray, texels: int = 8) -> np.ndarray:
    """Fill the texels that no island covers.

    Args:
        image: (H,W,C) f32; only texels marked in `filled` are read.
        filled: (H,W) bool.
        texels: how far islands grow before push-pull fills the rest.

    Returns:
        (H,W,C) f32, equal to `image` where `filled`; all zeros where nothing is filled at all.
    """
    if not filled.any():
        return np.zeros_like(image)
    grown, valid = _grow(image, filled, texels)
    if valid.all():
        return grown
    return np.where(valid[..., None], grown, _push_pull(grown, valid))


def _grow(image: np.ndarray, filled: np.ndarray, texels: int) -> tuple[np.ndarray, np.ndarray]:
    # A border of one texel spares the tests at the image's edges.
    height, width, channels = image.shape
    stride = width + 2
    valid = np.zeros((height + 2, stride), bool)
    valid[1:-1, 1:-1] = filled
    inner = np.zeros_like(valid)
    inner[1:-1, 1:-1] = True
    values = np.zeros((height + 2, stride, channels), np.float32)
    values[1:-1, 1:-1] = np.where(filled[..., None], image, 0.0)
    valid, inner, values = valid.ravel(), inner.ravel(), values.reshape(-1, channels)
    around = np.array([-stride - 1, -stride, -stride + 1, -1, 1, stride - 1, stride, stride + 1])
    newest = np.flatnonzero(valid)
    for _ in range(texels):
        # Only neighbours of the texels filled last can be next.
        beside = np.zeros_like(valid)
        for step in around:
            beside[newest + step] = True
        frontier = np.flatnonzero(beside & inner & ~valid)
        if not len(frontier):
            break
        total = np.zeros((len(frontier), channels), np.float32)
        count = np.zeros(len(frontier), np.float32)
        for step in around:
            known = valid[frontier + step]
            total[known] += values[frontier[known] + step]
            count += known
        values[frontier] = total / count[:, None]
        valid[frontier] = True
        newest = frontier
    shape = (height + 2, stride)
    return values.reshape(*shape, channels)[1:-1, 1:-1], valid.reshape(shape)[1:-1, 1:-1]


def _push_pull(image: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Averages of ever larger blocks, each empty texel taking the finest block that holds anything."""
    height, width, channels = image.shape
    if height <= 1 and width <= 1:
        return image
    padded = np.zeros((height + height % 2, width + width % 2, channels + 1), np.float32)
    padded[:height, :width, :channels] = np.where(valid[..., None], image, 0.0)
    padded[:height, :width, channels] = valid
    blocks = padded.reshape(padded.shape[0] // 2, 2, padded.shape[1] // 2, 2, channels + 1).sum(axis=(1, 3))
    weight = blocks[..., channels:]
    coarse = _push_pull(blocks[..., :channels] / np.maximum(weight, 1.0), weight[..., 0] > 0.0)
    spread = np.repeat(np.repeat(coarse, 2, axis=0), 2, axis=1)[:height, :width]
    return np.where(valid[..., None], image, spread)
