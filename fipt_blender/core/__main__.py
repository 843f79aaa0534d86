"""Engine commands: `python -m fipt_blender.core COMMAND ...`. Messages go to stdout, all else to stderr.

Each command is implemented in its own room and imported when it runs, so that `check` can report a missing
package.
"""

from __future__ import annotations

import argparse
import errno
import importlib
import os
import sys
import traceback
from contextlib import nullcontext

from .run.errors import FiptError, problem
from .run.lock import hold
from .run.messages import Reporter, claim_stdout, says_out_of_memory
from .run.process_identity import end_with_parent
from .run.runfolder import RunFolder, full_disk

# Name: (module, help). Each module has add_arguments(parser) and run(arguments, reporter).
COMMANDS = {
    "check": (".device.check", "print the device, LLVM and package versions of the engine"),
    "prepare": ("..prepare.command", "make a capture from a folder of photographs"),
    "ingest": (".capture.ingest", "read a capture into a run folder"),
    "survey": (".checks.survey", "find out what each view sees of the room, and which parts there are"),
    "complete": (".estimate.complete", "add to a scan what photographs show that it lacks"),
    "align": (".checks.align", "move the cameras onto the mesh by the solve's points"),
    "estimate": (".estimate.command", "estimate materials and lights of the room of a run folder"),
    "textures": (".textures.bake", "bake the estimated fields onto the UVs of atlas.npz"),
    "report": (".report.page", "write the HTML report of a run folder"),
}


def main(argv: list[str] | None = None) -> int:
    """Run one engine command.

    Returns:
        The exit status: 0; 1 after an error message; 2 for wrong usage; ENOSPC if the disk was too full for
        the error message.
    """
    argv = sys.argv[1:] if argv is None else argv
    # Torch's threads otherwise spin while they wait, which makes training ten times slower beside a busy
    # Blender.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    end_with_parent()
    reporter = Reporter(claim_stdout())
    name = argv[0] if argv else "--help"
    if name not in COMMANDS:
        texts = "\n".join(f"  {key:10s} {text}" for key, (_, text) in COMMANDS.items())
        print(f"usage: python -m fipt_blender.core COMMAND ...\n{texts}", file=sys.stderr)
        return 0 if name in ("-h", "--help") else 2
    status = run_command(argv, reporter)
    return errno.ENOSPC if reporter.lost else status


def run_command(argv: list[str], reporter: Reporter) -> int:
    """Run one command, which locks its run folder for other engines; any failure becomes a message."""
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
        reporter.error(error)
        return 1
    except ImportError as error:
        traceback.print_exc()
        reporter.error(problem("package-missing.import", error=error))
        return 1
    except Exception as error:  # every failure must reach the user
        traceback.print_exc()
        if isinstance(error, MemoryError) or says_out_of_memory(str(error)):
            reporter.error(problem("out-of-memory"))
            return 1
        if full := full_disk(error):
            reporter.error(full)
            return 1
        reporter.error(problem("engine-failed.unexpected", kind=type(error).__name__, error=error))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
