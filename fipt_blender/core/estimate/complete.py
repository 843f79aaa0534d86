"""Engine command `complete`: what an estimation would add to a scan, before it, for the artist to decide.

It works on the room and the views that Blender wrote for a survey, and leaves results/scan.npz
there. The run.json beside them has the settings.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from ..capture.views import load_capture
from ..device.variant import set_variant
from ..run.errors import FiptError
from ..run.messages import Reporter
from ..run.runfolder import RunFolder
from ..run.store import write_arrays


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("run", type=Path, help="folder with a survey's input and run.json")


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Add to the room in the folder what its views show and its mesh lacks."""
    folder = RunFolder(arguments.run)
    settings = folder.read()
    set_variant(settings.device)
    # Imported here because these modules need Mitsuba's variant when they are loaded.
    from .input import averaged, spread_views
    from .room_stages import CompletedScan, room_chain

    capture = load_capture(folder)
    if not capture.train:
        raise FiptError("views-none.run")
    reporter.plan([0.2, 0.8])
    views = averaged(spread_views(capture.train, settings.view_share), settings, reporter)
    scan = room_chain(folder, settings, capture, views, reporter, whole=False).run(CompletedScan).scan
    folder.scan_npz.unlink(missing_ok=True)
    if scan is not None:
        write_arrays(folder.scan_npz, scan)
    reporter.done([str(folder.scan_npz)] if scan is not None else [])
