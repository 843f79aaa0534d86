# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders of the capture's views into the run folder, listed in renders.json."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import bpy

from ...core.run.documents import read_json
from ...core.run.runfolder import RunFolder, write_json
from ...core.run.shapes import RENDERS
from ..capture.cameras import find_camera, use_view
from ..changed import changed
from ..lights.area_lights import Rectangle, add_area_light
from ..lights.light_state import set_estimated_lights
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
    listed = []
    if run.renders_json.exists():
        listed = read_json(run.renders_json, RENDERS, "Delete it and render again.")["renders"]
    kept = [entry for entry in listed if (entry["kind"], entry["view"]) != (kind, view)]
    entry = {"kind": kind, "view": view, "image": path.relative_to(run.root).as_posix()}
    write_json(run.renders_json, {"renders": [*kept, entry]})


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


def render_cycles_views(
    run: RunFolder,
    blend_file: Path,
    views: Sequence[str],
    options: RenderOptions,
    relight: Mapping[str, Any] | None = None,
) -> list[Path]:
    """Open a result's .blend and render views as they are, or lit by a single new light.

    Meant for a process of its own, since it replaces the open file.

    Args:
        run: the run folder.
        blend_file: the file with the results.
        views: names of the views.
        options: how to render them.
        relight: {"vertices": four corners in Blender's world, counter-clockwise seen from its front,
            "radiance": rgb}; the estimated lights are then off.
    """
    bpy.ops.wm.open_mainfile(filepath=str(blend_file), load_ui=False, use_scripts=False)
    scene = bpy.context.scene
    if relight is None:
        return render_list(run, scene, "rerender", views, options)
    set_estimated_lights(False)
    rectangle = Rectangle.of_corners(relight["vertices"])
    add_area_light("FIPT Relight", relight["radiance"], rectangle, scene)
    return render_list(run, scene, "relight", views, options)
