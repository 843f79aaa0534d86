"""Step `merge`: images/NAME.exr of all groups, on one scale; one group at a time, in bands of rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from PIL import Image

from ..core.capture.averaging import means
from ..core.capture.images import HALF_MAX, write_exr
from ..core.run.documents import optional_document
from ..core.run.errors import FiptError
from ..core.run.made import file_state
from ..core.run.messages import Reporter
from ..core.run.method import digest
from ..core.run.runfolder import atomic_path, write_json
from .brackets import listed
from .calibration import Calibration, Survey, calibrate, camera_of, survey_group
from .command import code_digest
from .facts import MergedImage, MergeFacts, ResponseFacts
from .frames import Frame, linear_frame, load, upright
from .lens import light_share, vignetting
from .merging import in_rec709, merge_group
from .preparation import Group, Photograph, Preparation, PreparationFolder

MOST_SAMPLES = 400_000  # of all pairs of exposures, for the response
MUCH_CLIPPED = 2e-4  # share of a view's pixels


@dataclass(frozen=True)
class _Note:
    """stage/merge/NAME.json: of a merge that need not be done again."""

    key: str
    facts: MergedImage


def key(folder: PreparationFolder, preparation: Preparation) -> Any:
    """The groups, their files and exposures, and the settings of merging."""
    return [_group_key(preparation, group) for group in preparation.used_groups]


def run(folder: PreparationFolder, preparation: Preparation, reporter: Reporter) -> MergeFacts:
    """Merge all used groups."""
    groups = preparation.used_groups
    _check(preparation, groups)
    surveys: list[Survey] = []
    for index, group in enumerate(groups):
        surveys.append(survey_group(preparation, group, MOST_SAMPLES // len(groups)))
        reporter.progress(0.5 * (index + 1) / len(groups))
    calibration, response = calibrate(preparation, surveys, reporter)
    _forget_others(folder, groups)
    entries = []
    for index, (group, survey) in enumerate(zip(groups, surveys, strict=True)):
        entries.append(merged_group(folder, preparation, group, survey, calibration))
        reporter.progress(0.5 + 0.5 * (index + 1) / len(groups))
    _warn(reporter, entries)
    if response is None:
        return MergeFacts(tuple(entries), calibration.scale)
    middle = response.uncertainty[16:240]  # the ends are clipped or noise
    facts = ResponseFacts(response.curve.T.tolist(), round(float(np.median(middle)), 5))
    return MergeFacts(tuple(entries), calibration.scale, facts)


def _check(preparation: Preparation, groups: Sequence[Group]) -> None:
    if not groups:
        raise FiptError("no-photographs.check")
    for group in groups:
        items = preparation.of(group)
        if len(items) > 1 and any(item.exposure is None for item in items):
            raise FiptError("exposure-unknown.check", name=group.name)
        if len({(item.kind, item.upright_size, item.orientation) for item in items}) > 1:
            raise FiptError("bracket-mixed", name=group.name)


def merged_group(
    folder: PreparationFolder,
    preparation: Preparation,
    group: Group,
    survey: Survey,
    calibration: Calibration,
) -> MergedImage:
    """Merge one group and write its files; returns the facts of this or of an earlier, equal merge."""
    settings = preparation.settings
    photographs = [calibration.photographs[item.path] for item in preparation.of(group)]
    corrected = [item.exposure for item in photographs]
    note = folder.stage / "merge" / f"{group.name}.json"
    current = digest(_group_key(preparation, group), calibration.numbers, corrected, code_digest())
    known = optional_document(note, _Note)
    if known is not None and known.key == current and folder.image(group).is_file():
        return known.facts
    note.unlink(missing_ok=True)
    kept = [index for index in range(len(photographs)) if index not in survey.strangers]
    items, motions = [photographs[index] for index in kept], [survey.motions[index] for index in kept]
    first, exposures = items[0], [(item.exposure or 1.0) / calibration.scale for item in items]
    # How many pixels become one before merging; the rest of the reduction follows after it.
    side = settings.working_width
    factor = max(1, max(first.width, first.height) // side) if side else 1
    loaded = [_frame(preparation, item, calibration, factor) for item in items]
    frames, matrix = [frame for frame, _ in loaded], loaded[0][1]
    del loaded
    radiance, clipped, moved = merge_group(frames, exposures, motions, calibration.noise[first.kind])
    del frames  # of 24 megapixels each, they are most of the memory
    if first.kind == "raw":
        radiance = in_rec709(radiance, clipped, *calibration.colors[camera_of(first)])
    else:
        radiance = radiance @ matrix.astype(np.float32).T
    falloff = vignetting(first) if settings.vignetting == "auto" and first.has_vignetting else None
    if falloff is not None:
        radiance /= light_share(falloff, radiance.shape[1], radiance.shape[0])[..., None]
    radiance = np.maximum(upright(radiance, first.orientation), 0.0)
    clipped = upright(clipped.any(axis=-1), first.orientation)
    if side and max(clipped.shape) > side:
        height, width = (max(1, round(size * side / max(clipped.shape))) for size in clipped.shape)
        radiance = means(radiance, width, height)
        clipped = means(clipped[..., None].astype(np.float32), width, height)[..., 0] > 0.0
    write_exr(folder.image(group), radiance, half=bool(radiance.max(initial=0.0) < HALF_MAX))
    if clipped.any():
        with atomic_path(folder.clipped_mask(group)) as temporary:
            Image.fromarray(clipped.astype(np.uint8) * 255).save(temporary)
    else:
        folder.clipped_mask(group).unlink(missing_ok=True)
    facts = MergedImage(
        group.name,
        round(float(clipped.mean()), 6),
        round(float(moved.mean()), 6),
        round(max(motion.corner_shift(*first.upright_size) for motion in motions), 2),
        tuple(photographs[index].path for index in survey.strangers),
    )
    write_json(note, _Note(current, facts))
    return facts


def _frame(
    preparation: Preparation, item: Photograph, calibration: Calibration, factor: int
) -> tuple[Frame, np.ndarray]:
    """One exposure at the size at which it is merged, and `Stored.matrix`; what is stored is not kept."""
    stored = load(preparation.file(item), item, preparation.settings)
    stored = replace(stored, ceiling=calibration.ceiling) if item.kind == "raw" else stored
    return linear_frame(stored, calibration.curve if item.kind == "ldr" else None, factor), stored.matrix


def _group_key(preparation: Preparation, group: Group) -> Any:
    """A group, its files and exposures, and the settings of merging."""
    entries: list[Any] = []
    for item in preparation.of(group):
        entries.append([item.path, item.exposure, file_state(preparation.file(item))])
    names = ("working_width", "response", "align", "white_balance", "vignetting", "layer")
    return [group.name, entries, [getattr(preparation.settings, name) for name in names]]


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
            "clipped", number_of_clipped=len(clipped), number_of_entries=len(entries), clipped=clipped[0]
        )
    left_out = [name for entry in entries for name in entry.left_out]
    if left_out:
        reporter.warning("exposures-left-out", left_out=listed(left_out))
