# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders of the capture's views into the run folder, listed in renders.json."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import bpy

from ...core.run.documents import read_document
from ...core.run.result_contents import Render, Renders
from ...core.run.runfolder import RunFolder, write_json
from ..capture.cameras import find_camera, use_view
from ..changed import changed
from .cycles import RenderOptions, render_exr

# Called before each render with the shares of the whole work (0 to 1) at which it starts and ends.
Progress = Callable[[float, float], None]

# Most columns of renders that are compared with photographs: those of 12 megapixels would take hours.
COMPARED_WIDTH = 1920
_VIEW_SETTINGS = (
    "resolution_x",
    "resolution_y",
    "pixel_aspect_x",
    "pixel_aspect_y",
    "resolution_percentage",
    "use_border",
)


def render_path(run: RunFolder, kind: str, view: str) -> Path:
    """RUN/renders/KIND/VIEW.exr, slashes of the view's name replaced."""
    return run.renders / kind / f"{view.replace('/', '_')}.exr"


def render_view(
    scene: bpy.types.Scene, view: str, path: Path, options: RenderOptions, widest: int | None = None
) -> None:
    """Render one view of the capture; the scene's camera and render settings are restored afterwards.

    Args:
        widest: the render is made smaller than the photograph where that has more columns.

    Raises:
        FiptError: ``view-missing``, and those of `render_exr`.
    """
    camera = find_camera(view, scene)
    settings = {name: getattr(scene.render, name) for name in _VIEW_SETTINGS}
    with changed(scene.render, settings), changed(scene, {"camera": camera}):
        use_view(scene, camera)
        if widest is not None and scene.render.resolution_x > widest:
            scene.render.resolution_percentage = max(1, 100 * widest // scene.render.resolution_x)
        render_exr(scene, path, options)


def list_render(run: RunFolder, kind: str, view: str, path: Path) -> None:
    """Add a render to renders.json, in place of an earlier one of the same kind and view."""
    listed: Sequence[Render] = ()
    if run.renders_json.exists():
        listed = read_document(run.renders_json, Renders, "Delete it and render again.").renders
    kept = [render for render in listed if (render.kind, render.view) != (kind, view)]
    render = Render(kind, view, path.relative_to(run.root).as_posix())
    write_json(run.renders_json, Renders((*kept, render)))


def render_list(
    run: RunFolder, scene: bpy.types.Scene, kind: str, views: Sequence[str], options: RenderOptions
) -> list[Path]:
    """Render views into renders/KIND/ and list them in renders.json.

    Args:
        run: the run folder.
        scene: the scene.
        kind: "rerender", "relight" or "insert".
        views: names of the views.
        options: how to render them.
    """
    paths = []
    for view in views:
        path = render_path(run, kind, view)
        render_view(scene, view, path, options, COMPARED_WIDTH)
        list_render(run, kind, view, path)
        paths.append(path)
    return paths
