# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `versions`: lists the estimates of a run, and uses, compares, names and deletes them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from ..core.run.version_figures import comparison
from ..core.run.versions import list_versions, rename_version, settle, total_size
from ..jobs.options import BLEND_NAME
from ..jobs.run_job import refuse_busy, remove_version, switch_version
from .output import Display, format_size

_MOST_PARTS = 20  # of a comparison


def run_versions(arguments: argparse.Namespace, display: Display) -> None:
    """Do what the arguments say, and list the versions.

    Raises:
        FiptError: the folder is no run, an engine is at work in it, or there is no such version.
    """
    run = RunFolder(arguments.run)
    run.read()  # raises where it is no run folder
    if arguments.use or arguments.name or arguments.delete:
        refuse_busy(run)
        settle(run)
    files: list[str] = []
    if arguments.use:
        files = _use(run, arguments.use, display)
    if arguments.name:
        rename_version(run, *arguments.name)
    for version in arguments.delete:
        remove_version(run, version)
    if arguments.compare:
        first, second = arguments.compare
        rows = comparison(run, first, second, _MOST_PARTS)
        display.show({"type": "done", "files": [], "data": {"comparison": rows}})
        _print_table(arguments, rows)
        return
    found = list_versions(run)
    data = {"versions": [{**asdict(version), "date": version.date} for version in found]}
    display.show({"type": "done", "files": files, "data": {**data, "size": total_size(run)}})
    table = [
        (
            ("* " if version.current else "  ") + version.id,
            version.title,
            ", ".join(filter(None, (version.made if version.name else "", version.what))),
            format_size(version.size),
        )
        for version in found
    ]
    _print_table(arguments, [*table, ("", "", "", f"{format_size(total_size(run))} in all")])


def _use(run: RunFolder, version: str, display: Display) -> list[str]:
    """Make a version the results; the run's .blend file, where there is one, gets them. Returns that file."""
    blend = run.root / BLEND_NAME
    if not blend.is_file():
        switch_version(run, version)
        return []
    import bpy

    from .. import api
    from ..blend.save import save_blend
    from ..jobs.batch_state import panel_state

    try:
        bpy.ops.wm.open_mainfile(filepath=str(blend), load_ui=False, use_scripts=False)
    except RuntimeError as error:
        text = f"{blend} can't be opened ({str(error).strip()})."
        raise FiptError("file-damaged", text, "Delete it and use the version again.") from None
    with panel_state():
        bpy.context.scene.fipt.run_folder = str(run.root)
        outcome = api.use_version(version, bpy.context.scene)
        save_blend(blend)
    Path(f"{blend}1").unlink(missing_ok=True)
    for text in outcome.warnings:
        display.show({"type": "warning", "code": "results", "text": text, "remedy": ""})
    return [str(blend)]


def _print_table(arguments: argparse.Namespace, rows: Sequence[tuple[str, ...]]) -> None:
    if arguments.json or arguments.quiet:
        return
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        print("  ".join(cells).rstrip())
