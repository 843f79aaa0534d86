# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The files of what a result was judged by (:mod:`..checks.quality`): quality.json and its pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..run.runfolder import RunFolder, write_json
from .pictures import write_png

if TYPE_CHECKING:  # the report shows the files without the renderer and torch, which take seconds to load
    from ..checks.quality import Quality

KINDS = ("photograph", "render", "projection")


def write_quality(run: RunFolder, quality: Quality) -> None:
    """Write results/quality.json and the pictures of the judged views in results/quality.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    document = quality.document()
    for index, (entry, view) in enumerate(zip(document["views"], quality.views, strict=True)):
        for kind, picture in zip(KINDS, view.pictures, strict=True):
            entry[kind] = f"{index:03d}-{kind}.png"
            write_png(run.quality / entry[kind], picture)
    write_json(run.quality_json, document)
