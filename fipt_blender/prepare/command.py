# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine command `prepare`: makes a capture from a folder of photographs, step by step."""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
from pathlib import Path

from ..core.run.errors import FiptError
from ..core.run.messages import Reporter
from ..core.run.runfolder import explained_write_errors
from .preparation import (
    Preparation,
    PreparationFolder,
    make_prepare_settings,
    read_preparation,
    refuse_foreign,
    write_preparation,
)
from .steps import STEPS, choose_steps, run_steps


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("photographs", type=Path, help="folder of the photographs")
    parser.add_argument("run", type=Path, metavar="capture", help="folder of the capture; created if missing")
    parser.add_argument(
        "--steps", default="", help=f"only some steps, separated by commas: {', '.join(STEPS)}"
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="change one setting of prepare.json"
    )


def run(arguments: argparse.Namespace, reporter: Reporter) -> None:
    """Run the chosen steps; a stopped command goes on where it was when it is started again.

    The folder gets a prepare.json, or settings of the one that is there are changed.

    Raises:
        FiptError: ``photographs-missing``, ``capture-foreign`` if the folder holds something else,
            ``option-invalid``, and those of `read_preparation` and of the steps.
    """
    names = choose_steps(arguments.steps)
    folder, photographs = PreparationFolder(arguments.run), arguments.photographs.absolute()
    wrong = next((text for text in arguments.set if "=" not in text), None)
    if wrong is not None:
        raise FiptError("option-invalid", f"'--set {wrong}' has no '='.", "Write it as NAME=VALUE.")
    parts = [text.partition("=") for text in arguments.set]
    changes = {name.strip(): value.strip() for name, _, value in parts}
    if not photographs.is_dir():
        raise FiptError(
            "photographs-missing", f"The folder {photographs} does not exist.", "Choose another folder."
        )
    refuse_foreign(folder, photographs)
    is_new = not folder.prepare_json.exists()
    preparation = Preparation(photographs, (), ()) if is_new else read_preparation(folder)
    if preparation.source != photographs:
        raise FiptError(
            "capture-foreign",
            f"{folder.root} was prepared from other photographs, in {preparation.source}.",
            "Choose another folder for the capture, or those photographs.",
        )
    settings = make_prepare_settings({**asdict(preparation.settings), **changes})
    with explained_write_errors(folder.root):
        folder.stage.mkdir(parents=True, exist_ok=True)
    write_preparation(folder, replace(preparation, settings=settings))
    files = run_steps(folder, names, reporter)
    reporter.done([str(file) for file in files], {"capture": str(folder.root), "steps": names})
