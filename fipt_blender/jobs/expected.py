"""Expected times of a job's steps, from what the steps before have written into the run folder.

Seconds on two idle cores, for progress only; None while the files are not there or can't be read.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps

import numpy as np

from ..core.run.documents import read_document
from ..core.run.errors import FiptError
from ..core.run.light_size import light_plan, light_size
from ..core.run.result_contents import AtlasImages
from ..core.run.run_files import read_capture
from ..core.run.runfolder import RunFolder
from ..core.run.settings import Settings

# Seconds for each triangle that is unwrapped; before them one (scans of 0.9 million triangles).
UNWRAPPED = 2.5e-5
# Seconds for each texel, and for each million pixels of photographs that are larger than light is solved at;
# before them a few (the example room and two real rooms).
TEXTURES, TEXEL, DETAIL = 6.0, 1.2e-6, 1.1
# Seconds for each picture, and for each million samples of Cycles.
PICTURE, SAMPLES = 8.0, 0.8


def _known(work: Callable[..., float | None]) -> Callable[..., float | None]:
    @wraps(work)
    def guarded(*arguments: object) -> float | None:
        try:
            return work(*arguments)
        except (FiptError, OSError, ValueError, KeyError):
            return None

    return guarded


def _photographs(run: RunFolder) -> list[tuple[int, int]]:
    """Width and height of the training views."""
    views = read_capture(run.capture_json).views
    return [(view.width, view.height) for view in views if view.split == "train"]


@_known
def estimate_seconds(run: RunFolder, settings: Settings) -> float | None:
    """Of the engine's estimation."""
    sizes = _photographs(run)
    return light_plan(sizes, settings).seconds if sizes else None


@_known
def atlas_seconds(run: RunFolder) -> float:
    """Of unwrapping and packing."""
    with np.load(run.room_npz, allow_pickle=False) as room:
        return 1.0 + UNWRAPPED * len(room["triangles"])


@_known
def texture_seconds(run: RunFolder, settings: Settings) -> float:
    """Of baking onto the atlas, or onto one image while there is none."""
    texels = settings.texture_size**2
    if run.atlas_json.exists():
        images = read_document(run.atlas_json, AtlasImages).images
        texels = sum(image.width * image.height for image in images)
    sizes = _photographs(run)
    pairs = zip(sizes, light_size(sizes, settings.light_pixels), strict=True)
    larger = sum(full[0] * full[1] for full, light in pairs if full != light) if settings.detail else 0
    return TEXTURES + TEXEL * texels + DETAIL * larger / 1e6


@_known
def render_seconds(run: RunFolder, count: int, samples: int) -> float:
    """Of so many pictures with so many samples a pixel."""
    views = read_capture(run.capture_json).views
    pixels = float(np.median([view.width * view.height for view in views]))
    return count * (PICTURE + SAMPLES * samples * pixels / 1e6)
