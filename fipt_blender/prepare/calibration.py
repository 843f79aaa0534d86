# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What all groups say together before any is merged: motion, noise, exposure ratios, the response."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .frames import CLIPPED_CODE, Frame, Stored, block_mean, linear_frame
from .merging import SAMPLE_SIDE, measure_noise
from .motion import FINEST_SIDE, STILL_PIXELS, Motion, after, grey, measure, warped
from .preparation import Photograph
from .response import Response, recover_response, split_samples, srgb_curve

MOST_SAMPLES = 400_000  # of all pairs of exposures
SMOOTH_CODES = 4.0  # places with a larger spread of codes lie on edges
LEAST_SIMILARITY = 0.5  # of exposures that show the same
_LOW, _HIGH = 0.02, 0.8  # linear values at which exposures are compared
_MOST_CORRECTION = 0.2  # in the logarithm


@dataclass(frozen=True, eq=False)
class Survey:
    """One group before merging, its exposures from the shortest to the longest.

    Attributes:
        motions: of each exposure, relative to `reference`.
        reference: index of the exposure that the others are aligned with.
        strangers: indices of exposures that show something else.
        ratios: log of what exposure j + 1 received over what exposure j did, less that of the headers' ratio;
            NaN where they can't be compared. RAW only.
        noise: gain and read noise; RAW only.
        samples: (places, exposures, 3) codes of 8 bits, NaN where unusable; LDR only.
        ceilings: where each exposure seems to clip, and its highest value; RAW only.
    """

    motions: tuple[Motion, ...]
    reference: int
    strangers: tuple[int, ...]
    ratios: tuple[float, ...]
    noise: tuple[float, float] | None
    samples: np.ndarray | None
    ceilings: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class Observed:
    """One exposure on coarse grids.

    Attributes:
        frame: linear values (by sRGB's curve for codes), 1024 to 2048 pixels long or less.
        codes: (rows, columns, 3) mean codes of 8 bits of calm squares, NaN elsewhere; LDR only.
        noise: gain and read noise; RAW only.
        ceiling: where it seems to clip, and its highest value.
    """

    frame: Frame
    codes: np.ndarray | None
    noise: tuple[float, float] | None
    ceiling: tuple[float, float]


