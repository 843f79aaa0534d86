"""The frames and files of renders: of views into the run folder, listed in renders.json, and of pictures."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import bpy

from ...core.run.documents import read_document
from ...core.run.result_contents import Render, Renders
from ...core.run.runfolder import RunFolder, write_json
from ..capture.cameras import find_camera
from ..marks import RESOLUTION
from ..render_settings import fitted
from .cycles import RenderOptions, render_exr

# Most columns of renders that are compared with photographs: those of 12 megapixels would take hours.
COMPARED_WIDTH = 1920


def render_path(run: RunFolder, kind: str, view: str) -> Path:
    """RUN/renders/KIND/VIEW.exr, slashes of the view's name replaced."""
    return run.renders / kind / f"{view.replace('/', '_')}.exr"


def picture_path(run: RunFolder, kind: str, camera: str) -> Path:
    """A new file for a picture: beside the .blend file in NAME_pictures, unsaved in RUN/renders/KIND."""
    blend = bpy.data.filepath
    folder = Path(blend).with_name(f"{Path(blend).stem}_pictures") if blend else run.renders / kind
    name = re.sub(r"[^\w. -]", "_", camera).strip(". ") or "picture"
    number, path = 1, folder / f"{name}.exr"
    while path.exists() or path.with_suffix(".png").exists():
        number += 1
        path = folder / f"{name}_{number}.exr"
    return path


def plate_size(scene: bpy.types.Scene, camera: bpy.types.Object) -> tuple[int, int]:
    """Columns and rows of pictures over a view's photograph: of the scene's size, in its proportions.

    A photograph of another size is scaled: objects are never as coarse as a small one.
    """
    longer = max(output_size(scene))
    return fitted((int(camera[RESOLUTION][0]), int(camera[RESOLUTION][1])), longer)


def output_size(scene: bpy.types.Scene) -> tuple[int, int]:
    """Columns and rows of what F12 renders."""
    share = scene.render.resolution_percentage / 100.0
    return max(1, int(scene.render.resolution_x * share)), max(1, int(scene.render.resolution_y * share))


def list_render(run: RunFolder, kind: str, view: str, path: Path) -> None:
    """Add a render to renders.json, in place of an earlier one of the same kind and view."""
    listed: Sequence[Render] = ()
    if run.renders_json.exists():
        listed = read_document(run.renders_json, Renders, "Delete it and render again.").renders
    kept = [render for render in listed if (render.kind, render.view) != (kind, view)]
    image = path.relative_to(run.root) if path.is_relative_to(run.root) else path
    write_json(run.renders_json, Renders((*kept, Render(kind, view, image.as_posix()))))


def render_listed(
    run: RunFolder, scene: bpy.types.Scene, kind: str, view: str, options: RenderOptions
) -> None:
    """Render a view into renders/KIND/ and list it in renders.json.

    Args:
        run: the run folder.
        scene: the scene.
        kind: "rerender", "relight" or "insert".
        view: its name.
        options: how to render it.
    """
    path = render_path(run, kind, view)
    render_exr(scene, path, options, find_camera(view, scene), COMPARED_WIDTH)
    list_render(run, kind, view, path)
