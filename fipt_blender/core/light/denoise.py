# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Open Image Denoise on shading images, with guides."""

from __future__ import annotations

import numpy as np
import pyoidn


class Denoiser:
    """Denoises HDR images of one size that share their guides.

    Args:
        albedo: (H, W, 3) float32 in [0, 1], an image without noise whose edges the result keeps.
        normal: (H, W, 3) float32 unit normals, any space.

    Use as a context manager; images are finite and non-negative.
    """

    def __init__(self, albedo: np.ndarray, normal: np.ndarray) -> None:
        self._device = pyoidn.Device()
        self._device.commit()
        self._filter = pyoidn.Filter(self._device, pyoidn.OIDN_FILTER_TYPE_RT)
        # The filter keeps pointers into these arrays.
        self._albedo = np.ascontiguousarray(albedo, np.float32)
        self._normal = np.ascontiguousarray(normal, np.float32)
        self._color = np.zeros_like(self._albedo)
        self._output = np.zeros_like(self._albedo)
        for name, image in (
            (pyoidn.OIDN_IMAGE_COLOR, self._color),
            (pyoidn.OIDN_IMAGE_ALBEDO, self._albedo),
            (pyoidn.OIDN_IMAGE_NORMAL, self._normal),
            (pyoidn.OIDN_IMAGE_OUTPUT, self._output),
        ):
            self._filter.set_image(name, image, pyoidn.OIDN_FORMAT_FLOAT3)
        self._filter.set_bool("hdr", True)
        self._filter.set_bool("cleanAux", True)
        self._filter.commit()

    def __enter__(self) -> Denoiser:
        return self

    def __exit__(self, *_: object) -> None:
        self._filter.release()
        self._device.release()

    def __call__(self, color: np.ndarray) -> np.ndarray:
        """(H, W, 3) float32 denoised image, never negative."""
        self._color[...] = color
        self._filter.execute()
        error = self._device.get_error()
        if error:
            raise RuntimeError(f"Open Image Denoise failed: {error}")
        return np.maximum(self._output, 0.0)
