"""Operators of the preferences: set up the engine, check it, show its log; the data folder."""

from __future__ import annotations

import sys
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import machine
from ..core.run.declared import Option
from ..core.run.errors import FiptError, as_message
from ..jobs import running
from ..jobs.tasks import Task
from ..panels.sidebar import size_text
from .action import HIDDEN, REGISTER, Action, action
from .polls import needs, no_job

if TYPE_CHECKING:
    from ..bridge.process import Message
    from ..bridge.step import Slices, Step
    from ..bridge.storage import Item


def _ask(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
    """State the size of the download before anything is downloaded, unless the button has done so."""
    from ..jobs import setup_size

    if bpy.app.background or machine.get_preferences().wheel_folder or self.confirmed:
        return self.run(context, wait=bpy.app.background)
    self.confirmed, size = True, setup_size.size()
    message = iface_("Downloads about {:.1f} GB and needs {:.1f} GB on the disk").format(
        size.download_gb, size.disk_gb
    )
    return context.window_manager.invoke_confirm(
        self, event, title=iface_(self.bl_label), message=message, confirm_text=iface_("Set Up")
    )


@action(
    "Set Up Engine",
    needs=(
        no_job,
        needs(
            lambda _: not machine.get_preferences().engine_python,
            "Clear Own Interpreter first; set-up is not needed while that is used",
        ),
        needs(
            lambda _: machine.get_preferences().wheel_folder or bpy.app.online_access,
            "Enable Allow Online Access in Preferences > System > Network, or select a Folder of Wheels",
        ),
    ),
    options=REGISTER,
    invoke=_ask,
    execute=lambda self, context: self.run(context, wait=not self.confirmed),
)
def set_up_engine(
    scene: bpy.types.Scene,
    confirmed: Annotated[bool, Option("Whether the size of the download was told", shown=HIDDEN)] = False,
) -> Task:
    """Create a Python environment for the engine and install its packages there. Blender's own Python is not
    changed. If you cancel, the finished downloads are kept.
    """
    from ..jobs.data_job import check_step, data_task, set_up_step, store_status

    def steps() -> list[Step]:
        values, data = machine.get_preferences(), machine.data_folder()
        wheels = Path(bpy.path.abspath(values.wheel_folder)) if values.wheel_folder else None
        if wheels is not None and not wheels.is_dir():
            raise FiptError("wheels-missing.steps", wheels=wheels)
        return [set_up_step(Path(sys.executable), data, values.device, wheels), check_step()]

    return data_task("Set Up Engine", steps, partial(store_status, set_up=True))


@action("Check", needs=(no_job,), options=REGISTER)
def check_engine(scene: bpy.types.Scene) -> Task:
    """Test the engine on this machine, and show what is missing and how to fix it."""
    from ..jobs.data_job import check_step, data_task, store_status

    return data_task("Check Engine", lambda: [check_step()], store_status)


@action("Copy Download Command", options=REGISTER)
def copy_wheel_command(context: bpy.types.Context) -> str:
    """Copy a command that downloads all packages into a folder. Run it on a machine that is online and has
    the same operating system, then select that folder here.
    """
    from ..bridge.pins import read_pins, wheel_command

    command = wheel_command(read_pins(), sys.version_info[:2])
    context.window_manager.clipboard = command
    return iface_("Copied to the clipboard: {}").format(command)


def used_paths() -> list[Path]:
    """Paths that the open .blend file and the running job use: run folders and unpacked external files."""
    paths = [scene.fipt.run_folder for scene in bpy.data.scenes]
    blocks = [*bpy.data.images, *bpy.data.movieclips, *bpy.data.cache_files, *bpy.data.libraries]
    paths += [block.filepath for block in blocks if not getattr(block, "packed_file", None)]
    used = [Path(bpy.path.abspath(path)).absolute() for path in paths if path]
    job = running.current()
    if job is not None and job.run_folder != machine.data_folder():
        used.append(job.run_folder.absolute())
    return used


class FIPT_PG_data_item(bpy.types.PropertyGroup):
    """A folder in the data folder, to delete or keep; `name` is the folder's."""

    ticked: bpy.props.BoolProperty(name="Clear", description="Delete this folder", default=True)
    note: bpy.props.StringProperty()
    kept: bpy.props.StringProperty(description="Why the folder can't be deleted; empty if it can")


class _TicksFolders(Action):
    """Base of an action on the names of folders, which a dialog lists to be ticked."""

    items: bpy.props.CollectionProperty(type=FIPT_PG_data_item, **HIDDEN)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        from ..bridge import storage

        if bpy.app.background:
            return self.execute(context)
        if self.names:
            return context.window_manager.invoke_confirm(self, event)
        self.items.clear()
        used = used_paths()
        for stored in storage.list_items(machine.data_folder()):
            item = self.items.add()
            item.name = stored.folder.name
            item.kept = storage.why_in_use(stored, used)
            item.ticked = not item.kept and not stored.current
            item.note = _describe(stored)
        return context.window_manager.invoke_props_dialog(self, width=640, confirm_text=iface_("Delete"))

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        if not self.items:
            layout.label(text="There is nothing to delete", icon="INFO")
            return
        layout.label(text="Delete the ticked folders permanently?", icon="TRASH")
        column = layout.box().column(align=True)
        for item in self.items:
            row = column.split(factor=0.45)
            row.enabled = not item.kept
            row.prop(item, "ticked", text=item.name, translate=False)
            row.label(text=iface_(item.kept) if item.kept else item.note, translate=False)
        if any("engine-" not in item.name for item in self.items):
            text = "Other .blend files lose the textures of these runs, unless the files have packed them"
            layout.label(text=text, icon="ERROR")

    def execute(self, context: bpy.types.Context) -> set[str]:
        from_dialog = bool(self.items) and not bpy.app.background and context.window is not None
        if from_dialog:
            self.names = ";".join(item.name for item in self.items if item.ticked and not item.kept)
            if not self.names:
                return {"CANCELLED"}
        return self.run(context, wait=not from_dialog)


@action("Clear Cached Data", needs=(no_job,), options=REGISTER, bases=(_TicksFolders,), listed=False)
def clear_data(
    scene: bpy.types.Scene,
    names: Annotated[
        str,
        "Names of the folders to delete, separated by semicolons. If empty, all runs that are not in use",
    ] = "",
) -> Task:
    """Select cached runs and engine environments to delete. Runs that the open file uses are kept."""
    from ..jobs.data_job import data_task

    return data_task("Clear Cached Data", lambda: [_clearing(names)])


def _clearing(names: str) -> Step:
    """The step of Clear Cached Data."""
    from ..bridge import storage
    from ..bridge.step import Step

    data, used = machine.data_folder(), used_paths()
    stored = {item.folder.name: item for item in storage.list_items(data)}
    runs = [name for name, item in stored.items() if item.kind == storage.RUN]
    unused = [name for name in runs if not storage.why_in_use(stored[name], used)]
    chosen = [name.strip() for name in names.split(";") if name.strip()] if names else unused
    unknown = [name for name in chosen if name not in stored]
    if unknown:
        raise FiptError("run-foreign.clearing", unknown=", ".join(unknown), data=data)
    if any(stored[name].current for name in chosen):
        machine.store_status({})

    def clear() -> Slices[list[Message]]:
        warnings: list[Message] = []
        for index, name in enumerate(chosen):
            try:
                for _ in storage.delete(stored[name], data, used):
                    yield index / len(chosen)
            except FiptError as error:
                warnings.append(as_message("warning", error))
        return warnings

    return Step("clear", "Deleting cached data", 5.0, function=clear)


def _describe(item: Item) -> str:
    """Size of a run, date and use of a folder, e.g. "2026-11-20 10:15, the engine's environment"."""
    from ..bridge.storage import ENVIRONMENT, size

    facts = [time.strftime("%Y-%m-%d %H:%M", time.localtime(item.modified))]
    if item.current:
        facts.append(iface_("the engine's environment"))
    elif item.kind == ENVIRONMENT:
        facts.append(iface_("an unused environment"))
    else:
        facts.insert(0, size_text(size(item.folder)))
    return ", ".join(facts)
