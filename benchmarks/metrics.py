"""The metrics of the paper's experiments (Sec. 5.1 and 5.2) as pure functions, in two protocols.

PAPER: excluded pixels are black in both images and count as correct, map values have 8 bits, and roughness is
clamped to the model's range. This is equivalent to comparing the maps that the authors' code writes.
STRICT: excluded pixels do not count, values are unclamped floats, and pixels of rendered images that are
clipped in the truth do not count. Map errors are pooled over all pixels of a split; PSNRs of rendered images
are means over images. The paper does not define log L2; here it is the mean squared difference of
log(1 + radiance). Map errors at borders between materials and away from them follow STRICT.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fipt_blender.core.report.comparison import psnr_of, tone_mapped

# Maps of materials whose errors are also told at borders between materials and away from them.
BORDER_METRICS = ("kd_psnr", "a_prime_psnr", "sigma_psnr", "metallic_psnr")
DIFFUSE_ROUGHNESS = 0.999  # half floats and filtering keep "1" above this
MIN_ROUGHNESS = 0.02


@dataclass(frozen=True)
class Maps:
    """Maps of one view, true or predicted.

    Attributes:
        kd: (H, W, 3) diffuse reflectance.
        a_prime: (H, W, 3) reflectance a' = integral of f over the hemisphere.
        base_color: (H, W, 3).
        roughness: (H, W).
        metallic: (H, W).
        emission: (H, W, 3) emitted radiance.
        hit: (H, W) bool, whether the pixel sees the mesh.
        material: (H, W) int, the material at the pixel's centre, 0 for none; only of true maps.
    """

    kd: np.ndarray
    a_prime: np.ndarray
    base_color: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray
    emission: np.ndarray
    hit: np.ndarray
    material: np.ndarray | None = None


def psnr(squared_error: float) -> float:
    """PSNR in dB of a mean squared error of values in [0, 1]; capped at 100 dB for equal images."""
    return psnr_of(max(squared_error, 1e-10))


def quantised(values: np.ndarray) -> np.ndarray:
    """Values as an 8-bit image holds them."""
    return np.round(np.clip(values, 0.0, 1.0) * 255.0) / 255.0


def pooled_psnr(
    predicted: Sequence[np.ndarray],
    true: Sequence[np.ndarray],
    kept: Sequence[np.ndarray],
    strict: bool,
) -> float | None:
    """PSNR over the pixels of all views.

    Args:
        predicted, true: (H, W) or (H, W, C) each.
        kept: (H, W) bool; other pixels are excluded.
        strict: see the module's docstring.

    Returns:
        dB, or None where no pixel is kept.
    """
    total, count, used = 0.0, 0, 0
    for one, other, mask in zip(predicted, true, kept, strict=True):
        one, other = one.astype(np.float64), other.astype(np.float64)
        if not strict:
            one, other = quantised(one), quantised(other)
        error = ((one - other) ** 2).reshape(*mask.shape, -1)[mask]
        total += float(error.sum())
        used += int(mask.sum())
        channels = 1 if one.ndim == 2 else one.shape[2]
        count += (int(mask.sum()) if strict else mask.size) * channels
    return psnr(total / count) if used else None


def surfaces(true: Maps) -> np.ndarray:
    """(H, W) bool: pixels that count for materials; emitters and pixels that miss the mesh are excluded."""
    return true.hit & ~(true.emission > 0.0).any(axis=-1)


def diffuse_surfaces(true: Maps) -> np.ndarray:
    """(H, W) bool: pixels that count for kd, those of true roughness 1."""
    return surfaces(true) & (true.roughness >= DIFFUSE_ROUGHNESS)


def near_borders(material: np.ndarray) -> np.ndarray:
    """(H, W) bool: whether any of the eight pixels around sees another material.

    Args:
        material: (H, W) ids; what lies beyond the image counts as equal.
    """
    height, width = material.shape
    padded = np.pad(material, 1, mode="edge")
    around = [padded[dy : dy + height, dx : dx + width] for dy in range(3) for dx in range(3)]
    return np.any([other != material for other in around], axis=0)


def map_metrics(predicted: Sequence[Maps], true: Sequence[Maps], strict: bool) -> dict[str, float | None]:
    """kd, a', sigma and metallic PSNR, emission IoU and log L2 of the views of one split."""
    everywhere = [np.ones(view.hit.shape, bool) for view in true]
    return material_metrics(predicted, true, everywhere, strict) | {
        "emission_iou": emission_iou([view.emission for view in predicted], [view.emission for view in true]),
        "emission_log_l2": log_l2([view.emission for view in predicted], [view.emission for view in true]),
    }


