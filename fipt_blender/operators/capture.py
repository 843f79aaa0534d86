"""Operators of the section Capture: import cameras, photographs and the room's mesh; the list of views; what
a scan lacks.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import machine
from ..api import importing
from ..core.run.declared import Option
from ..core.run.errors import FiptError
from ..core.run.runfolder import RunFolder
from ..jobs import running
from ..jobs.tasks import Task
from .action import REGISTER, Glob, Messages, action, file_dialog, note
from .polls import has_meshes, has_views, in_object_mode, needs, no_job, views_checked

if TYPE_CHECKING:
    from ..bridge.job import Job
    from ..bridge.process import Message
    from ..bridge.step import Slices, Step

_MESH_FILES = "*.obj;*.ply;*.stl;*.gltf;*.glb;*.fbx;*.usd;*.usdc;*.usda;*.usdz"


@action("Import Capture", needs=(in_object_mode, no_job))
def import_capture(
    scene: bpy.types.Scene,
    filepath: Annotated[
        str,
        Option(
            "Folder or camera file of the capture. If empty, the path in the panel is used",
            "Capture",
            shown={"subtype": "FILE_PATH"},
        ),
    ] = "",
) -> Task:
    """Read and check the photographs and cameras, and add the cameras and the room's mesh to the scene."""
    if filepath:
        scene.fipt.capture.path = filepath
    return importing.capture_import()


@action("Fix", needs=(in_object_mode, no_job))
def fix_capture(
    scene: bpy.types.Scene,
    correct: Annotated[str, Option("Name of the correction", "Correction")] = "",
) -> Task:
    """Import the capture again with the correction that explains what does not fit."""
    settings = scene.fipt.capture
    settings.correct, settings.fixed = correct, settings.path
    return importing.capture_import()


@action(
    "Use Scene Cameras",
    needs=(
        needs(
            lambda context: any(item.type == "CAMERA" for item in context.scene.objects),
            "The scene has no cameras",
        ),
        in_object_mode,
        no_job,
    ),
)
def use_scene_cameras(scene: bpy.types.Scene) -> Task:
    """Use the scene's own cameras as the capture. Each camera needs its photograph as background image."""
    return importing.scene_cameras_import()


@action("Place at 3D Cursor")
def place_panorama(scene: bpy.types.Scene) -> None:
    """Take the 3D Cursor as the place of the panorama, for the next import."""
    settings, place = scene.fipt.capture, scene.cursor.location
    if settings.alignment is not None:
        place = settings.alignment.matrix_world.inverted_safe() @ place
    settings.panorama_place = place


@action("Import Mesh", needs=(in_object_mode,), invoke=file_dialog)
def import_mesh(
    scene: bpy.types.Scene,
    filepath: Annotated[
        str, Option("OBJ, PLY, STL, glTF, FBX or USD", "Mesh", shown={"subtype": "FILE_PATH"})
    ] = "",
    filter_glob: Glob = _MESH_FILES,
) -> str:
    """Import a mesh file as the room, in the coordinates of the capture. The previous room is set aside."""
    from ..blend.capture import importing

    run = RunFolder(bpy.path.abspath(scene.fipt.run_folder)) if scene.fipt.run_folder else None
    path = Path(bpy.path.abspath(filepath or scene.fipt.capture.mesh))
    names = importing.import_mesh(scene, path, importing.source_matrix(scene, run))
    running.settle("capture", "mesh-missing")
    return _meshes(len(names))


def _meshes(count: int) -> str:
    return iface_("The room consists of {} meshes").format(count)


@action("Hide Start-up Objects")
def hide_startup_objects(
    scene: bpy.types.Scene, hide: Annotated[bool, "Hide the objects or show them again"] = True
) -> str:
    """Hide the cube, the light and the camera of Blender's start-up file, if they are as they were there, or
    show them again. Import Capture hides them.
    """
    from ..blend.capture import startup

    return ", ".join(startup.hide_startup_objects(scene, hide)) or iface_("There are none")


