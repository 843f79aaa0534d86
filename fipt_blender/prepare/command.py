"""Engine command `prepare`: makes a capture from a folder of photographs, step by step.

Each step leaves stage/STEP.json, which says that it is done. A step is a module with
`key(folder, preparation)`, a JSON value of what its result depends on besides the steps before it, and
`run(folder, preparation, reporter)`, which returns its `facts` for the report, if any.
"""

from __future__ import annotations

import argparse
import importlib
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from ..core.run.contents import Problem
from ..core.run.documents import optional_document
from ..core.run.errors import FiptError
from ..core.run.kinds import as_json
from ..core.run.messages import Reporter
from ..core.run.method import digest, method_digest
from ..core.run.runfolder import explained_write_errors, write_json
from .facts import FinishedStep
from .preparation import (
    Preparation,
    PreparationFolder,
    make_prepare_settings,
    read_preparation,
    refuse_foreign,
    write_preparation,
)

STEPS = {  # module in this room, text for the progress bar, expected time relative to the other steps
    "read": (".reading", "Reading photographs and finding brackets", 1.0),
    "merge": (".merge_step", "Merging exposures", 10.0),
    "solve": (".solve_step", "Solving cameras", 20.0),
    "vignetting": (".vignetting", "Correcting vignetting", 1.0),
    "scale": (".scale", "Finding scale and up axis", 1.0),
    "report": (".report", "Writing the report", 1.0),
}


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
    """
    names = choose_steps(arguments.steps)
    folder, photographs = PreparationFolder(arguments.run), arguments.photographs.absolute()
    wrong = next((text for text in arguments.set if "=" not in text), None)
    if wrong is not None:
        raise FiptError("option-invalid.run", wrong=wrong)
    parts = [text.partition("=") for text in arguments.set]
    changes = {name.strip(): value.strip() for name, _, value in parts}
    if not photographs.is_dir():
        raise FiptError("photographs-missing.run", photographs=photographs)
    refuse_foreign(folder, photographs)
    is_new = not folder.prepare_json.exists()
    preparation = Preparation(photographs, (), ()) if is_new else read_preparation(folder)
    if preparation.source != photographs:
        raise FiptError("capture-foreign.run", root=folder.root, source=preparation.source)
    settings = make_prepare_settings({**asdict(preparation.settings), **changes})
    with explained_write_errors(folder.root):
        folder.stage.mkdir(parents=True, exist_ok=True)
    if "read" in names and settings.grouping != preparation.settings.grouping:
        preparation = replace(preparation, groups=())
    write_preparation(folder, replace(preparation, settings=settings))
    files = run_steps(folder, names, reporter)
    reporter.done([str(file) for file in files], {"capture": str(folder.root), "steps": names})


def choose_steps(names: str) -> list[str]:
    """The steps of a list separated by commas, in their order; all for an empty text."""
    wanted = [name.strip() for name in names.split(",") if name.strip()] or list(STEPS)
    unknown = [name for name in wanted if name not in STEPS]
    if unknown:
        raise FiptError("option-invalid.choose-steps", unknown=unknown[0], steps=", ".join(STEPS))
    return [name for name in STEPS if name in wanted]


def run_steps(folder: PreparationFolder, names: Sequence[str], reporter: Reporter) -> list[Path]:
    """Run steps in their order; those are kept whose key is that of their last run.

    Where a step fails, the report is written on what was done before.

    Returns:
        The files with the steps' facts.
    """
    reporter.plan([STEPS[name][2] for name in names])
    for name in names:
        try:
            _run_step(folder, name, reporter)
        except FiptError as error:
            if "report" in names and name != "report":
                with suppress(FiptError, OSError):
                    folder.facts("report").unlink(missing_ok=True)  # the next start writes the page again
                    _module("report").write_report(folder, read_preparation(folder), stopped=error)
            raise
    return [folder.facts(name) for name in names]


def _run_step(folder: PreparationFolder, name: str, reporter: Reporter) -> None:
    """Run one step, or repeat its warnings if it is finished."""
    module, preparation, path = _module(name), read_preparation(folder), folder.facts(name)
    key = _step_key(name, folder, module.key(folder, preparation))
    done = optional_document(path, FinishedStep)
    if done is not None and done.key == key:
        for message in done.messages:
            reporter.warn(message)
        reporter.skip()
        return
    reporter.stage(name, STEPS[name][1])
    path.unlink(missing_ok=True)
    started, told = time.monotonic(), len(reporter.warnings)
    facts = module.run(folder, preparation, reporter)
    seconds = round(time.monotonic() - started, 2)
    messages = tuple(Problem(**warning) for warning in reporter.warnings[told:])
    write_json(path, as_json(FinishedStep(key, messages, seconds)) | (as_json(facts) if facts else {}))


def _module(name: str) -> Any:
    return importlib.import_module(STEPS[name][0], __package__)


def _step_key(name: str, folder: PreparationFolder, value: Any) -> str:
    """A key of a step's own value, the steps before it and the room's code.

    `read` alone is kept by an update of the code, because the user may have corrected its groups.
    """
    # Groups and exposures, which the user may change after reading, are part of the other steps' own keys.
    earlier = [other for other in list(STEPS)[: list(STEPS).index(name)] if other != "read"]
    done = [optional_document(folder.facts(other), FinishedStep) for other in earlier]
    before = ["" if step is None else step.key for step in done]
    return digest(name, value, before, "" if name == "read" else code_digest())


def code_digest() -> str:
    """A digest of the room's source code, on which the results depend."""
    return method_digest(Path(__file__).parent, (".",))
