# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Engine commands: `python -m fipt_blender.core COMMAND ...`; messages on stdout, the rest to stderr.

Each command lives in the room it belongs to; this file only picks it. Rooms are imported when their
command runs, so that `check` can tell that a heavy package is missing.
"""

from __future__ import annotations

import argparse
import errno
import importlib
import os
import sys
import traceback
from contextlib import nullcontext

from .job.errors import FiptError
from .job.lock import hold
from .job.messages import Reporter, claim_stdout, says_out_of_memory
from .job.parent import end_with_parent
from .job.runfolder import RunFolder

# name -> (module, help). Each module has add_arguments(parser) and run(arguments, reporter).
COMMANDS = {
    "check": (".device.check", "say which device, LLVM and package versions the engine has"),
    "ingest": (".capture.ingest", "read a capture into a run folder"),
    "survey": (".scene.survey", "say what each view sees of the room, and which parts there are"),
    "estimate": (".job.estimate", "estimate materials and lights of the room in a run folder"),
    "textures": (".textures.bake", "bake the estimated fields onto the UVs of atlas.npz"),
    "report": (".report.page", "write the HTML report of a run folder"),
}


def main(argv: list[str] | None = None) -> int:
    """Run one engine command.

    Returns:
        0; 1 after an error message; ENOSPC where a full disk did not take that message.
    """
    argv = sys.argv[1:] if argv is None else argv
    # Torch's threads spin while they wait: beside a busy Blender that makes training ten times slower.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    end_with_parent()
    reporter = Reporter(claim_stdout())
    name = argv[0] if argv else "--help"
    if name not in COMMANDS:
        texts = "\n".join(f"  {key:10s} {text}" for key, (_, text) in COMMANDS.items())
        print(f"usage: python -m fipt_blender.core COMMAND ...\n{texts}", file=sys.stderr)
        return 0 if name in ("-h", "--help") else 2
    status = _run(argv, reporter)
    return errno.ENOSPC if reporter.lost else status


def _run(argv: list[str], reporter: Reporter) -> int:
    """One command, while no other engine may work in its run folder; any failure becomes a message."""
    name = argv[0]
    module_name, text = COMMANDS[name]
    try:
        module = importlib.import_module(module_name, __package__)
        parser = argparse.ArgumentParser(prog=f"fipt_blender.core {name}", description=text)
        module.add_arguments(parser)
        arguments = parser.parse_args(argv[1:])
        with hold(RunFolder(arguments.run), argv) if hasattr(arguments, "run") else nullcontext():
            module.run(arguments, reporter)
    except FiptError as error:
        traceback.print_exc()
        reporter.error(error.code, error.text, error.remedy)
        return 1
    except ImportError as error:
        traceback.print_exc()
        reporter.error(
            "package-missing",
            f"The engine's Python lacks a package ({error}).",
            "Create the engine's environment again.",
        )
        return 1
    except Exception as error:  # the last net: the window must learn of any failure
        traceback.print_exc()
        if isinstance(error, MemoryError) or says_out_of_memory(str(error)):
            reporter.error(
                "out-of-memory",
                "The engine ran out of memory.",
                "Use a smaller preset, fewer or smaller views, or close other programs; then resume.",
            )
            return 1
        reporter.error(
            "engine-failed",
            f"The engine failed: {type(error).__name__}: {error}",
            "The log in the run folder tells more; please report it.",
        )
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
