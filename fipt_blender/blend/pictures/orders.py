# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Orders of renders: what to render of a scene into its run folder, and carrying that out in any Blender."""

from __future__ import annotations

from collections.abc import Sequence
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
from ..marks import KEPT_FILM, VIEW
from ..render_settings import can_denoise
from .composite import added_objects, not_catching, render_composite, without
from .cycles import Devices, RenderOptions, render_exr, user_devices
from .image_files import photograph, save_look
from .layered_exr import write_layers
from .photographed import lights_as_photographed
from .renders import (
    COMPARED_WIDTH,
    Progress,
    list_render,
    picture_path,
    plate_frame,
    render_path,
    render_view,
)
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
        kind: CHECK (views beside their photographs); pictures, by the scene's render settings: INSERT (of the
            rendered room) or COMPOSITE (into the photograph).
        run: path of the run folder.
        scene: name of the scene.
        views: names of the views; of pictures, the name of one camera.
        room: names of the room's objects.
        path: of pictures: the EXR that is written, with a PNG beside it.
        spp: of checks: samples per pixel.
        device: Cycles' device, "CPU" or "GPU".
        devices: the user's Cycles devices; None for the processor.
    """

    kind: str
    run: str
    scene: str
    views: list[str]
    room: list[str]
    path: str = ""
    spp: int = 0
    device: str = "CPU"
    devices: Devices | None = None

    @property
    def title(self) -> str:
        """What the user reads while it is carried out."""
        count = len(self.views)
        return {
            CHECK: "Rendering the view" if count == 1 else f"Rendering {count} views",
            INSERT: "Rendering the picture",
            COMPOSITE: "Compositing into the photograph",
        }[self.kind]


def make_order(scene: bpy.types.Scene, run: RunFolder, views: Sequence[str], spp: int) -> Order:
    """An order of a check, for the device with which the artist renders.

    Raises:
        FiptError: ``room-missing``, ``view-missing``, ``file-missing`` or ``file-damaged``.
    """
    room = _room(scene)
    capture = read_capture(run.capture_json)
    for view in views:
        capture.view(view)
        find_camera(view, scene)
    return Order(CHECK, str(run.root), scene.name, list(views), room, "", spp, *_device(scene))


def order_picture(scene: bpy.types.Scene, run: RunFolder, camera: bpy.types.Object, plate: bool) -> Order:
    """An order of a picture of what a camera sees, over the photograph with `plate`.

    Raises:
        FiptError: ``room-missing``; with `plate` ``view-missing``, ``file-missing`` or ``file-damaged``.
    """
    room, kind = _room(scene), COMPOSITE if plate else INSERT
    if plate:
        read_capture(run.capture_json).view(view_of(camera))
    path = picture_path(run, kind, camera.get(VIEW, camera.name) + ("_photograph" if plate else ""))
    return Order(kind, str(run.root), scene.name, [camera.name], room, str(path), 0, *_device(scene))


def view_of(camera: bpy.types.Object | None) -> str:
    """Name of the view that a camera shows.

    Raises:
        FiptError: ``view-missing``.
    """
    if camera is None or not camera.get(VIEW):
        raise FiptError(
            "view-missing",
            "The scene's active camera is no camera of the capture.",
            "Click a view in the section Capture to look through its camera.",
        )
    return str(camera[VIEW])


def _room(scene: bpy.types.Scene) -> list[str]:
    room = [item.name for item in scene.fipt.capture.room_objects(scene)]
    if not room:
        raise FiptError("room-missing", "The scene has no room.", "Choose it in the section Capture.")
    return room


def _device(scene: bpy.types.Scene) -> tuple[str, Devices | None]:
    devices = user_devices()
    return scene.cycles.device if devices is not None and hasattr(scene, "cycles") else "CPU", devices


def carry_out(order: Order, progress: Progress = lambda low, high: None) -> list[Message]:
    """Render what is ordered, and list it in renders.json.

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
    capture = read_capture(run.capture_json)
    if order.kind == CHECK:
        warnings = _check_views(order, run, scene, capture, progress)
    else:
        warnings = _render_picture(order, run, scene, capture, progress)
    return warnings if can_denoise() else [*warnings, _NOT_DENOISED]


def _check_views(
    order: Order, run: RunFolder, scene: bpy.types.Scene, capture: CapturedViews, progress: Progress
) -> list[Message]:
    """Render views as they were photographed and compare them."""
    warnings: list[Message] = []
    lenses = [find_camera(name, scene).data.dof for name in order.views]
    options = RenderOptions(order.spp, device=order.device)
    with (
        not_catching(scene, order.room),
        without(added_objects(scene, order.room)),
        changed(scene, {"background_set": None}),
        all_changed(lenses, {"use_dof": False}),
        lights_as_photographed(scene),
    ):
        for index, name in enumerate(order.views):
            view = capture.view(name)
            progress(index / len(order.views), (index + 1) / len(order.views))
            path = render_path(run, CHECK, name)
            render_view(scene, name, path, options, COMPARED_WIDTH)
            list_render(run, CHECK, name, path)
            warnings += _check(order, run, capture, view, path)
    return warnings


def _render_picture(
    order: Order, run: RunFolder, scene: bpy.types.Scene, capture: CapturedViews, progress: Progress
) -> list[Message]:
    """Render a picture as EXR and PNG."""
    path, camera = Path(order.path), scene.objects.get(order.views[0])
    if camera is None:
        text = f"The scene has no camera '{order.views[0]}'."
        raise FiptError("view-missing", text, "Start the render again.")
    options = RenderOptions(device=order.device)
    with changed(scene, {"camera": camera}):
        if order.kind == COMPOSITE:
            view = capture.view(view_of(camera))
            plate = photograph(run, view)
            with plate_frame(scene, camera):
                layers = render_composite(scene, plate, view.encoded, order.room, options, progress)
            write_layers(path, layers, exact=("depth",))
        else:
            progress(0.0, 1.0)
            # While the backdrop is the photograph, the film is transparent by our doing.
            film = bool(scene.get(KEPT_FILM, scene.render.film_transparent))
            with not_catching(scene, order.room), changed(scene.render, {"film_transparent": film}):
                render_exr(scene, path, options)
    save_look(path, path.with_suffix(".png"), scene)
    list_render(run, order.kind, camera.get(VIEW, camera.name), path)
    return []


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


def last_picture(run: RunFolder) -> Path:
    """The EXR of the picture that was rendered last.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    renders = read_document(run.renders_json, Renders, "Delete it and render again.").renders
    images = [render.image for render in renders if render.kind in (INSERT, COMPOSITE)]
    return run.resolve(images[-1])
