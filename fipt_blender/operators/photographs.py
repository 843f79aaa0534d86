"""Operators of the section Photographs: choose them, find and correct brackets, pick a known distance, make
a capture of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import bpy

from ..core.capture.suffixes import SUFFIXES
from ..core.run.errors import FiptError
from ..jobs import running
from ..jobs.tasks import Task
from ..prepare.preparation import Group, PreparationFolder
from .action import REGISTER, ChoosesFiles, Glob, action, file_dialog
from .pointer import NAVIGATION, WHEEL, WaitsForClicks, is_cancel, is_click
from .polls import needs, no_job, over_sidebar

if TYPE_CHECKING:
    from ..bridge.job import Job
    from ..prepare.preparation import Group, PreparationFolder
    from ..properties.photographs import FIPT_PhotographsSettings

_FILES = ";".join(f"*{suffix}" for suffix in SUFFIXES)  # that the file browser shows
# The groups that this session has written to prepare.json: folder and digest. After an undo the scene's list
# is an older one, which is no reason to think that somebody else has changed the file.
_written: set[tuple[str, str]] = set()


_has_folder = needs(
    lambda context: context.scene.fipt.photographs.path, "Choose the folder of the photographs first"
)


def _choose(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
    if self.directory:  # dropped files
        return _then_find_brackets(self.execute(context))
    return file_dialog(self, context, event)


@action("Choose Photographs", bases=(ChoosesFiles,), listed=False, invoke=_choose)
def choose_photographs(
    scene: bpy.types.Scene,
    folder: str,
    names: Sequence[str],
    filter_glob: Glob = _FILES,
) -> None:
    """Choose the folder with the photographs, or some photographs in it."""
    settings, path = scene.fipt.photographs, Path(bpy.path.abspath(folder))
    if not folder or not path.is_dir():
        raise FiptError("photographs-missing.choose-photographs")
    settings.path, settings.chosen = str(path), "\n".join(names)
    settings.groups.clear()


class FIPT_FH_photographs(bpy.types.FileHandler):
    """Photographs dropped on the sidebar"""

    bl_idname = "FIPT_FH_photographs"
    bl_label = "Photographs of a Room"
    bl_import_operator = "fipt.choose_photographs"
    bl_file_extensions = ";".join(SUFFIXES)

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        return over_sidebar(context)


def _then_find_brackets(result: set[str]) -> set[str]:
    if result == {"FINISHED"} and bpy.ops.fipt.find_brackets.poll():
        bpy.ops.fipt.find_brackets("INVOKE_DEFAULT")
    return result


@action(
    "Make Capture of Photographs",
    needs=(needs(lambda context: context.scene.fipt.capture.path, "Choose a folder first"),),
    invoke=lambda self, context, event: _then_find_brackets(self.run(context)),
    listed=False,
)
def photographs_of_capture(scene: bpy.types.Scene) -> None:
    """Take the folder as photographs without cameras, and find which of them are exposures of one view."""
    state = scene.fipt
    state.photographs.path, state.photographs.chosen = state.capture.path, ""
    state.photographs.groups.clear()
    state.capture.path = ""
    running.settle("capture", "cameras-missing")


@action("Leave Photographs", listed=False)
def leave_photographs(scene: bpy.types.Scene) -> None:
    """Go back to the example and other folders. The files that were made of the photographs are kept."""
    for name in ("path", "chosen", "groups", "listed", "registered_count"):
        scene.fipt.photographs.property_unset(name)


def _task(
    title: str,
    scene: bpy.types.Scene,
    steps: str,
    before: Callable[[FIPT_PhotographsSettings, PreparationFolder], None] | None,
    finished: Callable[[bpy.types.Scene, PreparationFolder], None],
) -> Task:
    """Work in the folder of the capture, which needs no run folder.

    Args:
        title: for the user.
        scene: with the settings.
        steps: of `prepare`; all of them if empty.
        before: called before the job starts; may raise FiptError.
        finished: called after a success with each scene whose capture is made in this folder.
    """
    from ..prepare.preparation import PreparationFolder

    folder = PreparationFolder(scene.fipt.photographs.capture_folder() or Path())

    def make(scene: bpy.types.Scene) -> Job:
        from ..jobs.run_job import prepare_job

        settings = scene.fipt.photographs
        photographs = _photographs(settings)
        if before is not None:
            before(settings, folder)
        values = (f"--set={name}={value}" for name, value in settings.engine_settings().items())
        return prepare_job(photographs, folder.root, [f"--steps={steps}", *values])

    def ended(info: Job) -> None:
        if info.state == "finished":
            for scene in bpy.data.scenes:
                if scene.fipt.photographs.capture_folder() == folder.root:
                    finished(scene, folder)

    return Task(title, "photographs", make, folder=folder.root, ended=ended)


@action("Find Brackets", needs=(_has_folder, no_job), options=REGISTER)
def find_brackets(scene: bpy.types.Scene) -> Task:
    """Read the photographs' headers, and find which of them are exposures of the same view."""

    def finished(scene: bpy.types.Scene, folder: PreparationFolder) -> None:
        from ..blend.capture.brackets import list_groups, tick_chosen

        list_groups(scene.fipt.photographs, folder)
        tick_chosen(scene.fipt.photographs)

    return _task("Find Brackets", scene, "read", None, finished)


