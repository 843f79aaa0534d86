"""What all groups say together before any is merged: motion, noise, exposure ratios, the response."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..core.capture.encoded import CLIPPED_CODE
from ..core.run.messages import Reporter
from .brackets import stops_between
from .frames import Frame, Stored, block_mean, blocks, common_ceiling, linear_frame, load
from .merging import SAMPLE_SIDE, UNKNOWN_NOISE, Noise, code_noise, measure_noise, sensor_noise
from .motion import FINEST_SIDE, STILL_PIXELS, Motion, after, grey, measure, warped
from .preparation import Group, Photograph, Preparation
from .response import Response, recover_response, srgb_curve

SMOOTH_CODES = 4.0  # places with a larger spread of codes lie on edges
LEAST_SIMILARITY = 0.5  # of exposures that show the same
_LOW, _HIGH = 0.02, 0.8  # linear values at which exposures are compared
_MOST_CORRECTION = 0.2  # in the logarithm
_PARTS = 8  # of a single group's pixels
_DOUBTFUL = 0.15  # correction in the logarithm that the rounding of EXIF does not explain
_LINEAR_CURVE = np.repeat(np.linspace(0.0, 1.0, 256)[:, None], 3, 1)  # by code and channel


@dataclass(frozen=True, eq=False)
class Survey:
    """One group before merging, its exposures from the shortest to the longest."""

    motions: tuple[Motion, ...] = ()  # of each exposure, relative to one in the middle
    strangers: tuple[int, ...] = ()  # indices of exposures that show something else
    # Log of what exposure j + 1 received over what exposure j did, less that of the headers' ratio; NaN
    # where they can't be compared. RAW only.
    ratios: tuple[float, ...] = ()
    noise: tuple[float, float] | None = None  # gain and read noise; RAW only
    samples: np.ndarray | None = None  # (places, exposures, 3) codes of 8 bits, NaN where unusable; LDR only
    # Where each exposure seems to clip, and its highest value; RAW only
    ceilings: tuple[tuple[float, float], ...] = ()
    # The first photograph without its values, for the colors of its camera; RAW only
    color: Stored | None = None


@dataclass(frozen=True, eq=False)
class Calibration:
    """What all groups share."""

    photographs: Mapping[str, Photograph]  # by path, with corrected exposures
    curve: np.ndarray | None  # (256, 3) linear values of codes, None without LDR photographs
    noise: Mapping[str, Noise]  # by kind of photograph
    scale: float  # exposure that a radiance of 1 saturates
    ceiling: float  # value at which RAW photographs clip
    # Of each camera (`camera_of`), balance (3,) and matrix (3, 3) from RAW channels to linear Rec.709;
    # see `frames.Stored`
    colors: Mapping[str, tuple[np.ndarray, np.ndarray]]

    @property
    def numbers(self) -> list[object]:
        """What differs for calibrations that give different images (JSON)."""
        arrays = [self.curve, *(noise.weights for _, noise in sorted(self.noise.items()))]
        lists = [None if array is None else array.tolist() for array in arrays]
        colors = [[camera, *(each.tolist() for each in both)] for camera, both in sorted(self.colors.items())]
        return [self.scale, self.ceiling, *lists, colors]


def survey_group(preparation: Preparation, group: Group, most: int) -> Survey:
    """Compare the exposures of one group on coarse grids.

    Args:
        preparation, group: whose photographs are read.
        most: number of samples of codes.
    """
    photographs, settings = preparation.of(group), preparation.settings
    kind = photographs[0].kind
    frames, codes, ceilings, noise, color = [], [], [], None, None
    for index, photograph in enumerate(photographs):
        stored = load(preparation.file(photograph), photograph, settings)
        factor = max(1, max(stored.values.shape[:2]) // FINEST_SIDE)
        frames.append(linear_frame(stored, srgb_curve() if kind == "ldr" else None, factor))
        if kind == "ldr":
            codes.append(_calm_codes(stored.values))
        if kind == "raw":
            ceilings.append((stored.ceiling, stored.top))
            color = color or replace(stored, values=np.empty(0), colors=None)
        if index == len(photographs) // 2 and stored.colors is not None:
            noise = measure_noise(stored.values, max(stored.colors.shape))
    motions, strangers = _motions(frames, settings.align)
    samples = _samples(codes, motions, most) if len(codes) > 1 else None
    ratios: list[float] = []
    if kind == "raw":
        grids = [_grid(frame, motion) for frame, motion in zip(frames, motions, strict=True)]
        for j, (low, high) in enumerate(itertools.pairwise(grids)):
            nominal = math.log(2.0) * stops_between(photographs[j], photographs[j + 1])
            ratios.append(_log_ratio(low, high) - nominal)
    return Survey(motions, strangers, tuple(ratios), noise, samples, tuple(ceilings), color)


def calibrate(
    preparation: Preparation, surveys: Sequence[Survey], reporter: Reporter
) -> tuple[Calibration, Response | None]:
    """Put together what the groups' surveys say; warns where they say too little.

    Returns:
        What all groups share, and the response of their codes where it was recovered.
    """
    groups = [preparation.of(group) for group in preparation.used_groups]
    corrections, largest = correct_exposures(groups, surveys)
    if largest > _DOUBTFUL:
        reporter.warning("exposure-doubtful", largest=100 * largest)
    photographs = {item.path: item for items in groups for item in items}
    for path, item in photographs.items():
        if item.exposure is not None:
            factor = math.exp(corrections.get(exposure_key(item), 0.0))
            photographs[path] = replace(item, exposure=item.exposure * factor)
    measured = [survey.noise for survey in surveys if survey.noise is not None]
    noise = {
        "linear": sensor_noise(*UNKNOWN_NOISE),
        "raw": sensor_noise(*(np.median(measured, axis=0) if measured else UNKNOWN_NOISE)),
    }
    curve, response = None, None
    if any(items[0].kind == "ldr" for items in groups):
        curve, response = _curve(preparation.settings.response, groups, surveys, reporter)
        noise["ldr"] = code_noise(curve, np.zeros((256, 3)) if response is None else response.uncertainty)
    exposures = [item.exposure for item in photographs.values() if item.exposure and item.kind != "linear"]
    colors: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for items, survey in zip(groups, surveys, strict=True):
        if survey.color is not None:
            own = survey.color.balance if preparation.settings.white_balance == "camera" else np.ones(3)
            colors.setdefault(camera_of(items[0]), (own, survey.color.matrix))
    pairs = [pair for survey in surveys for pair in survey.ceilings]
    calibration = Calibration(
        photographs,
        curve,
        noise,
        scale=float(np.median(exposures)) if exposures else 1.0,
        ceiling=common_ceiling([pair[0] for pair in pairs], [pair[1] for pair in pairs]),
        colors=colors,
    )
    return calibration, response


def _curve(
    choice: str, groups: Sequence[Sequence[Photograph]], surveys: Sequence[Survey], reporter: Reporter
) -> tuple[np.ndarray, Response | None]:
    """The curve of codes, and the response if it was recovered."""
    if choice != "auto":
        return (_LINEAR_CURVE if choice == "linear" else srgb_curve()), None
    samples, exposures = [], []
    for items, survey in zip(groups, surveys, strict=True):
        if survey.samples is not None and len(survey.samples):
            samples.append(survey.samples)
            exposures.append(np.array([item.exposure for item in items], np.float64))
    if len(samples) == 1:  # in parts, so that its uncertainty can be estimated, too
        samples = [part for part in np.array_split(samples[0], _PARTS) if len(part)]
        exposures *= len(samples)
    try:
        response = recover_response(samples, exposures)
    except (ValueError, np.linalg.LinAlgError):
        reporter.warning("response-unknown")
        return srgb_curve(), None
    return response.curve, response


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
    low, high = np.array(list(measured)).T
    weights = np.sqrt([len(ratios) for ratios in measured.values()])
    medians = np.array([np.median(ratios) for ratios in measured.values()])
    unit = np.eye(len(keys))
    found = np.linalg.lstsq(weights[:, None] * (unit[high] - unit[low]), weights * medians, rcond=None)[0]
    largest = float(np.abs(found).max())
    found = np.clip(found, -_MOST_CORRECTION, _MOST_CORRECTION)
    return {key: float(found[index]) for key, index in places.items()}, largest


def camera_of(photograph: Photograph) -> str:
    """The camera by its make and model, on which the colors of RAW files depend."""
    return f"{photograph.make} {photograph.model}"


def exposure_key(photograph: Photograph) -> tuple[float, ...]:
    """What photographs of one exposure have in common."""
    return tuple(getattr(photograph, name) or 0.0 for name in ("shutter", "aperture", "iso", "exposure"))


def _motions(frames: Sequence[Frame], align: bool) -> tuple[tuple[Motion, ...], tuple[int, ...]]:
    """Motions relative to a reference in the middle, from one exposure to the next, which overlap best."""
    reference = len(frames) // 2
    if len(frames) == 1 or not align:
        return tuple(Motion() for _ in frames), ()
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
    return tuple(motions), tuple(sorted(strangers))


def _grid(frame: Frame, motion: Motion) -> np.ndarray:
    """Means (rows, columns, 3) over squares, NaN where any pixel is clipped, in the reference's geometry."""
    values = np.where(frame.clipped, np.nan, frame.values.astype(np.float32))
    coarse = block_mean(values, max(1, max(values.shape[:2]) // SAMPLE_SIDE))
    return coarse if motion == Motion() else warped(coarse, motion, 0, len(coarse))


def _log_ratio(low: np.ndarray, high: np.ndarray) -> float:
    """Log of what an exposure received over what a shorter one did, NaN where they can't be compared."""
    with np.errstate(invalid="ignore"):
        good = (low > _LOW) & (high < _HIGH)
    return float(np.log(np.median(high[good] / low[good]))) if good.sum() >= 50 else float("nan")


def _calm_codes(values: np.ndarray) -> np.ndarray:
    """Mean codes of 8 bits over squares, NaN where a square lies on an edge or any code is clipped."""
    squares = blocks(values, max(1, max(values.shape[:2]) // SAMPLE_SIDE))
    scale = np.float32(255.0 / np.iinfo(values.dtype).max)
    mean = squares.mean(axis=(1, 3), dtype=np.float32) * scale
    spread = squares.std(axis=(1, 3), dtype=np.float32) * scale
    calm = (spread <= SMOOTH_CODES) & (mean < CLIPPED_CODE).all(axis=-1, keepdims=True)
    return np.where(calm, mean, np.nan)


def _samples(codes: Sequence[np.ndarray], motions: Sequence[Motion], most: int) -> np.ndarray:
    """(places, exposures, 3) codes at the reference's places with two usable exposures or more."""
    moved = (
        grid if motion == Motion() else warped(grid, motion, 0, len(grid))
        for grid, motion in zip(codes, motions, strict=True)
    )
    samples = np.stack([grid.reshape(-1, 3) for grid in moved], 1)
    samples = samples[np.isfinite(samples).any(axis=-1).sum(axis=1) >= 2]
    return samples[:: max(1, -(-len(samples) // most))].astype(np.float16)
