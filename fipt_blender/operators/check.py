"""Operators of the section Render: balls, pictures, the report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.run.declared import Option
from ..core.run.errors import FiptError, warning
from ..core.run.runfolder import RunFolder
from ..jobs.tasks import Task
from ..jobs.window import show_notice
from ..properties.check import BACKDROPS
from .action import REGISTER, Messages, action
from .polls import has_results, has_run, in_object_mode, needs, no_job

if TYPE_CHECKING:
    from ..bridge.job import Job


@action("Write Report", needs=(no_job, has_run), options=REGISTER)
def write_report(scene: bpy.types.Scene) -> Task:
    """Write an HTML page that shows the results: renders, maps, lights, warnings and settings."""

    def make(scene: bpy.types.Scene) -> Job:
        from ..bridge.step import Step
        from ..jobs.run_job import open_job

        run = RunFolder(bpy.path.abspath(scene.fipt.run_folder))
        run.read()  # raises if the folder is missing or no run folder
        step = Step("report", "Writing the report", 5.0, command=["report", str(run.root)])
        return open_job(run, [step])

    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        scene.fipt.check.report = str(run.report / "index.html")

    return Task("Write Report", "report", make, finished)


@action(
    "Open Report",
    needs=(needs(lambda context: context.scene.fipt.check.report, "Use Write Report first"),),
    options=REGISTER,
)
def open_report(scene: bpy.types.Scene) -> None:
    """Open the report in the web browser."""
    # The path comes from the .blend file, whoever made that.
    page = Path(bpy.path.abspath(scene.fipt.check.report))
    run = RunFolder(page.parent.parent)
    if page != run.report / "index.html" or not run.run_json.is_file():
        raise FiptError("report-missing.open-report", page=page)
    if not page.is_file():
        raise FiptError("report-missing.open-report-2", page=page)
    bpy.ops.wm.url_open(url=page.as_uri())


KINDS = (
    ("GRAY_BALL", "Gray", "Matte, 18% gray: shows where the light comes from", "SPHERE"),
    ("MIRROR_BALL", "Mirror", "Chrome: reflects its surroundings", "SHADING_RENDERED"),
)


@action("Add Ball", needs=(in_object_mode,))
def add_ball(
    context: bpy.types.Context,
    kind: Annotated[str, Option("Surface of the ball", choices=KINDS)] = "GRAY_BALL",
    size: Annotated[
        float,
        Option(
            "Diameter of the ball. If 0, one that suits the room",
            "Diameter",
            zero=True,
            shown={"subtype": "DISTANCE"},
        ),
    ] = 0.0,
) -> None:
    """Add a ball that stands on the 3D cursor, as on a film set."""
    from ..blend.insert import balls
    from ..blend.outliner import select_only

    scene = context.scene
    size = size or balls.ball_size(scene.fipt.capture.room_objects(scene))
    select_only(context.view_layer, balls.add_ball(scene, scene.cursor.location, kind.lower(), size))


def _has_room(context: bpy.types.Context) -> bool:
    from ..blend.outliner import ROOM, find_collection

    scene = context.scene
    return scene.fipt.capture.room is not None or find_collection(scene, ROOM) is not None


@action(
    "Set Backdrop",
    needs=(needs(_has_room, "Import a capture or set the room first, in the section Capture"),),
    description=classmethod(
        lambda cls, context, properties: next(row[2] for row in BACKDROPS if row[0] == properties.mode)
    ),
    listed=False,
)
def set_backdrop(
    scene: bpy.types.Scene,
    mode: Annotated[
        str, Option("What is behind the inserted objects", "Backdrop", choices=BACKDROPS)
    ] = "ROOM",
) -> None:
    """Select the backdrop of inserted objects: the rendered room, or the original photograph."""
    from ..blend.capture import backdrop

    backdrop.set_backdrop(scene, mode, scene.fipt.capture.room_objects(scene))


@action(
    "Final Picture",
    needs=(
        no_job,
        has_run,
        needs(
            lambda context: context.scene.fipt.materials.shown == "ESTIMATED",
            "Set Show to Estimated first, in the section Materials",
        ),
    ),
)
def final_picture(
    scene: bpy.types.Scene,
    view: Annotated[
        str, "Name of a view to look through first. If empty, the scene's active camera is used"
    ] = "",
) -> Messages:
    """Render what the scene's camera sees with the scene's render settings, as F12 does. Rendered Room: the
    whole room; Photograph: the inserted objects with their shadows and reflections over the photograph, whose
    lens's distortion is undone, in Cycles. It is saved beside the .blend file as EXR of all layers and passes
    and as PNG. Esc stops it.
    """
    from ..blend.capture.cameras import find_camera, use_view
    from ..blend.pictures.final import take_picture
    from ..blend.render_settings import can_denoise

    if view:
        use_view(scene, find_camera(view, scene))
    if scene.camera is None:
        raise FiptError("view-missing.final-picture")

    def failed(error: FiptError) -> None:
        show_notice(str(error), "ERROR")

    take_picture(scene, RunFolder(bpy.path.abspath(scene.fipt.run_folder)), failed)
    if can_denoise():
        return []
    return [warning("denoise-missing")]


@action("Set Render Settings", needs=(has_results,))
def set_rendering(scene: bpy.types.Scene) -> None:
    """Set the scene's render settings again as Apply Results does once: Cycles, samples, denoiser, color
    management and exposure of the photographs.
    """
    from ..blend.render_settings import set_up
    from ..blend.results.scene_state import photographs_exposure

    set_up(scene, photographs_exposure(scene), again=True)


@action(
    "Show Picture",
    needs=(needs(lambda context: context.scene.fipt.insert.picture, "Use Final Picture first"),),
    options=REGISTER,
)
def open_picture(context: bpy.types.Context) -> None:
    """Show the last rendered picture in an Image Editor."""
    from ..blend.pictures.editors import load_picture, open_editor

    path = Path(context.scene.fipt.insert.picture)
    image = load_picture(path)
    if image is None:
        raise FiptError("image-missing.open-picture", path=path)
    open_editor(context, image)


@action(
    "Compositor Scene",
    needs=(
        needs(
            lambda context: context.scene.fipt.insert.backdrop == "PHOTOGRAPH",
            "Select Photograph first, in the section Render",
        ),
    ),
)
def plate_nodes(scene: bpy.types.Scene) -> str:
    """Make a scene with the same objects, whose compositor nodes put them over the photograph of the current
    view, as Final Picture does. The room's scene is not changed.
    """
    from ..blend.pictures.final import view_scene

    made = view_scene(scene, RunFolder(bpy.path.abspath(scene.fipt.run_folder)))
    return iface_("The scene '{}' has the nodes").format(made.name)
