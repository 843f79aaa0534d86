# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Step `solve`: cameras of the merged images, by pycolmap or from an existing solve, as sparse/0.

stage/solve holds the copies in which features are found, the database that a stopped solve goes on with,
and the model in the frame of the solve.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..core.capture.formats.registry import read_rig
from ..core.capture.images import JPEG_QUALITY, read_radiance, read_size
from ..core.capture.options import CaptureOptions
from ..core.run.errors import FiptError
from ..core.run.messages import Reporter, within
from ..core.run.runfolder import atomic_path, explained_write_errors
from . import lens
from .facts import LeftOut, Registered, SolveFacts
from .models import WantedView, model_from_rig, write_model
from .preparation import Group, Preparation, PreparationFolder
from .solving import Solve, SolveView, camera_groups, copy_name, registered_names, solve, tone_mapped

_COPIES_SHARE = 0.1  # of the step's time
POOR_ERROR = 1.5  # pixels of mean reprojection error; a good solve has less than one
SMALL_SIDE = 1000  # pixels; in smaller images, most photographs of a room have too few features
FEW_VIEWS = 3  # of one camera; with less, its focal length is hardly determined
_NAMES_IN_TEXT = 5  # of a warning


def key(folder: PreparationFolder, preparation: Preparation) -> Any:
    """What the cameras depend on besides the merged images."""
    settings = preparation.settings
    lenses = [
        [group.name, *_lens_facts(preparation, group)] if not settings.cameras else [group.name]
        for group in preparation.used_groups
    ]
    return {"cameras": settings.cameras, "seed": settings.seed, "lenses": lenses}


def run(folder: PreparationFolder, preparation: Preparation, reporter: Reporter) -> SolveFacts:
    """Solve the cameras, or take those of an existing solve; returns facts for the report.

    Raises:
        FiptError: ``image-missing`` without a merged image, ``solve-few``, ``solve-failed``,
            ``solve-foreign``, ``solve-size``, those of the capture readers, ``disk-full`` or
            ``run-unwritable``.
    """
    groups = preparation.used_groups
    missing = [group.name for group in groups if not folder.image(group).is_file()]
    if missing:
        raise FiptError(
            "image-missing",
            f"{_listed(missing)} of the capture's images are not merged yet.",
            "Run the step merge before the step solve.",
        )
    changed = _write_copies(folder, groups, reporter)
    if preparation.settings.cameras:
        solved = _existing(folder, preparation, reporter)
    else:
        if changed:  # features and matches are of other images
            with explained_write_errors(folder.stage):
                for file in folder.solve.glob("database.db*"):
                    file.unlink()
        solved = _solve(folder, preparation, reporter)
    for image in solved.model.images.values():
        image.name += ".exr"
    write_model(folder.model, solved.model)
    write_model(folder.sparse, solved.model)
    facts = _facts(solved)
    _warn(solved, facts, len(groups), reporter)
    return facts


def _solve(folder: PreparationFolder, preparation: Preparation, reporter: Reporter) -> Solve:
    views = []
    for group in preparation.used_groups:
        width, height = read_size(folder.image(group))
        start = lens.start(preparation.of(group)[0], width, height)
        camera = "|".join(str(value) for value in _lens_facts(preparation, group))
        known = (None,) if start is None else (start.focal, start.distortion)
        views.append(SolveView(group.name, width, height, camera, *known))
    progress = within(reporter.progress, _COPIES_SHARE, 1.0)
    solved = solve(folder.solve, views, preparation.settings.seed, progress)
    for indices in camera_groups(views):
        if len(indices) < FEW_VIEWS < len(views):
            names = _listed([views[index].name for index in indices])
            reporter.warning(
                "camera-few-views",
                f"{names}: taken with a camera, focal length or format that no other photograph has.",
                "Its focal length is less certain. Leave such photographs out, or take more of them.",
            )
    return solved