@action(
    "Make Capture",
    needs=(
        needs(
            lambda context: context.scene.fipt.photographs.used_count,
            "Use Find Brackets first, and tick groups",
        ),
        _has_folder,
        no_job,
    ),
    options=REGISTER,
)
def prepare(scene: bpy.types.Scene) -> Task:
    """Merge each group to an HDR image, and find the cameras. A stopped job continues where it was."""

    def finished(scene: bpy.types.Scene, folder: PreparationFolder) -> None:
        from ..blend.capture.brackets import list_groups

        list_groups(scene.fipt.photographs, folder)
        scene.fipt.capture.path = str(folder.root)

    return _task("Make Capture", scene, "", _write_groups, finished)


_has_groups = needs(lambda context: context.scene.fipt.photographs.groups, "Use Find Brackets first")
_has_merged = needs(
    lambda context: context.scene.fipt.photographs.groups, "Use Find Brackets and Make Capture first"
)


def _edit(settings: FIPT_PhotographsSettings, change: Callable[[list[Group]], list[Group]]) -> None:
    """Change the groups of the list."""
    from ..blend.capture.brackets import fill, listed_exposures, listed_groups

    exposures = listed_exposures(settings)
    fill(settings, change(listed_groups(settings)), exposures)
    settings.active_photograph = 0


@action("Split Group", needs=(_has_groups,))
def split_bracket(scene: bpy.types.Scene) -> None:
    """Divide the active group: its active photograph and those after it become a group of their own."""
    from ..prepare.preparation import split_group

    settings = scene.fipt.photographs
    _edit(settings, lambda groups: split_group(groups, settings.active_group, settings.active_photograph))


@action("Merge with Next Group", needs=(_has_groups,))
def merge_brackets(scene: bpy.types.Scene) -> None:
    """Join the active group and the one after it."""
    from ..prepare.preparation import merge_groups

    settings = scene.fipt.photographs
    _edit(settings, lambda groups: merge_groups(groups, settings.active_group))


@action("Open Report", options=REGISTER)
def open_photographs_report(scene: bpy.types.Scene) -> None:
    """Open the report on the photographs in the web browser."""
    folder = scene.fipt.photographs.capture_folder()
    page = None if folder is None else folder / "report" / "index.html"
    if page is None or not page.is_file():
        raise FiptError("report-missing.open-photographs-report")
    bpy.ops.wm.url_open(url=page.as_uri())


def _photographs(settings: FIPT_PhotographsSettings) -> Path:
    """The folder of the photographs."""
    folder = Path(bpy.path.abspath(settings.path)).absolute()
    if not settings.path or not folder.is_dir():
        raise FiptError(
            "photographs-missing.photographs",
            value=f"The folder {folder} does not exist." if settings.path else "No folder is chosen.",
        )
    return folder


def _write_groups(settings: FIPT_PhotographsSettings, folder: PreparationFolder) -> None:
    """Write the list's groups to prepare.json, unless somebody else has changed those in the file."""
    from dataclasses import replace

    from ..blend.capture.brackets import digest, list_groups, listed_groups
    from ..prepare.preparation import read_preparation, write_preparation

    preparation, groups = read_preparation(folder), listed_groups(settings)
    there, wanted = digest(preparation.groups), digest(groups)
    if there != settings.listed and (str(folder.root), there) not in _written:
        list_groups(settings, folder)
        raise FiptError("brackets-changed", prepare_json=folder.prepare_json)
    if there != wanted:
        write_preparation(folder, replace(preparation, groups=tuple(groups)))
    _written.add((str(folder.root), wanted))
    settings.listed = wanted