def observe(stored: Stored, photograph: Photograph, with_noise: bool) -> Observed:
    """What a group's survey needs of one photograph."""
    is_ldr = photograph.kind == "ldr"
    factor = max(1, max(stored.values.shape[:2]) // FINEST_SIDE)
    noise = None
    if with_noise and stored.colors is not None:
        noise = measure_noise(stored.values, max(stored.colors.shape))
    frame = linear_frame(stored, srgb_curve() if is_ldr else None, factor)
    return Observed(
        frame, _calm_codes(stored.values) if is_ldr else None, noise, (stored.ceiling, stored.top)
    )


def survey_group(
    observed: Sequence[Observed], photographs: Sequence[Photograph], align: bool, most: int
) -> Survey:
    """Compare the exposures of one group.

    Args:
        observed: of the group's photographs, shortest exposure first.
        photographs: the same ones' headers.
        align: measure motion; otherwise the camera is taken to stand still.
        most: number of samples of codes.
    """
    frames = [item.frame for item in observed]
    exposures = [item.exposure or 1.0 for item in photographs]
    motions, reference, strangers = _motions(frames, align)
    ratios: tuple[float, ...] = ()
    if photographs[0].kind == "raw":
        ratios = tuple(
            _ratio(frames[j], frames[j + 1], exposures[j + 1] / exposures[j], motions[j], motions[j + 1])
            for j in range(len(frames) - 1)
        )
    noise = next((item.noise for item in observed if item.noise is not None), None)
    codes = [item.codes for item in observed if item.codes is not None]
    samples = _samples(codes, motions, most) if len(codes) > 1 else None
    ceilings = tuple(item.ceiling for item in observed) if photographs[0].kind == "raw" else ()
    return Survey(motions, reference, strangers, ratios, noise, samples, ceilings)


def correct_exposures(
    groups: Sequence[Sequence[Photograph]], surveys: Sequence[Survey]
) -> tuple[dict[tuple[float, ...], float], float]:
    """Corrections of the headers' exposures, which cameras round (1/60 stands for 1/64).

    One correction for each combination of shutter, aperture and ISO, from all groups; their mean is zero.

    Returns:
        Log of the true exposure over the header's by `exposure_key`, and the largest of them.
    """
    keys = sorted({exposure_key(item) for items in groups for item in items})
    places = {key: index for index, key in enumerate(keys)}
    measured: dict[tuple[int, int], list[float]] = {}
    for items, survey in zip(groups, surveys, strict=True):
        for j, ratio in enumerate(survey.ratios):
            if np.isfinite(ratio):
                pair = places[exposure_key(items[j])], places[exposure_key(items[j + 1])]
                measured.setdefault(pair, []).append(ratio)
    if not measured:
        return {}, 0.0
    design, target = [], []
    for (low, high), ratios in measured.items():
        weight = np.sqrt(len(ratios))
        row = np.zeros(len(keys))
        row[high], row[low] = weight, -weight
        design.append(row)
        target.append(weight * float(np.median(ratios)))
    found = np.linalg.lstsq(np.array(design), np.array(target), rcond=None)[0]
    largest = float(np.abs(found).max())
    found = np.clip(found, -_MOST_CORRECTION, _MOST_CORRECTION)
    return {key: float(found[index]) for key, index in places.items()}, largest


def exposure_key(photograph: Photograph) -> tuple[float, ...]:
    """What photographs of one exposure have in common."""
    return (
        photograph.shutter or 0.0,
        photograph.aperture or 0.0,
        photograph.iso or 0.0,
        photograph.exposure or 0.0,
    )


def find_response(samples: Sequence[np.ndarray], exposures: Sequence[np.ndarray]) -> Response | None:
    """The response from all groups' samples; None where they don't determine it.

    Args:
        samples: see `Survey.samples`, one for each group.
        exposures: (exposures,) of each group.
    """
    if len(samples) == 1:
        samples, exposures = split_samples(samples[0], exposures[0], 8)
    try:
        return recover_response(samples, exposures)
    except (ValueError, np.linalg.LinAlgError):
        return None


def with_correction(photograph: Photograph, corrections: Mapping[tuple[float, ...], float]) -> Photograph:
    """The photograph with its corrected exposure."""
    if photograph.exposure is None:
        return photograph
    factor = float(np.exp(corrections.get(exposure_key(photograph), 0.0)))
    return replace(photograph, exposure=photograph.exposure * factor)


def _motions(frames: Sequence[Frame], align: bool) -> tuple[tuple[Motion, ...], int, tuple[int, ...]]:
    """Motions relative to a reference in the middle, from one exposure to the next, which overlap best."""
    reference = len(frames) // 2
    if len(frames) == 1 or not align:
        return tuple(Motion() for _ in frames), reference, ()
    pictures = [grey(frame.values, frame.clipped) for frame in frames]
    motions: list[Motion] = [Motion()] * len(frames)
    strangers: list[int] = []
    for way in (range(reference - 1, -1, -1), range(reference + 1, len(frames))):
        last = reference
        for j in way:
            step = measure(pictures[last], pictures[j])
            if step.similarity < LEAST_SIMILARITY:
                # -1: too few pixels are well exposed in both to compare them.
                if step.similarity != -1.0:
                    strangers.append(j)
                    continue
                step = Motion()
            motions[j] = after(motions[last], step)
            last = j
    height, width = frames[0].values.shape[:2]
    still = [motion.corner_shift(width, height) < STILL_PIXELS for motion in motions]
    motions = [Motion() if calm else motion for motion, calm in zip(motions, still, strict=True)]
    return tuple(motions), reference, tuple(sorted(strangers))


def _grid(frame: Frame, motion: Motion) -> np.ndarray:
    """Means (rows, columns, 3) over squares, NaN where any pixel is clipped, in the reference's geometry."""
    values = np.where(frame.clipped, np.nan, frame.values.astype(np.float32))
    factor = max(1, max(values.shape[:2]) // SAMPLE_SIDE)
    height, width = (size // factor * factor for size in values.shape[:2])
    coarse = block_mean(values[:height, :width], factor)
    return coarse if motion == Motion() else warped(coarse, motion, 0, len(coarse))


def _ratio(low: Frame, high: Frame, nominal: float, low_motion: Motion, high_motion: Motion) -> float:
    first, second = _grid(low, low_motion), _grid(high, high_motion)
    with np.errstate(invalid="ignore"):
        good = (first > _LOW) & (second < _HIGH)
    if good.sum() < 50:
        return float("nan")
    return float(np.log(np.median(second[good] / first[good]) / nominal))


def _calm_codes(values: np.ndarray) -> np.ndarray:
    """Mean codes of 8 bits over squares, NaN where a square lies on an edge or any code is clipped."""
    factor = max(1, max(values.shape[:2]) // SAMPLE_SIDE)
    height, width = (size // factor * factor for size in values.shape[:2])
    scale = np.float32(255.0 / np.iinfo(values.dtype).max)
    grid = np.empty((height // factor, width // factor, 3), np.float32)
    for row in range(height // factor):
        codes = values[row * factor : (row + 1) * factor, :width].astype(np.float32) * scale
        mean = block_mean(codes, factor)
        spread = np.sqrt(np.maximum(block_mean(codes**2, factor) - mean**2, 0.0))
        mean[(spread > SMOOTH_CODES) | (mean >= CLIPPED_CODE).any(axis=-1, keepdims=True)] = np.nan
        grid[row] = mean[0]
    return grid


def _samples(codes: Sequence[np.ndarray], motions: Sequence[Motion], most: int) -> np.ndarray:
    """(places, exposures, 3) codes at the reference's places with two usable exposures or more."""
    moved = (
        grid if motion == Motion() else warped(grid, motion, 0, len(grid))
        for grid, motion in zip(codes, motions, strict=True)
    )
    samples = np.stack([grid.reshape(-1, 3) for grid in moved], 1)
    samples = samples[np.isfinite(samples).any(axis=-1).sum(axis=1) >= 2]
    return samples[:: max(1, -(-len(samples) // most))].astype(np.float16)
