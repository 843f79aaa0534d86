# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Step `merge`: images/NAME.exr of all groups, on one scale; one group at a time, in bands of rows."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from PIL import Image

from ..core.capture.images import HALF_MAX, write_exr
from ..core.run.documents import optional_document
from ..core.run.errors import FiptError
from ..core.run.messages import Reporter
from ..core.run.runfolder import atomic_path, write_json
from .calibration import (
    MOST_SAMPLES,
    Survey,
    correct_exposures,
    find_response,
    observe,
    survey_group,
    with_correction,
)
from .facts import MergedImage, MergeFacts, ResponseFacts
from .frames import Frame, Stored, common_ceiling, linear_frame, load, upright
from .lens import vignetting
from .merging import Noise, code_noise, in_rec709, merge_group, resized, sensor_noise
from .preparation import Group, Photograph, Preparation, PreparationFolder
from .response import Response, srgb_curve
from .steps import code_digest

MUCH_CLIPPED = 2e-4  # share of a view's pixels
_LINEAR_CURVE = np.repeat(np.linspace(0.0, 1.0, 256)[:, None], 3, 1)
_UNKNOWN_NOISE = (1e-4, 1e-3)


@dataclass(frozen=True, eq=False)
class Calibration:
    """What all groups share.

    Attributes:
        photographs: by path, with corrected exposures.
        curve: (256, 3) linear values of codes, None without LDR photographs.
        noise: by kind of photograph.
        scale: exposure that a radiance of 1 saturates.
        ceiling: value at which RAW photographs clip.
        balance, matrix: from RAW channels to linear Rec.709; see `frames.Stored`.
    """

    photographs: Mapping[str, Photograph]
    curve: np.ndarray | None
    noise: Mapping[str, Noise]
    scale: float
    ceiling: float
    balance: np.ndarray
    matrix: np.ndarray

    def digest(self) -> str:
        """A text that differs for calibrations that give different images."""
        value = hashlib.sha256(
            repr((self.scale, self.ceiling, self.balance.tolist(), self.matrix.tolist())).encode()
        )
        for array in (self.curve, *(noise.weights for _, noise in sorted(self.noise.items()))):
            value.update(b"none" if array is None else np.ascontiguousarray(array).tobytes())
        return value.hexdigest()[:24]


def key(folder: PreparationFolder, preparation: Preparation) -> Any:
    """The groups, their files and exposures, and the settings of merging."""
    return [_settings_key(preparation), [_group_key(preparation, group) for group in preparation.used_groups]]


