# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine command `complete`: what an estimation would add to a scan, before it, for the artist to decide.

It works on the room and the views that Blender wrote for a survey, and leaves closing.npz and panes.npz
there.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from ..capture.views import load_capture
from ..device.variant import set_variant
from ..run.errors import FiptError
from ..run.messages import Reporter
from ..run.runfolder import RunFolder


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("run", type=Path, help="run folder with run.json, and with a survey's input")


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Add to the room in RUN/survey what its views show and its mesh lacks.

    Raises:
        FiptError: ``views-none``, where an input is missing or can't be used, ``disk-full`` or
            ``run-unwritable``.
    """
    settings = RunFolder(arguments.run).read()
    folder = RunFolder(RunFolder(arguments.run).survey)
    set_variant(settings.device)
    # Imported here because these modules need Mitsuba's variant when they are loaded.
    from .input import completed_room

    capture = load_capture(folder)
    if not capture.train:
        raise FiptError("views-none.run")
    reporter.plan([0.2, 0.8])
    completed_room(folder, settings, capture, reporter)
    reporter.done([str(path) for path in (folder.closing_npz, folder.panes_npz) if path.exists()])
