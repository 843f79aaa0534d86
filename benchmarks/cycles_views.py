# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Render views of a finished run in Cycles, in a separate process: python cycles_views.py RUN SPP < JSON.

The JSON on stdin is {"rerender": [names], "relight": null or {"views": [names], "vertices": four corners,
"radiance": rgb}}.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from fipt_blender.core.run.runfolder import RunFolder


def apart(run: RunFolder) -> RunFolder:
    """The same run with a separate folder for renders, so that the user's renders are not changed."""
    run.renders = run.root / "accuracy" / "renders"
    run.renders_json = run.renders / "renders.json"
    return run


def main() -> None:
    """Render the views named on stdin into the run's accuracy folder."""
    run, spp = apart(RunFolder(sys.argv[1])), int(sys.argv[2])
    from fipt_blender.blend.pictures.cycles import RenderOptions  # bpy
    from fipt_blender.blend.pictures.renders import render_cycles_views

    wanted = json.load(sys.stdin)
    blend = run.root / "room.blend"
    render_cycles_views(run, blend, wanted["rerender"], RenderOptions(spp))
    if wanted["relight"]:
        views = wanted["relight"].pop("views")
        render_cycles_views(run, blend, views, RenderOptions(spp), wanted["relight"])


if __name__ == "__main__":
    main()