def _lens_facts(preparation: Preparation, group: Group) -> list[Any]:
    photograph = preparation.of(group)[0]
    return [getattr(photograph, name) for name in ("make", "model", "lens", "focal_length", "focal_35mm")]


def _write_copies(folder: PreparationFolder, groups: list[Group], reporter: Reporter) -> bool:
    """Write the copies of all views; whether any differs from the one that was there."""
    changed = False
    for index, group in enumerate(groups):
        buffer = io.BytesIO()
        picture = tone_mapped(read_radiance(folder.image(group)))
        Image.fromarray(picture).save(buffer, "JPEG", quality=JPEG_QUALITY)
        copy = folder.solve / "copies" / copy_name(group.name)
        if not copy.is_file() or copy.read_bytes() != buffer.getvalue():
            changed = True
            with atomic_path(copy) as temporary:
                temporary.write_bytes(buffer.getvalue())
        reporter.progress(_COPIES_SHARE * (index + 1) / len(groups))
    return changed


def _existing(folder: PreparationFolder, preparation: Preparation, reporter: Reporter) -> Solve:
    """The cameras of an existing solve, in any format that the capture readers know."""
    rig = read_rig(Path(preparation.settings.cameras).absolute(), "auto", CaptureOptions())
    for note in rig.notes:
        reporter.warning(note.code, note.text, note.remedy)
    wanted = []
    for group in preparation.used_groups:
        width, height = read_size(folder.image(group))
        wanted.append(WantedView(group.name, width, height, (group.name, *group.photographs)))
    model = model_from_rig(rig, wanted)
    placed = registered_names(model)
    left_out = tuple(
        LeftOut(group.name, "the existing solve does not have it", "Solve the cameras again with it.")
        for group in preparation.used_groups
        if group.name not in placed
    )
    return Solve(model, left_out, (len(placed),))


def _facts(solved: Solve) -> SolveFacts:
    model = solved.model
    registered = []
    for index in sorted(model.reg_image_ids(), key=lambda index: model.images[index].name):
        image = model.images[index]
        errors = [model.points3D[item.point3D_id].error for item in image.points2D if item.has_point3D()]
        error = round(float(np.mean(errors)), 3) if errors else None
        registered.append(Registered(image.name.removesuffix(".exr"), len(errors), error))
    error = round(model.compute_mean_reprojection_error(), 3) if model.num_points3D() else None
    return SolveFacts(tuple(registered), solved.left_out, solved.sizes, error)


def _warn(solved: Solve, facts: SolveFacts, count: int, reporter: Reporter) -> None:
    if len(solved.sizes) > 1:
        reporter.warning(
            "solve-split",
            f"The photographs form {len(solved.sizes)} sets that are not connected "
            f"({', '.join(str(size) for size in solved.sizes)} photographs); only the largest is used.",
            "Of two rooms, prepare each from its own folder. In one room, take photographs that lead from "
            "one set to the other.",
        )
    if solved.left_out:
        names = _listed([item.name for item in solved.left_out])
        side = max(max(camera.width, camera.height) for camera in solved.model.cameras.values())
        remedy = solved.left_out[0].remedy
        if side < SMALL_SIDE:
            remedy = f"The images have {side} pixels, which show few features: set a larger working width."
        reporter.warning(
            "solve-left-out",
            f"{len(solved.left_out)} of {count} photographs have no camera and are left out: {names}. "
            f"{solved.left_out[0].name}: {solved.left_out[0].reason}.",
            f"{remedy} The report lists the reason for each.",
        )
    error = facts.reprojection_error
    if error is not None and error > POOR_ERROR:
        reporter.warning(
            "solve-inaccurate",
            f"The mean reprojection error is {error:.2f} pixels; a good solve has less than 1.",
            "Leave blurred photographs out, and use one focal length and focus for all of them.",
        )


def _listed(names: list[str]) -> str:
    text = ", ".join(names[:_NAMES_IN_TEXT])
    return text if len(names) <= _NAMES_IN_TEXT else f"{text} and {len(names) - _NAMES_IN_TEXT} more"
