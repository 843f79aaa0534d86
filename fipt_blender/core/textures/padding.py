# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Filling the texels between UV islands, so that filtering and mipmaps never read an empty texel.

Islands are first grown texel by texel; the remaining texels are filled by push-pull.
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
        (H,W,C) f32, equal to `image` where `filled`; all zero if no texel is filled.
    """
    if not filled.any():
        return np.zeros_like(image)
    return _push_pull(*_grow(image, filled, texels))


def _grow(image: np.ndarray, filled: np.ndarray, texels: int) -> tuple[np.ndarray, np.ndarray]:
    # With a border of one texel, no tests are needed at the image's edges.
    height, width, channels = image.shape
    stride = width + 2
    valid = np.zeros((height + 2, stride), bool)
    valid[1:-1, 1:-1] = filled
    inner = np.zeros_like(valid)
    inner[1:-1, 1:-1] = True
    values = np.zeros((height + 2, stride, channels), np.float32)
    np.copyto(values[1:-1, 1:-1], image, where=filled[..., None])
    valid, inner, values = valid.ravel(), inner.ravel(), values.reshape(-1, channels)
    around = np.array([-stride - 1, -stride, -stride + 1, -1, 1, stride - 1, stride, stride + 1])
    for _ in range(texels):
        beside = valid.reshape(height + 2, stride).copy()
        beside[:, 1:-1] |= beside[:, :-2] | beside[:, 2:]
        beside[1:-1] |= beside[:-2] | beside[2:]
        frontier = np.flatnonzero(beside.ravel() & inner & ~valid)
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
    shape = (height + 2, stride)
    return values.reshape(*shape, channels)[1:-1, 1:-1], valid.reshape(shape)[1:-1, 1:-1]


def _push_pull(image: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Push-pull: each empty texel takes the average of the smallest block around it that is not empty.

    The image is changed in place.
    """
    height, width, channels = image.shape
    if valid.all() or (height <= 1 and width <= 1):
        return image
    blocks = np.zeros(((height + 1) // 2, (width + 1) // 2, channels), np.float32)
    weight = np.zeros((*blocks.shape[:2], 1), np.float32)
    quarters = np.s_[0::2, 0::2], np.s_[0::2, 1::2], np.s_[1::2, 0::2], np.s_[1::2, 1::2]
    for quarter in quarters:
        known = valid[quarter][..., None]
        part = np.s_[: known.shape[0], : known.shape[1]]
        np.add(blocks[part], image[quarter], out=blocks[part], where=known)
        weight[part] += known
    coarse = _push_pull(blocks / np.maximum(weight, 1.0), weight[..., 0] > 0.0)
    for quarter in quarters:
        empty = ~valid[quarter][..., None]
        np.copyto(image[quarter], coarse[: empty.shape[0], : empty.shape[1]], where=empty)
    return image
