# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Orders of renders: what to render of a scene into its run folder, and carrying that out in any Blender."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bpy

from ...bridge.process import Message
from ...core.run.contents import CapturedViews
from ...core.run.documents import read_document
from ...core.run.errors import FiptError
from ...core.run.result_contents import Renders
from ...core.run.run_files import read_capture
from ...core.run.runfolder import RunFolder
from ..changed import changed
from ..marks import KEPT_FILM, VIEW
from ..render_settings import can_denoise
from .cycles import Devices, render_picture, user_devices
from .photographed import lights_as_photographed
from .plate import catching, not_catching, plate_scene, remove_plate_scene
from .renders import Progress, list_render, picture_path

INSERT, COMPOSITE = "insert", "composite"
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
        kind: pictures, by the scene's render settings: INSERT (of the rendered room) or COMPOSITE (into the
            photograph).
        run: path of the run folder.
        scene: name of the scene.
        views: of pictures, the name of one camera.
        room: names of the room's objects.
        path: of pictures: the EXR that is written, with a PNG beside it.
        device: Cycles' device, "CPU" or "GPU".
        devices: the user's Cycles devices; None for the processor.
    """

    kind: str
    run: str
    scene: str
    views: list[str]
    room: list[str]
    path: str = ""
    device: str = "CPU"
    devices: Devices | None = None

    @property
    def title(self) -> str:
        """What the user reads while it is carried out."""
        return {
            INSERT: "Rendering the picture",
            COMPOSITE: "Compositing into the photograph",
        }[self.kind]


def order_picture(scene: bpy.types.Scene, run: RunFolder, camera: bpy.types.Object, plate: bool) -> Order:
    """An order of a picture of what a camera sees, over the photograph with `plate`.

    Raises:
        FiptError: ``room-missing``; with `plate` ``view-missing``, ``file-missing`` or ``file-damaged``.
    """
    room, kind = _room(scene), COMPOSITE if plate else INSERT
    if plate:
        read_capture(run.capture_json).view(view_of(camera))
    path = picture_path(run, kind, camera.get(VIEW, camera.name) + ("_photograph" if plate else ""))
    return Order(kind, str(run.root), scene.name, [camera.name], room, str(path), *_device(scene))


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
    _render_picture(order, run, scene, read_capture(run.capture_json), progress)
    return [] if can_denoise() else [_NOT_DENOISED]


def _render_picture(
    order: Order, run: RunFolder, scene: bpy.types.Scene, capture: CapturedViews, progress: Progress
) -> None:
    """Render a picture as EXR and PNG."""
    path, camera = Path(order.path), scene.objects.get(order.views[0])
    if camera is None:
        text = f"The scene has no camera '{order.views[0]}'."
        raise FiptError("view-missing", text, "Start the render again.")
    if order.kind == COMPOSITE:
        with catching(scene, order.room), lights_as_photographed(scene):
            shot = plate_scene(scene, run, capture.view(view_of(camera)), camera, order.room)
            progress(0.0, 1.0)
            try:
                render_picture(shot, path, order.device)
            finally:
                remove_plate_scene(shot)
    else:
        progress(0.0, 1.0)
        # While the backdrop is the photograph, the film is transparent by our doing.
        film = bool(scene.get(KEPT_FILM, scene.render.film_transparent))
        with (
            not_catching(scene, order.room),
            changed(scene, {"camera": camera}),
            changed(scene.render, {"film_transparent": film}),
        ):
            render_picture(scene, path, order.device)
    list_render(run, order.kind, camera.get(VIEW, camera.name), path.with_suffix(".png"))


def last_picture(run: RunFolder) -> Path:
    """The PNG of the picture that was rendered last.

    Raises:
        FiptError: ``file-missing`` or ``file-damaged``.
    """
    renders = read_document(run.renders_json, Renders, "Delete it and render again.").renders
    images = [render.image for render in renders if render.kind in (INSERT, COMPOSITE)]
    return run.resolve(images[-1])
