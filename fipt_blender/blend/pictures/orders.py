# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Orders of renders: what to render of a scene into its run folder, and carrying that out in any Blender."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import bpy

from ...bridge.process import Message
from ...core.run.contents import CapturedView, CapturedViews
from ...core.run.documents import read_document
from ...core.run.errors import FiptError
from ...core.run.result_contents import Renders
from ...core.run.run_files import read_capture
from ...core.run.runfolder import RunFolder
from ..capture.cameras import find_camera
from ..changed import all_changed, changed
from .composite import added_objects, compose, not_catching, render_layers, without
from .cycles import Devices, RenderOptions, can_denoise, user_devices
from .image_files import photograph, save_exr, save_look
from .photographed import lights_as_photographed
from .renders import COMPARED_WIDTH, Progress, list_render, render_path, render_view
from .view_check import check_view, forget_check

CHECK, INSERT, COMPOSITE = "rerender", "insert", "composite"
_NOT_DENOISED: Message = {
    "type": "warning",
    "code": "denoise-missing",
    "text": "This Blender was built without its denoiser; the render is noisy.",
    "remedy": "Raise the samples, or use a Blender from blender.org.",
}


@dataclass(frozen=True)
class Order:
    """What to render.

    Attributes:
        kind: CHECK (which also compares with the photographs), INSERT or COMPOSITE.
        run: path of the run folder.
        scene: name of the scene.
        views: names of the views.
        room: names of the room's objects.
        spp: samples per pixel.
        device: Cycles' device, "CPU" or "GPU".
        devices: the user's Cycles devices; None for the processor.
    """

    kind: str
    run: str
    scene: str
    views: list[str]
    room: list[str]
    spp: int = 64
    device: str = "CPU"
    devices: Devices | None = None

    @property
    def title(self) -> str:
        """What the user reads while it is carried out."""
        count = len(self.views)
        return {
            CHECK: "Rendering the view" if count == 1 else f"Rendering {count} views",
            INSERT: "Rendering the view",
            COMPOSITE: "Compositing into the photograph",
        }[self.kind]


def make_order(scene: bpy.types.Scene, run: RunFolder, kind: str, views: Sequence[str], spp: int) -> Order:
    """An order for the device with which the artist renders.

    Raises:
        FiptError: ``room-missing``, ``view-missing``, ``file-missing`` or ``file-damaged``.
    """
    room = [item.name for item in scene.fipt.capture.room_objects(scene)]
    if not room:
        raise FiptError("room-missing", "The scene has no room.", "Choose it in the section Capture.")
    capture = read_capture(run.estimated().capture_json)
    for view in views:
        capture.view(view)
        find_camera(view, scene)
    devices = user_devices()
    device = scene.cycles.device if devices is not None and hasattr(scene, "cycles") else "CPU"
    return Order(kind, str(run.root), scene.name, list(views), room, spp, device, devices)


def carry_out(order: Order, progress: Progress = lambda low, high: None) -> list[Message]:
    """Render an order's views into the run's renders/, and list them in renders.json.

    Args:
        order: what to render.
        progress: called before each render.

    Returns:
        Warnings.

    Raises:
        FiptError: ``scene-gone``, ``view-missing``, ``image-missing``, ``render-failed`` or write errors.
    """
    run = RunFolder(order.run)
    scene = bpy.data.scenes.get(order.scene)
    if scene is None:
        raise FiptError("scene-gone", f"There is no scene '{order.scene}'.", "Start the render again.")
    capture = read_capture(run.estimated().capture_json)
    room = set(order.room)
    warnings: list[Message] = []
    with ExitStack() as stack:
        stack.enter_context(not_catching(scene, room))
        if order.kind == CHECK:
            stack.enter_context(without(added_objects(scene, room)))
            stack.enter_context(changed(scene, {"background_set": None}))
            lenses = [find_camera(name, scene).data.dof for name in order.views]
            stack.enter_context(all_changed(lenses, {"use_dof": False}))
            stack.enter_context(lights_as_photographed(scene))
        for index, name in enumerate(order.views):
            view = capture.view(name)
            path = _render(order, run, scene, view, _part(progress, index, len(order.views)))
            if order.kind == CHECK:
                warnings += _check(order, run, capture, view, path)
            else:
                save_look(path, path.with_suffix(".png"), scene)
    return warnings if can_denoise() else [*warnings, _NOT_DENOISED]


def _check(
    order: Order, run: RunFolder, capture: CapturedViews, view: CapturedView, render: Path
) -> list[Message]:
    """Compare a render with its photograph; a warning if the photograph is missing."""
    try:
        check_view(run, capture, view, render, order.spp, order.views)
        return []
    except FiptError as error:
        if error.code != "image-missing":
            raise
        forget_check(run, view.name)
        text = f"{error.text} The view was rendered to {render}, but could not be compared."
        return [{"type": "warning", "code": error.code, "text": text, "remedy": error.remedy}]


def _part(progress: Progress, index: int, count: int) -> Progress:
    """Progress within one of several equal parts of the work."""
    low, high = index / count, (index + 1) / count
    return lambda start, end: progress(low + start * (high - low), low + end * (high - low))


def _render(
    order: Order, run: RunFolder, scene: bpy.types.Scene, view: CapturedView, progress: Progress
) -> Path:
    """Render one view of an order, given its entry of capture.json; returns the EXR."""
    options = RenderOptions(order.spp, device=order.device)
    path = render_path(run, order.kind, view.name)
    if order.kind == COMPOSITE:
        layers = render_layers(scene, view.name, photograph(run, view), set(order.room), options, progress)
        save_exr(path, compose(layers))
    else:
        progress(0.0, 1.0)
        widest = COMPARED_WIDTH if order.kind == "rerender" else None
        render_view(scene, view.name, path, options, widest)
    list_render(run, order.kind, view.name, path)
    return path


def last_picture(run: RunFolder) -> Path:
    """The EXR of the view that was rendered last with inserted objects.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    renders = read_document(run.renders_json, Renders, "Delete it and render again.").renders
    images = [render.image for render in renders if render.kind in (INSERT, COMPOSITE)]
    return run.resolve(images[-1])
