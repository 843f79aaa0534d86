# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether two photographs are exposures of one view, by their content: small pictures, aligned and compared.

For brackets that time and exposure data do not distinguish from photographs of different views.
"""

from __future__ import annotations

import io
import math
from functools import lru_cache
from pathlib import Path

import numpy as np
import rawpy
from PIL import Image

from ..core.capture.encoded import CLIPPED_CODE
from ..core.capture.images import open_picture
from ..core.run.errors import FiptError
from .brackets import SameView, stops_between
from .exif import DAMAGE
from .frames import linear_frame, load
from .motion import LEAST_OVERLAP, grey, log_values, measure, warped
from .preparation import Photograph
from .response import srgb_curve

SIDE = 96  # pixels of the small pictures' longer side
# Correlation of the logarithms once they are aligned. Exposures of real brackets, up to 3 EV apart, had
# 0.92 and more; neighbouring views of a walk around a building had 0.87 and less.
LEAST_LIKENESS = 0.9
# Measured over nominal stops: cameras' curves are steeper than sRGB's (up to 1.5). A camera that exposes
# automatically makes different views equally bright instead.
LEAST_GAIN, MOST_GAIN = 0.5, 2.0


def likeness(source: Path) -> SameView:
    """Compares photographs of one folder, whose exposures must be known.

    What it returns says None where too little of two photographs is well exposed in both, or readable.

    Args:
        source: folder to which the photographs' paths refer.
    """

    @lru_cache(maxsize=32)  # small pictures in memory: a bracket's
    def picture(photograph: Photograph) -> np.ndarray | None:
        try:
            return small_picture(source / photograph.path, photograph)
        except (FiptError, *DAMAGE):
            return None  # the merge reports what is wrong with it

    def same_view(one: Photograph, other: Photograph) -> bool | None:
        first, second = picture(one), picture(other)
        if first is None or second is None:
            return None
        if first.shape != second.shape:
            return False
        motion = measure(first, second)
        logs = log_values(first), log_values(warped(second[..., None], motion, 0, len(second))[..., 0])
        both = np.isfinite(logs[0]) & np.isfinite(logs[1])
        if motion.similarity == -1.0 or both.mean() < LEAST_OVERLAP:
            return None
        gain = float(np.median((logs[1] - logs[0])[both])) / (math.log(2.0) * stops_between(one, other))
        return motion.similarity >= LEAST_LIKENESS and LEAST_GAIN <= gain <= MOST_GAIN

    return same_view


def small_picture(path: Path, photograph: Photograph) -> np.ndarray:
    """(height, width) linear values, about `SIDE` long; NaN where clipped.

    Of RAW photographs, the preview that the camera has stored is enough.

    Raises:
        FiptError: those of `frames.load`; and what libraries raise for damaged files (`exif.DAMAGE`).
    """
    codes = _codes(path, photograph)
    if codes is not None:
        linear = srgb_curve()[codes, np.arange(3)].astype(np.float32)
        return grey(linear, codes >= CLIPPED_CODE, SIDE)
    stored = load(path, photograph)
    factor = -(-max(photograph.width, photograph.height) // SIDE)
    frame = linear_frame(stored, srgb_curve() if photograph.kind == "ldr" else None, factor)
    return grey(frame.values, frame.clipped, SIDE)


def _codes(path: Path, photograph: Photograph) -> np.ndarray | None:
    """(height, width, 3) uint8 of a JPEG or of a preview, reduced while decoding; None without one."""
    source: Path | io.BytesIO = path
    if photograph.kind == "raw":
        with rawpy.imread(str(path)) as raw:
            try:
                preview = raw.extract_thumb()
            except (rawpy.LibRawNoThumbnailError, rawpy.LibRawUnsupportedThumbnailError):
                return None
        if not isinstance(preview.data, bytes):  # a bitmap
            return None
        source = io.BytesIO(preview.data)
    elif open_picture(path).kind != "jpeg":
        return None
    with Image.open(source, formats=["JPEG"]) as image:
        image.draft("RGB", (4 * SIDE, 4 * SIDE))
        return np.asarray(image.convert("RGB"))