@action("Set Room from Selection")
def set_room(
    context: bpy.types.Context,
    collection: Annotated[
        str, "Collection whose meshes are the room. If empty, the selected objects are used"
    ] = "",
) -> Messages:
    """Use the selected meshes as the room. They keep their places and their collections."""
    from ..blend.capture import importing

    settings = context.scene.fipt.capture
    if collection:
        room = bpy.data.collections.get(collection)
        if room is None or not any(member.type == "MESH" for member in room.all_objects):
            raise FiptError("room-missing.set-room", collection=collection)
        settings.room = room
        left_out = importing.not_in_room(room.all_objects)
    else:
        selected = context.view_layer.objects.selected
        left_out = importing.not_in_room(selected)
        meshes = [item for item in selected if item.type == "MESH"]
        if not meshes:
            advice = [f"{each['text']} {each['remedy']}" for each in left_out]
            remedy = " ".join(advice) or "Select the objects that form the room."
            raise FiptError("room-missing.set-room-2", remedy=remedy)
        importing.set_room(context.scene, meshes)
    running.settle("capture", "mesh-missing")
    return [note(_meshes(len(settings.room_objects(context.scene)))), *left_out]


@action("Simplify Room", needs=(has_meshes, in_object_mode))
def simplify_room(scene: bpy.types.Scene) -> str:
    """Decimate the room's larger meshes to the number of triangles, by modifiers. 0 removes these."""
    from ..blend.room import simplifying

    settings = scene.fipt.capture
    before, after = simplifying.simplify_room(settings.room_objects(scene), settings.triangles)
    return iface_("The room has {:,} triangles, {:,} without simplification").format(after, before)


TICKS = (
    ("ALL", "All", "Use every view"),
    ("NONE", "None", "Use no view"),
    ("INVERT", "Invert", "Use the views that are not used now, and only these"),
    ("GOOD", "Without Warnings", "Use the views for which Check Views gave no warning"),
)


@action("Look Through View", needs=(has_views,))
def look_through(
    context: bpy.types.Context,
    view: Annotated[str, "Name of the view. If empty, the active view of the list is used"] = "",
    step: Annotated[int, Option("1 for the next view in the list, -1 for the previous one", low=-1)] = 0,
    toggle: Annotated[
        bool, Option("Also show the photograph over the view, or hide it if it is shown", "Toggle Photograph")
    ] = False,
) -> None:
    """Look through the camera of a view."""
    from ..blend.capture import look

    settings = context.scene.fipt.capture
    index = settings.active_view
    if view:
        index = settings.views.find(view)
        if index < 0:
            raise FiptError("view-missing.look-through", view=view)
    index = (index + step) % len(settings.views)
    if toggle:
        shown = look.shows_photograph(context.scene, settings.views[index], context)
        setattr(settings, settings.photograph_switch(), not shown)
    if look.look_through(context.scene, settings.views[index], context) is None:
        raise FiptError("camera-missing.look-through", name=settings.views[index].name)
    settings.active_view = index


@action("Tick Views", needs=(has_views,), listed=False)
def tick_views(
    scene: bpy.types.Scene, action: Annotated[str, Option("Views to tick", choices=TICKS)] = "ALL"
) -> None:
    """Tick all views in the list, none, the other ones, or those without warnings."""
    settings = scene.fipt.capture
    with settings.counting_later():
        for view in settings.views:
            view.enabled = {"ALL": True, "NONE": False, "INVERT": not view.enabled, "GOOD": not view.warning}[
                action
            ]
    settings.count_views()


def survey_steps(run: RunFolder, search: bool = False) -> tuple[Step, Step]:
    """The steps that write the input of the engine's survey and that do it.

    Args:
        search: the input is for a search of what the room lacks.
    """
    from ..bridge.step import Step

    def write_input() -> Slices[list[Message]]:
        from ..blend.capture.survey import write_survey_input

        return write_survey_input(run, search)

    return (
        Step("survey-input", "Preparing the room", 3.0, function=write_input),
        Step(
            "survey",
            "Finding what each camera sees",
            10.0,
            command=["survey", str(run.survey), f"--device={machine.device_setting()}"],
        ),
    )


def checked_run(scene: bpy.types.Scene) -> RunFolder:
    """The scene's run folder, for work on its room and views.

    Raises:
        FiptError: ``room-missing``.
    """
    from ..blend.capture.importing import room_missing

    if not scene.fipt.capture.room_objects(scene):
        raise room_missing()
    return RunFolder(bpy.path.abspath(scene.fipt.run_folder))


@action("Check Views", needs=(has_views, no_job), options=REGISTER)
def check_views(scene: bpy.types.Scene) -> Task:
    """Check what each view sees of the room and whether its photograph is usable, and find the parts."""

    def make(scene: bpy.types.Scene) -> Job:
        from ..jobs.run_job import open_job

        run = checked_run(scene)
        return open_job(run, list(survey_steps(run)))

    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        from ..blend.capture.survey import take_survey

        take_survey(scene, run)

    return Task("Check Views", "survey", make, finished)