def border_metrics(predicted: Sequence[Maps], true: Sequence[Maps]) -> dict[str, Any]:
    """The strict PSNRs of `BORDER_METRICS` over pixels near borders and over all others.

    Args:
        true: at least one view; its materials are known.

    Returns:
        ``edge`` and ``inside``: dB by metric; ``edge_share``: pixels near borders, of all pixels.
    """
    edge = [near_borders(view.material) for view in true if view.material is not None]
    return {
        "edge": material_metrics(predicted, true, edge, strict=True),
        "inside": material_metrics(predicted, true, [~near for near in edge], strict=True),
        "edge_share": float(sum(near.sum() for near in edge) / sum(near.size for near in edge)),
    }


def material_metrics(
    predicted: Sequence[Maps], true: Sequence[Maps], region: Sequence[np.ndarray], strict: bool
) -> dict[str, float | None]:
    """kd, a', sigma and metallic PSNR over the surfaces in a region (H, W) bool of each view."""
    plain = [surfaces(view) & inside for view, inside in zip(true, region, strict=True)]
    diffuse = [diffuse_surfaces(view) & inside for view, inside in zip(true, region, strict=True)]
    found = {}
    for metric, name in zip(BORDER_METRICS, ("kd", "a_prime", "roughness", "metallic"), strict=True):
        pair = [[getattr(view, name) for view in side] for side in (predicted, true)]
        if name == "roughness" and not strict:
            pair = [[np.clip(image, MIN_ROUGHNESS, 1.0) for image in side] for side in pair]
        found[metric] = pooled_psnr(*pair, diffuse if name == "kd" else plain, strict)
    return found


def emission_iou(predicted: Sequence[np.ndarray], true: Sequence[np.ndarray]) -> float:
    """Intersection over union of the pixels with emission, over all views; 1 where there is none in either.

    Args:
        predicted, true: (H, W, 3) emitted radiance.
    """
    both = either = 0
    for one, other in zip(predicted, true, strict=True):
        first, second = (one > 0.0).any(axis=-1), (other > 0.0).any(axis=-1)
        both += int((first & second).sum())
        either += int((first | second).sum())
    return both / either if either else 1.0


def log_l2(predicted: Sequence[np.ndarray], true: Sequence[np.ndarray]) -> float:
    """Mean over all pixels and channels of the squared difference of log(1 + radiance)."""
    total, count = 0.0, 0
    for one, other in zip(predicted, true, strict=True):
        error = np.log1p(np.maximum(one, 0.0).astype(np.float64)) - np.log1p(other.astype(np.float64))
        total += float((error**2).sum())
        count += error.size
    return total / count


def image_psnr(predicted: np.ndarray, true: np.ndarray, strict: bool = False) -> float | None:
    """PSNR of one rendered image (H, W, 3) after tone mapping; None where no pixel counts."""
    error = (tone_mapped(predicted) - tone_mapped(true)) ** 2
    if strict:
        error = error[(true < 1.0).any(axis=-1)]
    return psnr(float(error.mean())) if error.size else None


def mean_image_psnr(
    predicted: Sequence[np.ndarray], true: Sequence[np.ndarray], strict: bool = False
) -> float | None:
    """Mean over images of `image_psnr`, or None without images."""
    values = [image_psnr(one, other, strict) for one, other in zip(predicted, true, strict=True)]
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