_TEXTS = ("Click: First point   Esc, Right Click: Cancel", "Click: Second point   Esc, Right Click: Cancel")


@action("Show Merged Image", needs=(_has_merged,), options=REGISTER)
def show_merged(context: bpy.types.Context) -> None:
    """Show the merged image of the active group in an Image Editor, to pick points in it."""
    settings = context.scene.fipt.photographs
    image = bpy.data.images.load(str(_merged(settings)), check_existing=True)
    area = _image_editor(context)
    if area is not None:
        area.spaces.active.image = image
        area.spaces.active.show_region_ui = True


class _PicksTwice(WaitsForClicks):
    """Base of an action on a view and two points of its image, which the artist clicks."""

    text_in_header = True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.properties.is_property_set("points"):
            return self.execute(context)
        from ..blend.capture.scale_picks import shown_group

        self.view = shown_group(context.space_data, context.scene.fipt.photographs)
        if not self.view:
            self.report({"ERROR"}, "Use Show Merged Image, and pick in the Image Editor.")
            return {"CANCELLED"}
        self._clicks: list[tuple[float, float]] = []
        return self.wait_for_clicks(context, _TEXTS[0])

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if is_cancel(event):
            self.cancel(context)
            return {"CANCELLED"}
        if event.type in (*NAVIGATION, *WHEEL, "MOUSEMOVE"):
            return {"PASS_THROUGH"}
        if not is_click(event):
            return {"RUNNING_MODAL"}
        place = _pixel_under(context, event)
        if place is None:
            self.report({"WARNING"}, "Click inside the image")
            return {"RUNNING_MODAL"}
        self._clicks.append(place)
        if len(self._clicks) < 2:
            self.say(context, _TEXTS[1])
            return {"RUNNING_MODAL"}
        self.points = (*self._clicks[0], *self._clicks[1])
        self.cancel(context)
        return self.execute(context)


@action("Pick Two Points", needs=(_has_merged,), bases=(_PicksTwice,), listed=False)
def pick_scale_points(
    scene: bpy.types.Scene,
    view: Annotated[str, "Name of the group"] = "",
    points: Annotated[
        tuple[float, ...], "Both points in pixels from the top left corner of the image: x, y, x, y"
    ] = (0.0,) * 4,
    extend: Annotated[
        bool, "Add another view of the same points, which makes their distance more exact"
    ] = False,
) -> None:
    """Click two points whose distance you know in the merged image that is shown."""
    from ..blend.capture.scale_picks import with_picks

    settings = scene.fipt.photographs
    if view not in settings.groups:
        raise FiptError("scale-view.pick-scale-points", view=view)
    if points[:2] == points[2:]:
        raise FiptError("scale-point.pick-scale-points")
    before = settings.scale_picks if extend else ""
    settings.scale_picks = with_picks(before, view, points[:2], points[2:])
    settings.scale = "points"


def _merged(settings: FIPT_PhotographsSettings) -> str:
    """The merged image of the active group."""
    folder = settings.capture_folder()
    if folder is not None and 0 <= settings.active_group < len(settings.groups):
        path = PreparationFolder(folder).image(Group(settings.groups[settings.active_group].name, ()))
        if path.is_file():
            return str(path)
    raise FiptError("image-missing.merged")


def _image_editor(context: bpy.types.Context) -> bpy.types.Area | None:
    """An Image Editor of an open window, or a new window with one; None in background."""
    windows = context.window_manager.windows
    for window in windows:
        for area in window.screen.areas:
            if area.ui_type == "IMAGE_EDITOR":
                return area
    if bpy.app.background:
        return None
    bpy.ops.wm.window_new()
    area = windows[-1].screen.areas[0]
    area.ui_type = "IMAGE_EDITOR"
    return area


def _pixel_under(context: bpy.types.Context, event: bpy.types.Event) -> tuple[float, float] | None:
    """Pixels from the top left corner of the shown image under the pointer, None outside of it."""
    area, image = context.area, context.space_data.image
    region = next(item for item in area.regions if item.type == "WINDOW")
    u, v = region.view2d.region_to_view(event.mouse_x - region.x, event.mouse_y - region.y)
    if not (0.0 <= u <= 1.0 and 0.0 <= v <= 1.0):
        return None
    return u * image.size[0], (1.0 - v) * image.size[1]