@action("Show Coverage", needs=(views_checked,), options=REGISTER)
def show_coverage(scene: bpy.types.Scene, show: Annotated[bool, "Show or hide the colors"] = True) -> None:
    """Color the room by the number of ticked views that see each surface."""
    from ..blend.capture import overlay, survey

    survey.show_coverage(scene) if show else overlay.hide()


SHAPES = (
    ("BOX", "Box", "A box: a cabinet, a table, a mattress", "MESH_CUBE"),
    ("CYLINDER", "Cylinder", "A cylinder: a round table, a lamp's shade, a vase", "MESH_CYLINDER"),
    ("PANEL", "Panel", "A flat rectangle: a window pane, a mirror, a table top, a screen", "MESH_PLANE"),
)
PLACES = (
    (
        "DISAGREEMENT",
        "Where Photographs Disagree",
        "Where the photographs show most that the room lacks, if the views have been checked",
    ),
    ("CURSOR", "At 3D Cursor", "Standing at the 3D cursor"),
)


def _has_added(context: bpy.types.Context) -> bool:
    from ..blend.marks import ADDED

    return any(ADDED in item for item in context.scene.fipt.capture.room_objects(context.scene))


@action("Find Missing Surfaces", needs=(has_views, no_job))
def find_missing_surfaces(scene: bpy.types.Scene) -> Task:
    """Look now for what the photographs show and the scan lacks, as the estimation does, and add it to the
    room as objects that you may edit or delete. The estimation then adds nothing else. What was found before
    is replaced; what you have added stays. Takes minutes: use Check Views first, which is quick and tells
    whether the mesh fits the photographs.
    """

    def make(scene: bpy.types.Scene) -> Job:
        from ..api import estimating
        from ..bridge.step import Step
        from ..jobs.run_job import open_job, refuse_busy

        run = checked_run(scene)
        refuse_busy(run)
        # In the survey's folder, as the settings in run.json are those of the estimate.
        RunFolder(run.survey).write_settings(estimating.scene_settings(scene))
        prepare, survey = survey_steps(run, search=True)
        command = ["complete", str(run.survey)]
        search = Step("complete", "Looking for what the scan lacks", 60.0, command=command)
        return open_job(run, [prepare, search, survey])

    def finished(scene: bpy.types.Scene, run: RunFolder) -> None:
        from ..blend.capture.additions import take_found
        from ..blend.capture.survey import take_survey

        take_survey(scene, run)
        take_found(scene, run)

    return Task("Find Missing Surfaces", "completion", make, finished, undo=True)


@action(
    "Select Added Surfaces", needs=(needs(_has_added, "No surfaces were added to the room"), in_object_mode)
)
def select_added(context: bpy.types.Context) -> None:
    """Select the surfaces that were added to the room. Keep, edit or delete them: the estimation uses the
    room as it is.
    """
    from ..blend.capture.additions import added_surfaces
    from ..blend.outliner import select_only

    first, *others = [item for item in added_surfaces(context.scene) if not item.hide_get()] or [None]
    if first is None:
        raise FiptError("surfaces-hidden")
    select_only(context.view_layer, first)
    for item in others:
        item.select_set(True)


@action("Add Missing Surface", needs=(has_meshes, in_object_mode))
def add_surface(
    context: bpy.types.Context,
    shape: Annotated[str, Option("Shape of the solid", choices=SHAPES)] = "BOX",
    place: Annotated[str, Option("Where the solid goes", choices=PLACES)] = "DISAGREEMENT",
) -> str:
    """Add a simple solid to the room for a thing that the scan lacks: where the photographs show most after
    Check Views, otherwise at the 3D cursor. Move and scale it over the photographs. It is used as it is, not
    cleaned like a scan.
    """
    from ..blend.capture import additions
    from ..blend.outliner import select_only

    scene = context.scene
    where, text = None, iface_("Move and scale it until it covers the thing in the photographs")
    if place == "DISAGREEMENT" and scene.fipt.capture.unseen_share >= 0.0:
        where = additions.place_of_disagreement(scene)
        if where is None:  # in one report: the status bar shows the last one
            text = iface_("The photographs show nothing else: it is at the 3D cursor") + ". " + text
    where = where or additions.place_at(scene, scene.cursor.location)
    select_only(context.view_layer, additions.draw_surface(scene, shape, where))
    return text
