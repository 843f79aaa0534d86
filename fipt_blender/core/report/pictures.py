# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Writing pictures as PNG and JPEG files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from ..run.runfolder import atomic_path


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
