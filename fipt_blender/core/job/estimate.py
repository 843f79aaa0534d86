# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine command `estimate`: the three stages of the paper on a run folder, resumable stage by stage.

Order (paper Sec. 4): pixels, stage 1 (bake), then stage 2 (train, emitters), and `rounds` times stage 3
(refine) and stage 2 again.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from ..device.variant import set_variant
from .cluster import workers_at
from .messages import Reporter
from .runfolder import RunFolder


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("run", type=Path, help="run folder with capture.json and room.npz")
    parser.add_argument("--cluster", metavar="ADDRESS", help="Dask scheduler whose workers share the views")


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Estimate materials and lights.

    Raises:
        FiptError: where the run folder lacks something, the capture can't be used or the cluster fails.
    """
    folder = RunFolder(arguments.run)
    settings = folder.read()
    set_variant(settings.device)
    # The stages import Mitsuba names at load, which needs the variant.
    from ..material.brdf import set_masking
    from .stages import Estimation

    set_masking(settings.masking)
    with workers_at(arguments.cluster) as workers:
        estimation = Estimation(folder, settings, reporter, workers)
        estimation.run()
    reporter.done([str(path) for path in estimation.files()], estimation.summary())
