# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the preferences: how large runs and environments are, and clearing them."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import preferences, running
from ..core.job.errors import FiptError
from .job_operator import DataJobOperator

if TYPE_CHECKING:
    from ..bridge.process import Message
    from ..bridge.sequence import Job
    from ..bridge.step import Slices
    from ..bridge.storage import Item


def used_paths() -> list[Path]:
    """What the open .blend and the running job need: run folders, and files that are not packed."""
    paths = [scene.fipt.run_folder for scene in bpy.data.scenes]
    blocks = [*bpy.data.images, *bpy.data.movieclips, *bpy.data.cache_files, *bpy.data.libraries]
    paths += [block.filepath for block in blocks if not getattr(block, "packed_file", None)]
    found = [Path(bpy.path.abspath(path)).absolute() for path in paths if path]
    busy = running.current()
    if busy is not None and busy.run_folder != preferences.data_folder():
        found.append(Path(busy.run_folder).absolute())
    return found


def measure() -> Slices:
    """Measure every run and environment and keep the sizes with the preferences."""
    from ..bridge import storage

    items = storage.list_items(preferences.data_folder())
    sizes = {}
    for index, item in enumerate(items):
        for size in storage.measure(item.folder):
            sizes[item.folder.name] = size
            yield index / len(items)
    runs = [item.folder.name for item in items if item.kind == storage.RUN]
    preferences.store_usage({"time": time.time(), "sizes": sizes, "runs": runs})
    return None


class FIPT_OT_measure_data(DataJobOperator, bpy.types.Operator):
    """Measure how much the cached runs and the engine's environments take on the disk"""

    bl_idname = "fipt.measure_data"
    bl_label = "Measure"
    title = "Measure"

    def make_job(self) -> tuple[Job, Callable[[running.RunningJob], None]]:
        from ..bridge.step import Step
        from ..datajob import data_job

        step = Step("measure", "Measuring the data folder", 3.0, function=measure)
        return data_job([step]), lambda info: None


class FIPT_PG_data_item(bpy.types.PropertyGroup):
    """One folder in the data folder, to be cleared or kept; `name` is the folder's."""

    ticked: bpy.props.BoolProperty(name="Clear", description="Delete this folder", default=True)
    note: bpy.props.StringProperty()
    kept: bpy.props.StringProperty(description="Why it has to stay")


class FIPT_OT_clear_data(DataJobOperator, bpy.types.Operator):
    """Choose cached runs and engine environments to delete. Runs that the open file uses stay"""

    bl_idname = "fipt.clear_data"
    bl_label = "Clear Cached Data"
    title = "Clear Cached Data"

    names: bpy.props.StringProperty(
        name="Names",
        description="For scripts: names of the folders to delete, separated by semicolons; empty takes every"
        " run that is not in use",
        options={"SKIP_SAVE"},
    )
    items: bpy.props.CollectionProperty(type=FIPT_PG_data_item, options={"SKIP_SAVE", "HIDDEN"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        from ..bridge import storage

        if bpy.app.background:
            return self.execute(context)
        self.items.clear()
        used, sizes = used_paths(), preferences.usage().get("sizes", {})
        for found in storage.list_items(preferences.data_folder()):
            item = self.items.add()
            item.name = found.folder.name
            item.kept = storage.why_in_use(found, used)
            item.ticked = not item.kept and not found.current
            item.note = _describe(found, sizes.get(item.name))
        return context.window_manager.invoke_props_dialog(self, width=640, confirm_text=iface_("Delete"))

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        if not self.items:
            layout.label(text="There is nothing to clear", icon="INFO")
            return
        layout.label(text="Delete the ticked folders for good?", icon="TRASH")
        column = layout.box().column(align=True)
        for item in self.items:
            row = column.split(factor=0.45)
            row.enabled = not item.kept
            row.prop(item, "ticked", text=item.name, translate=False)
            row.label(text=iface_(item.kept) if item.kept else item.note, translate=False)
        if any("engine-" not in item.name for item in self.items):
            column = layout.column(align=True)
            column.scale_y = 0.8
            column.label(text="Other .blend files that use textures from a run lose them,", icon="ERROR")
            column.label(text="unless the textures are packed into the file", icon="BLANK1")

    def execute(self, context: bpy.types.Context) -> set[str]:
        # From a dialog it runs beside the user's work, as any job does.
        in_window = bool(self.items) and not bpy.app.background and context.window is not None
        return self._start(context, beside=in_window)

    def make_job(self) -> tuple[Job, Callable[[running.RunningJob], None]]:
        from ..bridge import storage
        from ..bridge.step import Step
        from ..datajob import data_job

        data, used = preferences.data_folder(), used_paths()
        known = {item.folder.name: item for item in storage.list_items(data)}
        if self.names:
            names = [name.strip() for name in self.names.split(";") if name.strip()]
        elif self.items:
            names = [item.name for item in self.items if item.ticked and not item.kept]
        else:
            names = [
                name
                for name, item in known.items()
                if item.kind == storage.RUN and not storage.why_in_use(item, used)
            ]
        foreign = [name for name in names if name not in known]
        if foreign:
            raise FiptError(
                "run-foreign",
                f"There is no run and no environment named {', '.join(foreign)} in {data}.",
                "Choose among those that the dialog lists.",
            )
        chosen = [known[name] for name in names]
        if any(item.current for item in chosen):
            preferences.store_status({})

        def clear() -> Slices:
            warnings: list[Message] = []
            for index, item in enumerate(chosen):
                try:
                    for _ in storage.delete(item, data, used):
                        yield index / len(chosen)
                except FiptError as error:
                    about = {"code": error.code, "text": error.text, "remedy": error.remedy}
                    warnings.append({"type": "warning", **about})
            return warnings

        steps = [Step("clear", "Deleting cached data", 5.0, function=clear)]
        steps.append(Step("measure", "Measuring the data folder", 3.0, function=measure))
        return data_job(steps), lambda info: None


def _describe(item: Item, size: int | None) -> str:
    """A line on a folder, e.g. "3.2 GB, 2026-11-20 10:15, the engine's environment"."""
    from ..bridge.storage import ENVIRONMENT

    words = [] if size is None else [format_size(size)]
    words.append(time.strftime("%Y-%m-%d %H:%M", time.localtime(item.modified)))
    if item.current:
        words.append(iface_("the engine's environment"))
    elif item.kind == ENVIRONMENT:
        words.append(iface_("an environment not in use"))
    return ", ".join(words)


def format_size(size: float) -> str:
    """A size for people, in powers of 1000."""
    return f"{size / 1e9:.1f} GB" if size >= 1e8 else f"{size / 1e6:.1f} MB"


CLASSES = (FIPT_PG_data_item, FIPT_OT_measure_data, FIPT_OT_clear_data)
