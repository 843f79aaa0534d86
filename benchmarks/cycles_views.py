"""Render views of a finished run in Cycles, in a separate process: python cycles_views.py RUN SPP < JSON.

The JSON on stdin is {"rerender": {name: most columns, or null}, "relight": null or {"views": [names],
"vertices": four corners, "radiance": rgb}}.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from fipt_blender.core.run.runfolder import RunFolder

if TYPE_CHECKING:
    import bpy

    from fipt_blender.blend.pictures.cycles import RenderOptions


def apart(run: RunFolder) -> RunFolder:
    """The same run with a separate folder for renders, so that the user's renders are not changed."""
    run.renders = run.root / "accuracy" / "renders"
    run.renders_json = run.renders / "renders.json"
    return run


def render_views(
    run: RunFolder,
    blend_file: Path,
    views: Mapping[str, int | None],
    options: RenderOptions,
    relight: Mapping[str, Any] | None = None,
) -> list[Path]:
    """Open a result's .blend and render views as they are, or lit by a single new light.

    Meant for a process of its own, since it replaces the open file. Beside each image as it is a PNG has what
    Blender displays once one looks through the view.

    Args:
        run: the run folder.
        blend_file: the file with the results.
        views: names of the views, and the most columns that each has.
        options: how to render them.
        relight: {"vertices": four corners in Blender's world, counter-clockwise seen from its front,
            "radiance": rgb}; the estimated lights are then off.
    """
    import bpy

    from fipt_blender.blend.capture.cameras import find_camera
    from fipt_blender.blend.lights.area_lights import add_area_light
    from fipt_blender.blend.lights.light_state import switch_all
    from fipt_blender.blend.pictures.cycles import render_exr
    from fipt_blender.blend.pictures.renders import list_render, render_path

    bpy.ops.wm.open_mainfile(filepath=str(blend_file), load_ui=False, use_scripts=False)
    scene = bpy.context.scene
    kind = "rerender" if relight is None else "relight"
    if relight is not None:
        switch_all(False)
        add_area_light("FIPT Relight", relight["radiance"], relight["vertices"], scene)
    for view, columns in views.items():
        path = render_path(run, kind, view)
        render_exr(scene, path, options, find_camera(view, scene), columns)
        list_render(run, kind, view, path)
        if relight is None:
            write_displayed(scene, view, path)
    return [render_path(run, kind, view) for view in views]


def write_displayed(scene: bpy.types.Scene, view: str, path: Path) -> None:
    """Write the PNG of a view's EXR as *Look Through* displays it."""
    import bpy

    from fipt_blender.blend.capture.look import look_through
    from fipt_blender.blend.image_datablocks import load_radiance

    look_through(scene, scene.fipt.capture.views[view], bpy.context)
    scene.render.image_settings.file_format = "PNG"
    load_radiance(path, encoded=False).save_render(str(path.with_suffix(".png")), scene=scene)


def main() -> None:
    """Render the views named on stdin into the run's accuracy folder."""
    run, spp = apart(RunFolder(sys.argv[1])), int(sys.argv[2])
    import fipt_blender
    from fipt_blender.blend.pictures.cycles import RenderOptions  # bpy

    fipt_blender.register()  # the exposures of views are its properties
    wanted = json.load(sys.stdin)
    blend = run.root / "room.blend"
    render_views(run, blend, wanted["rerender"], RenderOptions(spp))
    if wanted["relight"]:
        views = dict.fromkeys(wanted["relight"].pop("views"))
        render_views(run, blend, views, RenderOptions(spp), wanted["relight"])


if __name__ == "__main__":
    main()
