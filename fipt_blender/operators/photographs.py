# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the section Photographs: choose them, find and correct brackets, make a capture of them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..core.capture.suffixes import SUFFIXES
from ..core.run.errors import FiptError
from ..jobs import running
from .job_operator import StartsJob
from .polls import all_of, needs, no_job, over_sidebar
from .reporting import reports_errors

if TYPE_CHECKING:
    from ..bridge.sequence import Job
    from ..prepare.preparation import Group, PreparationFolder
    from ..properties.photographs import FIPT_PhotographsSettings

# The groups that this session has written to prepare.json: folder and digest. After an undo the scene's list
# is an older one, which is no reason to think that somebody else has changed the file.
_written: set[tuple[str, str]] = set()


_has_folder = needs(
    lambda context: context.scene.fipt.photographs.path, "Choose the folder of the photographs first"
)


class _PrepareJob(StartsJob):
    """Base of both jobs: they work in the folder of the capture and need no run folder."""

    def make_job(
        self, settings: FIPT_PhotographsSettings, photographs: Path, folder: PreparationFolder
    ) -> Job:
        """The job, ready to run.

        Raises:
            FiptError: the job can't start.
        """
        raise NotImplementedError

    @staticmethod
    def finished(scene: bpy.types.Scene, folder: PreparationFolder) -> None:
        """Called after a success with each scene whose capture is made in this folder."""
        raise NotImplementedError

    def _begin(self, context: bpy.types.Context, wait: bool) -> running.RunningJob:
        from ..prepare.preparation import PreparationFolder

        settings, finished = context.scene.fipt.photographs, type(self).finished
        folder = PreparationFolder(settings.capture_folder() or Path())
        info = running.RunningJob(self.title, "photographs", "", folder.root)

        def end(info: running.RunningJob) -> None:
            if info.state == "finished":
                for scene in bpy.data.scenes:
                    if scene.fipt.photographs.capture_folder() == folder.root:
                        finished(scene, folder)

        try:
            job = self.make_job(settings, _photographs(settings), folder)
            return (running.run if wait else running.start)(job, info, end)
        except FiptError as error:
            running.refuse(info, error)
            raise


