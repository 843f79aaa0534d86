# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Compares renders with their photographs: PSNR in the run's renders/check.json, and error images."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ...core.capture.averaging import means
from ...core.report.comparison import choose_exposure, compare, error_picture
from ...core.run.documents import read_json
from ...core.run.errors import FiptError
from ...core.run.runfolder import RunFolder, write_json
from ...core.run.shapes import CHECK
from .cycles import can_denoise
from .image_files import photograph, read_pixels, save_png


def check_json(run: RunFolder) -> Path:
    """Path of check.json, which holds the exposure and an entry for each view that was compared."""
    return run.renders / "check.json"


def check_view(
    run: RunFolder,
    capture: dict[str, Any],
    view: dict[str, Any],
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
    if "exposure" not in checks:
        medians = []
        for entry in capture["views"]:
            if entry["name"] in views:
                with suppress(FiptError):  # its own check reports that it is missing
                    medians.append(float(np.median(photograph(run, entry, smaller=True))))
        checks["exposure"] = choose_exposure(float(np.median(medians)) if medians else 0.0)
    photo = means(photo, image.shape[1], image.shape[0])
    agreement = compare(image, photo, checks["exposure"])
    error = run.renders / "error" / f"{render.stem}.png"
    save_png(error, error_picture(image, photo, checks["exposure"]))
    entry = {
        "view": view["name"],
        "split": view["split"],
        "render": render.relative_to(run.root).as_posix(),
        "error": error.relative_to(run.root).as_posix(),
        "spp": spp,
        "denoised": can_denoise(),
        **{name: min(value, 100.0) for name, value in asdict(agreement).items()},
    }
    others = [other for other in checks.get("views", []) if other["view"] != view["name"]]
    write_json(check_json(run), {**checks, "views": [*others, entry]})


def forget_check(run: RunFolder, view: str) -> None:
    """Remove a view's entry from check.json: it is of an earlier render.

    Raises:
        FiptError: ``file-damaged``, ``disk-full`` or ``run-unwritable``.
    """
    checks = read_checks(run)
    entries = checks.get("views", [])
    others = [entry for entry in entries if entry["view"] != view]
    if len(others) < len(entries):
        write_json(check_json(run), {**checks, "views": others})


def read_checks(run: RunFolder) -> dict[str, Any]:
    """check.json; {} where nothing was checked.

    Raises:
        FiptError: ``file-damaged``.
    """
    path = check_json(run)
    return read_json(path, CHECK, "Delete it and render the check again.") if path.exists() else {}
