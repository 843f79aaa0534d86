# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The check of the photographs against each other, run on a small capture."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.checks.view_check import ViewCheck, check_views
from fipt_blender.core.pixels.mixed_pixels import mark_pure
from fipt_blender.core.pixels.store import PixelStore, fill_pixels, open_pixels
from fipt_blender.core.run.messages import Reporter, parse_message
from fipt_blender.core.run.settings import make_settings

from .small_captures import SmallCapture, write_run


def run_check(
    root: Path,
    capture: SmallCapture,
    change_pixels: Callable[[PixelStore], None] = lambda pixels: None,
    **settings: bool,
) -> tuple[PixelStore, ViewCheck, list[dict]]:
    """Check a capture's views in a new folder; the objects are the parts.

    Args:
        change_pixels: is called on the pixels before the check.
        settings: changes of the draft preset.

    Returns:
        the pixels after the check, its result, and its messages.
    """
    run = write_run(root / "run", capture)
    pixels = open_pixels(root / "pixels", load_capture(run).train, create=True)
    fill_pixels(pixels, capture.room, lambda _: None)
    part = capture.room.triangle_object
    mark_pure(pixels, capture.room, part, lambda _: None)
    change_pixels(pixels)
    stream = io.StringIO()
    check = check_views(pixels, capture.room, part, make_settings("draft", settings), Reporter(stream))
    return pixels, check, [m for line in stream.getvalue().splitlines() if (m := parse_message(line))]
