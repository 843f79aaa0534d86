#!/usr/bin/env python3
"""The GUI test's command: builds and installs the extension, opens a window, tells the story (README.md)."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.path.insert(0, str(ROOT))

import dev  # noqa: E402

SIZE = (1600, 900)  # of the screen and the window
TOLD = 42  # of play.py


def main(argv: list[str]) -> int:
    """Run the test, or some of its chapters; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--blender", default="blender", help="Blender's executable")
    parser.add_argument("--shots", type=Path, required=True, help="folder of the pictures")
    parser.add_argument(
        "--engine", type=Path, required=True, metavar="PYTHON", help="interpreter with the engine's packages"
    )
    parser.add_argument("--capture", type=Path, default=ROOT / "examples" / "room", help="the capture")
    parser.add_argument("--fast", action="store_true", help="few rays and steps: for work on the test itself")
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument("--only", nargs="+", metavar="CHAPTER", default=[], help="by their names in story.py")
    chosen.add_argument("--from", dest="first", metavar="CHAPTER", default="", help="and all after it")
    options = parser.parse_args(argv)
    if not (shutil.which("xvfb-run") and shutil.which("import")):
        print("xvfb-run and ImageMagick are needed for a window without a screen.", file=sys.stderr)
        return 2
    shots = options.shots.resolve()
    shots.mkdir(parents=True, exist_ok=True)
    if not options.only and not options.first:
        shutil.rmtree(shots / "data", ignore_errors=True)
    asked = {"shots": str(shots), "capture": str(options.capture.resolve()), "fast": options.fast}
    asked |= {"engine": os.path.abspath(options.engine), "only": options.only, "first": options.first}
    with tempfile.TemporaryDirectory(prefix="fipt-gui-") as folder, (shots / "blender.log").open("wb") as log:
        variables = {**os.environ, "BLENDER_USER_RESOURCES": f"{folder}/blender"}
        variables |= {"FIPT_DATA": str(shots / "data"), "FIPT_GUI": json.dumps(asked)}
        variables.pop("WAYLAND_DISPLAY", None)
        install = ["--command", "extension", "install-file", "-r", "user_default", "-e"]
        extension = dev.build_extension(Path(folder))
        command = [options.blender, *install, str(extension)]
        if subprocess.run(command, env=variables, stdout=log, stderr=log, check=False).returncode:
            print(f"The extension can't be installed; see {log.name}.", file=sys.stderr)
            return 1
        command = ["xvfb-run", "-a", "-s", "-screen 0 {}x{}x24 +extension GLX".format(*SIZE), options.blender]
        command += ["--window-geometry", "0", "0", *map(str, SIZE), "--enable-event-simulate"]
        command += ["--python", str(HERE / "play.py")]
        result = subprocess.run(command, env=variables, stdin=subprocess.DEVNULL, stdout=log, check=False)
    return 0 if result.returncode == TOLD else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
