# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""python benchmarks/example_time.py [PICTURE]: seconds of Try the Example, from the click to a relit picture.

Runs in Blender's Python module, with the engine's packages of the same environment. The picture is the first
view without the first lamp, at half size.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
SAMPLES = 32


def main(argv: list[str]) -> int:
    """Press the button, switch a lamp off, render; 1 where the estimate fails."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["FIPT_DATA"] = folder
        os.environ.setdefault("FIPT_ENGINE_PYTHON", sys.executable)
        import bpy

        import fipt_blender

        bpy.ops.wm.read_factory_settings(use_empty=True)
        fipt_blender.register()
        started = time.monotonic()
        if bpy.ops.fipt.try_example() != {"FINISHED"}:
            return 1
        applied = time.monotonic() - started
        scene = bpy.context.scene
        scene.fipt.lights.lights[0].on = False
        scene.render.resolution_percentage, scene.cycles.samples = 50, SAMPLES
        scene.camera.data.show_background_images = False
        picture = Path(argv[0]) if argv else Path(folder) / "relit.png"
        scene.render.filepath = str(picture.absolute())
        bpy.ops.render.render(write_still=True)
        relit = time.monotonic() - started
    size = scene.render.resolution_x // 2, scene.render.resolution_y // 2
    print(f"results applied after {applied:.0f} s, picture of {size[0]} x {size[1]} after {relit:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
