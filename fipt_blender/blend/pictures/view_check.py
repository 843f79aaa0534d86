# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Compares renders with their photographs: PSNR in the run's renders/check.json, and error images."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...core.capture.averaging import means
from ...core.report.comparison import choose_exposure, compare, error_picture
from ...core.run.contents import CapturedView, CapturedViews
from ...core.run.documents import read_document
from ...core.run.errors import FiptError
from ...core.run.runfolder import RunFolder, write_json
from .cycles import can_denoise
from .image_files import photograph, read_pixels, save_png


@dataclass(frozen=True)
class CheckedView:
    """A view that was compared: files of render and error, agreement in dB, samples per pixel."""

    view: str
    split: str
    render: str
    error: str
    psnr: float
    psnr_linear: float
    spp: float = 0.0
    denoised: bool = True


@dataclass(frozen=True)
class Checks:
    """check.json; one exposure for all views, None before the first one."""

    exposure: float | None = None
    views: tuple[CheckedView, ...] = ()


def check_json(run: RunFolder) -> Path:
    """Path of check.json, which holds the exposure and an entry for each view that was compared."""
    return run.renders / "check.json"


def check_view(
    run: RunFolder,
    capture: CapturedViews,
    view: CapturedView,
    render: Path,
    spp: int,
    views: Sequence[str],
) -> None:
    """Compare a render with its photograph: write an error image and the view's entry of check.json.

    Args:
        run: the run folder.
        capture: capture.json.
        view: the view's entry of it.
        render: the render's EXR.
        spp: samples per pixel of the render.
        views: names of the views whose photographs set the exposure, if check.json has none yet.

    Raises:
        FiptError: ``image-missing``, ``disk-full`` or ``run-unwritable``.
    """
    checks = read_checks(run)
    image, photo = read_pixels(render), photograph(run, view, smaller=True)
    exposure = checks.exposure
    if exposure is None:
        medians = []
        for entry in capture.views:
            if entry.name in views:
                with suppress(FiptError):  # its own check reports that it is missing
                    medians.append(float(np.median(photograph(run, entry, smaller=True))))
        exposure = choose_exposure(float(np.median(medians)) if medians else 0.0)
    photo = means(photo, image.shape[1], image.shape[0])
    agreement = compare(image, photo, exposure)
    error = run.renders / "error" / f"{render.stem}.png"
    save_png(error, error_picture(image, photo, exposure))
    checked = CheckedView(
        view=view.name,
        split=view.split,
        render=render.relative_to(run.root).as_posix(),
        error=error.relative_to(run.root).as_posix(),
        psnr=min(agreement.psnr, 100.0),
        psnr_linear=min(agreement.psnr_linear, 100.0),
        spp=spp,
        denoised=can_denoise(),
    )
    others = [other for other in checks.views if other.view != view.name]
    write_json(check_json(run), Checks(exposure, (*others, checked)))


def forget_check(run: RunFolder, view: str) -> None:
    """Remove a view's entry from check.json: it is of an earlier render.

    Raises:
        FiptError: ``file-damaged``, ``disk-full`` or ``run-unwritable``.
    """
    checks = read_checks(run)
    others = tuple(other for other in checks.views if other.view != view)
    if len(others) < len(checks.views):
        write_json(check_json(run), replace(checks, views=others))


def read_checks(run: RunFolder) -> Checks:
    """check.json; empty where nothing was checked.

    Raises:
        FiptError: ``file-damaged``.
    """
    path = check_json(run)
    if not path.exists():
        return Checks()
    return read_document(path, Checks, "Delete it and render the check again.")