def run(folder: PreparationFolder, preparation: Preparation, reporter: Reporter) -> MergeFacts:
    """Merge all used groups.

    Raises:
        FiptError: ``no-photographs``, ``exposure-unknown``, ``bracket-mixed``, and those of `frames.load`.
    """
    groups = preparation.used_groups
    _check(preparation, groups)
    surveys: list[Survey] = []
    color: Stored | None = None
    for index, group in enumerate(groups):
        survey, first = _survey(preparation, group, MOST_SAMPLES // len(groups))
        surveys.append(survey)
        color = color or first
        reporter.progress(0.5 * (index + 1) / len(groups))
    calibration, response = calibrate(preparation, surveys, color, reporter)
    _forget_others(folder, groups)
    entries = []
    for index, (group, survey) in enumerate(zip(groups, surveys, strict=True)):
        entries.append(merged_group(folder, preparation, group, survey, calibration))
        reporter.progress(0.5 + 0.5 * (index + 1) / len(groups))
    _warn(reporter, entries)
    facts = None if response is None else _response_facts(response)
    return MergeFacts(tuple(entries), calibration.scale, facts)


def _response_facts(response: Response) -> ResponseFacts:
    """The curve of each channel, and the median standard deviation of its logarithm."""
    middle = response.uncertainty[16:240]  # the ends are clipped or noise
    return ResponseFacts(response.curve.T.tolist(), round(float(np.median(middle)), 5))


def calibrate(
    preparation: Preparation, surveys: Sequence[Survey], color: Stored | None, reporter: Reporter
) -> tuple[Calibration, Response | None]:
    """Put together what the groups' surveys say; warns where they say too little."""
    groups = [preparation.of(group) for group in preparation.used_groups]
    corrections, largest = correct_exposures(groups, surveys)
    if largest > 0.15:
        reporter.warning(
            "exposure-doubtful",
            f"The photographs' brightness departs from their exposure data by up to {100 * largest:.0f} %.",
            "Flickering light, automatic ISO and edited files have this effect: leave such groups out.",
        )
    photographs = {item.path: with_correction(item, corrections) for items in groups for item in items}
    curve, response = _curve(preparation, groups, surveys, reporter)
    noise = {"linear": sensor_noise(*_UNKNOWN_NOISE)}
    measured = [survey.noise for survey in surveys if survey.noise is not None]
    noise["raw"] = sensor_noise(*(np.median(measured, axis=0) if measured else _UNKNOWN_NOISE))
    if curve is not None:
        noise["ldr"] = code_noise(curve, np.zeros((256, 3)) if response is None else response.uncertainty)
    exposures = [item.exposure for item in photographs.values() if item.exposure and item.kind != "linear"]
    balance, matrix = np.ones(3), np.eye(3)
    if color is not None:
        matrix = color.matrix
        balance = color.balance if preparation.settings.white_balance == "camera" else balance
    scale = float(np.median(exposures)) if exposures else 1.0
    pairs = [pair for survey in surveys for pair in survey.ceilings]
    ceiling = common_ceiling([pair[0] for pair in pairs], [pair[1] for pair in pairs])
    return Calibration(photographs, curve, noise, scale, ceiling, balance, matrix), response


def _check(preparation: Preparation, groups: Sequence[Group]) -> None:
    if not groups:
        raise FiptError(
            "no-photographs", "No group of photographs is used.", "Find the brackets, and tick some groups."
        )
    for group in groups:
        items = preparation.of(group)
        if len(items) > 1 and any(item.exposure is None for item in items):
            raise FiptError(
                "exposure-unknown",
                f"The group '{group.name}' has photographs without exposure data (EXIF).",
                "Enter their exposures in prepare.json, split the group, or untick it.",
            )
        if len({(item.kind, item.upright_size, item.orientation) for item in items}) > 1:
            raise FiptError(
                "bracket-mixed",
                f"The photographs of the group '{group.name}' differ in format, size or orientation.",
                "Correct the group: all exposures of a view must come from one camera that is held alike.",
            )


def _survey(preparation: Preparation, group: Group, most: int) -> tuple[Survey, Stored | None]:
    """A group's survey, and its first RAW photograph, without values, for the colors of all."""
    photographs = preparation.of(group)
    observed, color = [], None
    for index, photograph in enumerate(photographs):
        stored = load(preparation.file(photograph), photograph, preparation.settings)
        observed.append(observe(stored, photograph, index == len(photographs) // 2))
        if photograph.kind == "raw" and color is None:
            color = replace(stored, values=np.empty(0), colors=None)
    return survey_group(observed, photographs, preparation.settings.align, most), color


def _curve(
    preparation: Preparation,
    groups: Sequence[Sequence[Photograph]],
    surveys: Sequence[Survey],
    reporter: Reporter,
) -> tuple[np.ndarray | None, Response | None]:
    """The curve of codes, and the response if it was recovered."""
    if not any(items[0].kind == "ldr" for items in groups):
        return None, None
    choice = preparation.settings.response
    if choice == "linear":
        return _LINEAR_CURVE, None
    response = None
    if choice == "auto":
        pairs = [
            (survey.samples, np.array([item.exposure for item in items], np.float64))
            for items, survey in zip(groups, surveys, strict=True)
            if survey.samples is not None and len(survey.samples)
        ]
        response = find_response([pair[0] for pair in pairs], [pair[1] for pair in pairs]) if pairs else None
        if response is None:
            reporter.warning(
                "response-unknown",
                "The camera's response can't be recovered without brackets; sRGB's is assumed, and radiance"
                " may be wrong by tens of percent.",
                "Take brackets or RAW photographs.",
            )
    return (srgb_curve() if response is None else response.curve), response


def merged_group(
    folder: PreparationFolder,
    preparation: Preparation,
    group: Group,
    survey: Survey,
    calibration: Calibration,
) -> MergedImage:
    """Merge one group and write its files; returns the facts of this or of an earlier, equal merge."""
    photographs = [calibration.photographs[item.path] for item in preparation.of(group)]
    kept = [index for index in range(len(photographs)) if index not in survey.strangers]
    corrected = [item.exposure for item in photographs]
    parts = [_group_key(preparation, group), _settings_key(preparation), calibration.digest(), corrected]
    text = json.dumps([*parts, code_digest()])
    note = folder.stage / "merge" / f"{group.name}.json"
    digest = hashlib.sha256(text.encode()).hexdigest()[:24]
    known = optional_document(note, _Note)
    if known is not None and known.key == digest and folder.image(group).is_file():
        return known.facts
    note.unlink(missing_ok=True)
    items = [photographs[index] for index in kept]
    exposures = [(item.exposure or 1.0) / calibration.scale for item in items]
    curve = calibration.curve if items[0].kind == "ldr" else None
    # How many pixels become one before merging; the rest of the reduction follows after it.
    side = preparation.settings.working_width
    factor = max(1, max(items[0].width, items[0].height) // side) if side else 1
    loaded = [_frame(preparation, item, calibration.ceiling, curve, factor) for item in items]
    frames, matrix = [frame for frame, _ in loaded], loaded[0][1]
    del loaded
    motions = [survey.motions[index] for index in kept]
    radiance, clipped, moved = merge_group(frames, exposures, motions, calibration.noise[items[0].kind])
    del frames  # of 24 megapixels each, they are most of the memory
    if items[0].kind == "raw":
        radiance = in_rec709(radiance, clipped, calibration.balance, calibration.matrix)
    else:
        radiance = radiance @ matrix.astype(np.float32).T
    if preparation.settings.vignetting == "auto" and items[0].has_vignetting:
        gain = vignetting(items[0], radiance.shape[1], radiance.shape[0])
        radiance = radiance if gain is None else radiance * gain[..., None]
    radiance, clipped = _finished(radiance, clipped, items[0], preparation.settings.working_width)
    write_exr(folder.image(group), radiance, half=bool(radiance.max(initial=0.0) < HALF_MAX))
    _write_clipped(folder, group, clipped)
    size = max(items[0].width, items[0].height)
    facts = MergedImage(
        name=group.name,
        image=folder.image(group).relative_to(folder.root).as_posix(),
        clipped_share=round(float(clipped.mean()), 6),
        moved_share=round(float(moved.mean()), 6),
        shift_pixels=round(float(max(m.corner_shift(*items[0].upright_size) for m in motions)), 2),
        exposures=tuple(round(exposure, 9) for exposure in exposures),
        left_out=tuple(photographs[index].path for index in survey.strangers),
        width=radiance.shape[1],
        height=radiance.shape[0],
        reduction=round(size / max(radiance.shape[:2]), 4),
    )
    write_json(note, _Note(digest, facts))
    return facts


def _frame(
    preparation: Preparation, item: Photograph, ceiling: float, curve: np.ndarray | None, factor: int
) -> tuple[Frame, np.ndarray]:
    """One exposure at the size at which it is merged, and `Stored.matrix`; what is stored is not kept."""
    stored = load(preparation.file(item), item, preparation.settings)
    stored = replace(stored, ceiling=ceiling) if item.kind == "raw" else stored
    return linear_frame(stored, curve, factor), stored.matrix


def _finished(
    radiance: np.ndarray, clipped: np.ndarray, photograph: Photograph, side: int
) -> tuple[np.ndarray, np.ndarray]:
    """Radiance and clipped places upright and at the working size."""
    radiance = np.maximum(upright(radiance, photograph.orientation), 0.0)
    clipped = upright(clipped.any(axis=-1), photograph.orientation)
    if side and max(clipped.shape) > side:
        radiance = resized(radiance, side)
        clipped = resized(clipped[..., None].astype(np.float32), side)[..., 0] > 0.0
    return radiance, clipped


def _write_clipped(folder: PreparationFolder, group: Group, clipped: np.ndarray) -> None:
    path = folder.clipped_mask(group)
    if not clipped.any():
        path.unlink(missing_ok=True)
        return
    with atomic_path(path) as temporary:
        Image.fromarray(clipped.astype(np.uint8) * 255).save(temporary)


def _settings_key(preparation: Preparation) -> Any:
    names = ("working_width", "response", "align", "white_balance", "vignetting", "layer")
    return [getattr(preparation.settings, name) for name in names]


def _group_key(preparation: Preparation, group: Group) -> Any:
    entries = []
    for item in preparation.of(group):
        path = preparation.file(item)
        fact = path.stat() if path.is_file() else None
        entries.append([item.path, item.exposure, *((fact.st_size, fact.st_mtime_ns) if fact else (0, 0))])
    return [group.name, entries]


@dataclass(frozen=True)
class _Note:
    """stage/merge/NAME.json: of a merge that need not be done again."""

    key: str
    facts: MergedImage


def _forget_others(folder: PreparationFolder, groups: Sequence[Group]) -> None:
    """Delete the images of groups that are no longer used; only those that this step has written."""
    names = {group.name for group in groups}
    for note in sorted((folder.stage / "merge").glob("*.json")):
        if note.stem not in names:
            (folder.images / f"{note.stem}.exr").unlink(missing_ok=True)
            (folder.clipped / f"{note.stem}.png").unlink(missing_ok=True)
            note.unlink()


def _warn(reporter: Reporter, entries: Sequence[MergedImage]) -> None:
    clipped = [entry.name for entry in entries if (entry.clipped_share or 0.0) > MUCH_CLIPPED]
    if clipped:
        reporter.warning(
            "clipped",
            f"{len(clipped)} of {len(entries)} views are clipped even in their darkest photograph, such as"
            f" '{clipped[0]}': lamps and windows will be too dim there.",
            "Take darker exposures as well; the folder 'clipped' shows the places.",
        )
    left_out = [name for entry in entries for name in entry.left_out]
    if left_out:
        reporter.warning(
            "exposures-left-out",
            f"{len(left_out)} photographs don't show what the others of their group show, and were left out:"
            f" {', '.join(left_out[:3])}{' and others' if len(left_out) > 3 else ''}.",
            "Correct the groups.",
        )
