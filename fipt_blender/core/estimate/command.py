"""Engine command `estimate`: the method of the paper on a run folder, resumable stage by stage."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from ..device.cluster import unprotected, workers_at
from ..device.variant import set_variant
from ..run.errors import Problem
from ..run.messages import Reporter
from ..run.runfolder import RunFolder, explained_write_errors


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("run", type=Path, help="run folder with capture.json and room.npz")
    parser.add_argument(
        "--cluster", metavar="ADDRESS", help="Dask scheduler whose workers share the work on the views"
    )
    parser.add_argument("--anew", action="store_true", help="forget the stages of an earlier run")


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Estimate materials and lights."""
    folder = RunFolder(arguments.run)
    settings = folder.read()
    if arguments.anew:
        with explained_write_errors(folder.stage):
            shutil.rmtree(folder.stage, ignore_errors=True)
            folder.stage.mkdir()
    set_variant(settings.device)
    # Imported here because these modules need Mitsuba's variant when they are loaded.
    from ..optics.brdf import set_masking
    from .estimation import estimate_room
    from .input import prepare_input
    from .results import result_files

    set_masking(settings.masking)
    if (danger := unprotected(arguments.cluster)) is not None:
        reporter.warn(Problem(*danger))
    with workers_at(arguments.cluster) as workers:
        statistics = estimate_room(prepare_input(folder, settings, reporter), reporter, workers)
    reporter.done([str(path) for path in result_files(folder)], statistics)
