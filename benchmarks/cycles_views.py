# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Render views of a finished run in Cycles, in a process of its own: python cycles_views.py RUN SPP < JSON.

The JSON on stdin is {"rerender": [names], "relight": null or {"views": [names], "vertices": four corners,
"radiance": rgb}}.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from fipt_blender.core.job.runfolder import RunFolder


def apart(run: RunFolder) -> RunFolder:
    """The same run with a renders folder of its own, so that the user's own stay as they are."""
    run.renders = run.root / "accuracy" / "renders"
    run.renders_json = run.renders / "renders.json"
    return run


def main() -> None:
    """Render what stdin asks for below the run's accuracy folder."""
    run, spp = apart(RunFolder(sys.argv[1])), int(sys.argv[2])
    from fipt_blender.blend.renders import render_cycles_views  # bpy

    wanted = json.load(sys.stdin)
    blend = run.root / "room.blend"
    render_cycles_views(run, blend, wanted["rerender"], spp=spp)
    if wanted["relight"]:
        render_cycles_views(run, blend, wanted["relight"].pop("views"), wanted["relight"], spp=spp)


if __name__ == "__main__":
    main()
