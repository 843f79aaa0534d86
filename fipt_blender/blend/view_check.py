# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders judged by their photographs: numbers and false colours, in the run's renders/check.json."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ..core.job.runfolder import RunFolder, read_json, write_json
from ..core.report.comparison import choose_exposure, compare, error_picture, resize_to
from .pictures import photograph, save_png
from .renders import can_denoise, read_pixels

EQUAL = 100.0  # dB that stand for images without any difference


def check_json(run: RunFolder) -> Path:
    """The exposure, and for each view: split, render, error, psnr, psnr_linear, spp, denoised."""
    return run.renders / "check.json"


def check_view(
    run: RunFolder,
    capture: dict[str, Any],
    view: dict[str, Any],
    render: Path,
    spp: int,
    views: Sequence[str],
) -> None:
    """Compare a render with its photograph; writes an error picture and the view's line of check.json.

    Args:
        run: the run folder.
        capture: capture.json.
        view: the view's entry of it.
        render: the EXR.
        spp: samples a pixel that it was rendered with.
        views: names of the views from whose photographs the exposure is chosen, where none is chosen yet.

    Raises:
        FiptError: ``image-missing``, ``disk-full`` or ``run-unwritable``.
    """
    known = read_checks(run)
    if "exposure" not in known:
        medians = [
            float(np.median(photograph(run, each))) for each in capture["views"] if each["name"] in views
        ]
        known["exposure"] = choose_exposure(float(np.median(medians)) if medians else 0.0)
    image, photo = read_pixels(render), photograph(run, view)
    photo = resize_to(photo, image.shape[1], image.shape[0])
    agreement = compare(image, photo, known["exposure"])
    error = run.renders / "error" / f"{render.stem}.png"
    save_png(error, error_picture(image, photo, known["exposure"]))
    line = {
        "view": view["name"],
        "split": view["split"],
        "render": render.relative_to(run.root).as_posix(),
        "error": error.relative_to(run.root).as_posix(),
        "spp": spp,
        "denoised": can_denoise(),
        **{name: min(value, EQUAL) for name, value in asdict(agreement).items()},
    }
    others = [each for each in known.get("views", []) if each["view"] != view["name"]]
    write_json(check_json(run), {**known, "views": [*others, line]})


def read_checks(run: RunFolder) -> dict[str, Any]:
    """check.json, or {} where nothing was checked.

    Raises:
        FiptError: ``file-damaged``.
    """
    path = check_json(run)
    return read_json(path) if path.exists() else {}
