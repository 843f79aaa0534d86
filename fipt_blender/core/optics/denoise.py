"""Open Image Denoise, with guides: for baked shadings and for rendered images."""

from __future__ import annotations

import numpy as np
import pyoidn

# Images are padded by mirroring this many pixels: at a border, with context on one side only, the denoiser
# leaves fireflies.
MARGIN = 16


class Denoiser:
    """Denoises HDR images of one size that share their guides.

    Args:
        albedo: (H, W, 3) float32 in [0, 1]; its edges are preserved.
        normal: (H, W, 3) float32 unit normals, any space. Neither has noise: their details are preserved.
        fast: use the smallest network, in a quarter of the time. For shadings, where its error is 4 % larger,
            not for pictures.

    Use as a context manager; images are finite and non-negative.
    """

    def __init__(self, albedo: np.ndarray, normal: np.ndarray, fast: bool = False) -> None:
        height, width = albedo.shape[:2]
        self._pad = [(min(MARGIN, height - 1),) * 2, (min(MARGIN, width - 1),) * 2, (0, 0)]
        self._inside = (
            slice(self._pad[0][0], self._pad[0][0] + height),
            slice(self._pad[1][0], self._pad[1][0] + width),
        )
        self._device = pyoidn.Device()
        self._device.commit()
        guides = {
            pyoidn.OIDN_IMAGE_ALBEDO: self._mirror(albedo),
            pyoidn.OIDN_IMAGE_NORMAL: self._mirror(normal),
        }
        self._filter = pyoidn.Filter(self._device, pyoidn.OIDN_FILTER_TYPE_RT)
        # The filter keeps pointers into these arrays.
        self._guides = guides
        self._color = np.zeros_like(guides[pyoidn.OIDN_IMAGE_ALBEDO])
        self._output = np.zeros_like(self._color)
        images = {**guides, pyoidn.OIDN_IMAGE_COLOR: self._color, pyoidn.OIDN_IMAGE_OUTPUT: self._output}
        for kind, image in images.items():
            self._filter.set_image(kind, image, pyoidn.OIDN_FORMAT_FLOAT3)
        self._filter.set_bool("hdr", True)
        self._filter.set_bool("cleanAux", True)
        self._filter.set_int("quality", pyoidn.OIDN_QUALITY_FAST if fast else pyoidn.OIDN_QUALITY_HIGH)
        self._filter.commit()

    def _mirror(self, image: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(np.pad(image, self._pad, mode="reflect"), np.float32)

    def __enter__(self) -> Denoiser:
        return self

    def __exit__(self, *_: object) -> None:
        self._filter.release()
        self._device.release()

    def __call__(self, color: np.ndarray) -> np.ndarray:
        """(H, W, 3) float32 denoised image, never negative."""
        self._color[...] = self._mirror(color)
        self._filter.execute()
        error = self._device.get_error()
        if error:
            raise RuntimeError(f"Open Image Denoise failed: {error}")
        return np.maximum(self._output[self._inside], 0.0)