class FIPT_OT_choose_photographs(bpy.types.Operator):
    """Choose the folder with the photographs, or some photographs in it"""

    bl_idname = "fipt.choose_photographs"
    bl_label = "Choose Photographs"
    bl_options = {"REGISTER", "UNDO"}

    directory: bpy.props.StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE", "HIDDEN"})
    files: bpy.props.CollectionProperty(
        type=bpy.types.OperatorFileListElement, options={"SKIP_SAVE", "HIDDEN"}
    )
    filter_glob: bpy.props.StringProperty(
        default=";".join(f"*{suffix}" for suffix in SUFFIXES), options={"HIDDEN"}
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.directory:  # dropped files
            result = self.execute(context)
            if result == {"FINISHED"} and bpy.ops.fipt.find_brackets.poll():
                bpy.ops.fipt.find_brackets("INVOKE_DEFAULT")
            return result
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        folder = Path(bpy.path.abspath(self.directory))
        if not self.directory or not folder.is_dir():
            raise FiptError("photographs-missing", "No folder is chosen.", "Choose an existing folder.")
        settings = context.scene.fipt.photographs
        settings.path = str(folder)
        settings.chosen = "\n".join(file.name for file in self.files if file.name)
        settings.groups.clear()
        return {"FINISHED"}


class FIPT_FH_photographs(bpy.types.FileHandler):
    """Photographs dropped on the sidebar"""

    bl_idname = "FIPT_FH_photographs"
    bl_label = "Photographs of a Room"
    bl_import_operator = "fipt.choose_photographs"
    bl_file_extensions = ";".join(SUFFIXES)

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        return over_sidebar(context)


class FIPT_OT_photographs_of_capture(bpy.types.Operator):
    """Take the folder as photographs without cameras, and find which of them are exposures of one view"""

    bl_idname = "fipt.photographs_of_capture"
    bl_label = "Make Capture of Photographs"
    bl_options = {"REGISTER", "UNDO"}

    poll = all_of(needs(lambda context: context.scene.fipt.capture.path, "Choose a folder first"))

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        state = context.scene.fipt
        state.photographs.path, state.photographs.chosen = state.capture.path, ""
        state.photographs.groups.clear()
        state.capture.path = ""
        running.settle("capture", "cameras-missing")
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        result = self.execute(context)
        if result == {"FINISHED"} and bpy.ops.fipt.find_brackets.poll():
            bpy.ops.fipt.find_brackets("INVOKE_DEFAULT")
        return result


class FIPT_OT_leave_photographs(bpy.types.Operator):
    """Go back to the example and other folders. The files that were made of the photographs are kept"""

    bl_idname = "fipt.leave_photographs"
    bl_label = "Leave Photographs"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        settings = context.scene.fipt.photographs
        for name in ("path", "chosen", "groups", "listed", "registered_count"):
            settings.property_unset(name)
        return {"FINISHED"}


class FIPT_OT_find_brackets(_PrepareJob, bpy.types.Operator):
    """Read the photographs' headers, and find which of them are exposures of the same view"""

    bl_idname = "fipt.find_brackets"
    bl_label = "Find Brackets"
    title = "Find Brackets"

    poll = all_of(_has_folder, no_job)

    def make_job(
        self, settings: FIPT_PhotographsSettings, photographs: Path, folder: PreparationFolder
    ) -> Job:
        from ..jobs.prepare_job import make_prepare_job

        return make_prepare_job(photographs, folder, settings.engine_settings(), steps="read")

    @staticmethod
    def finished(scene: bpy.types.Scene, folder: PreparationFolder) -> None:
        from ..blend.capture.brackets import list_groups, tick_chosen

        list_groups(scene.fipt.photographs, folder)
        tick_chosen(scene.fipt.photographs)


class FIPT_OT_prepare(_PrepareJob, bpy.types.Operator):
    """Merge each group to an HDR image, and find the cameras. A stopped job continues where it was"""

    bl_idname = "fipt.prepare"
    bl_label = "Make Capture"
    title = "Make Capture"

    poll = all_of(
        needs(
            lambda context: context.scene.fipt.photographs.used_count,
            "Use Find Brackets first, and tick groups",
        ),
        _has_folder,
        no_job,
    )

    def make_job(
        self, settings: FIPT_PhotographsSettings, photographs: Path, folder: PreparationFolder
    ) -> Job:
        from ..jobs.prepare_job import make_prepare_job

        _write_groups(settings, folder)
        return make_prepare_job(photographs, folder, settings.engine_settings())

    @staticmethod
    def finished(scene: bpy.types.Scene, folder: PreparationFolder) -> None:
        from ..blend.capture.brackets import list_groups

        list_groups(scene.fipt.photographs, folder)
        scene.fipt.capture.path = str(folder.root)


class _EditsGroups:
    """Base of the operators that change the list."""

    bl_options = {"REGISTER", "UNDO"}

    poll = all_of(needs(lambda context: context.scene.fipt.photographs.groups, "Use Find Brackets first"))

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.capture.brackets import fill, listed_exposures, listed_groups

        settings = context.scene.fipt.photographs
        exposures = listed_exposures(settings)
        fill(settings, self.edited(listed_groups(settings), settings), exposures)
        settings.active_photograph = 0
        return {"FINISHED"}

    def edited(self, groups: list[Group], settings: FIPT_PhotographsSettings) -> list[Group]:
        """The groups after the change."""
        raise NotImplementedError


class FIPT_OT_split_bracket(_EditsGroups, bpy.types.Operator):
    """Divide the active group: its active photograph and those after it become a group of their own"""

    bl_idname = "fipt.split_bracket"
    bl_label = "Split Group"

    def edited(self, groups: list[Group], settings: FIPT_PhotographsSettings) -> list[Group]:
        from ..prepare.editing import split_group

        return split_group(groups, settings.active_group, settings.active_photograph)


class FIPT_OT_merge_brackets(_EditsGroups, bpy.types.Operator):
    """Join the active group and the one after it"""

    bl_idname = "fipt.merge_brackets"
    bl_label = "Merge with Next Group"

    def edited(self, groups: list[Group], settings: FIPT_PhotographsSettings) -> list[Group]:
        from ..prepare.editing import merge_groups

        return merge_groups(groups, settings.active_group)


class FIPT_OT_open_photographs_report(bpy.types.Operator):
    """Open the report on the photographs in the web browser"""

    bl_idname = "fipt.open_photographs_report"
    bl_label = "Open Report"

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        folder = context.scene.fipt.photographs.capture_folder()
        page = None if folder is None else folder / "report" / "index.html"
        if page is None or not page.is_file():
            raise FiptError("report-missing", "There is no report yet.", "Use Make Capture first.")
        bpy.ops.wm.url_open(url=page.as_uri())
        return {"FINISHED"}


def _photographs(settings: FIPT_PhotographsSettings) -> Path:
    """The folder of the photographs.

    Raises:
        FiptError: ``photographs-missing``.
    """
    folder = Path(bpy.path.abspath(settings.path)).absolute()
    if not settings.path or not folder.is_dir():
        raise FiptError(
            "photographs-missing",
            f"The folder {folder} does not exist." if settings.path else "No folder is chosen.",
            "Choose the folder of the photographs.",
        )
    return folder


def _write_groups(settings: FIPT_PhotographsSettings, folder: PreparationFolder) -> None:
    """Write the list's groups to prepare.json, unless somebody else has changed those in the file.

    Raises:
        FiptError: ``brackets-changed``; those of `read_preparation` and `write_preparation`.
    """
    from dataclasses import replace

    from ..blend.capture.brackets import digest, list_groups, listed_groups
    from ..prepare.preparation import read_preparation, write_preparation

    preparation, groups = read_preparation(folder), listed_groups(settings)
    there, wanted = digest(preparation.groups), digest(groups)
    if there != settings.listed and (str(folder.root), there) not in _written:
        list_groups(settings, folder)
        raise FiptError(
            "brackets-changed",
            f"The groups in {folder.prepare_json} are not those that were listed.",
            "The list now shows the file's groups. Check them, and use Make Capture again.",
        )
    if there != wanted:
        write_preparation(folder, replace(preparation, groups=tuple(groups)))
    _written.add((str(folder.root), wanted))
    settings.listed = wanted
