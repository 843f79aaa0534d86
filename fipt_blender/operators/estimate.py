"""Operators of the section Estimate: start, resume and cancel it; parts, versions, the example."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import machine
from ..api import applying, estimating
from ..core.run.declared import Option
from ..core.run.errors import warning
from ..core.run.runfolder import RunFolder, explained_write_errors
from ..core.run.settings import PRESETS
from ..jobs import running
from ..jobs.tasks import Task
from .action import HIDDEN, REGISTER, UNDO, Action, Messages, action, note
from .polls import has_no_capture, has_run, in_object_mode, needs, no_job, run_state

if TYPE_CHECKING:
    from ..bridge.job import Job

_can_start = (
    no_job,
    needs(lambda context: not context.mode.startswith("EDIT"), "Leave Edit Mode first"),
    needs(
        lambda context: len(context.scene.fipt.capture.views) or context.scene.fipt.run_folder,
        "Import a capture first, in the section Capture",
    ),
)


@action("Estimate", needs=_can_start, options=REGISTER)
def estimate(
    scene: bpy.types.Scene,
    keep: Annotated[
        bool,
        Option(
            "Keep finished stages of the last run that no change of room, views or settings affects",
            "Keep Stages",
        ),
    ] = False,
) -> Task:
    """Estimate the materials and lights of the room from its photographs. You can continue to work meanwhile;
    Esc stops it. Earlier results stay, in a run folder of their own.
    """
    return estimating.estimation(keep_stages=keep)


@action(
    "Resume",
    needs=(
        *_can_start,
        needs(
            lambda context: run_state(context).stages,
            "There is no stopped run to resume",
        ),
        needs(
            lambda context: not run_state(context).finished,
            "The last run is finished. Use Estimate to start a new one",
        ),
    ),
    options=REGISTER,
)
def resume(scene: bpy.types.Scene) -> Task:
    """Continue the last run where it was stopped. If room, views or settings have changed since, it starts
    again at the first stage that depends on the change.
    """
    return estimating.estimation(keep_stages=True, keep_hints=True)


class _FromWindow(Action):
    """Base of an action that reports from a window's event: Blender only prints what others report."""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self._timer = context.window_manager.event_timer_add(0.05, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self._timer)
        return self.execute(context)


@action("Show Notice", options={"INTERNAL"}, bases=(_FromWindow,))
def notice(
    scene: bpy.types.Scene,
    text: Annotated[str, Option("What is shown", shown=HIDDEN)] = "",
    level: Annotated[str, Option('"INFO" or "WARNING"', shown=HIDDEN)] = "INFO",
) -> Messages:
    """Show a text in the status bar and the Info editor."""
    return [warning("notice", text=text) if level == "WARNING" else note(text)]


def _stop_or_ask(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
    """Cancel at once, but ask first after a key, which may have been meant for something else."""
    from ..jobs import session
    from ..panels.progress import time_text

    job = running.current()
    if not self.by_key or job is None:
        return self.execute(context)
    if session.stops_playback(context.screen):
        return {"PASS_THROUGH"}
    message = iface_("It has been running for {}. Finished stages are kept for Resume.")
    return context.window_manager.invoke_confirm(
        self,
        event,
        title=iface_("Stop '{}'?").format(iface_(job.title)),
        message=message.format(time_text(job.worked_seconds)),
        confirm_text=iface_("Stop"),
    )


@action(
    "Cancel Job",
    needs=(
        needs(lambda _: running.current(), "No job is running"),
        needs(lambda _: not getattr(running.current(), "stopping", False), "The job is stopping already"),
    ),
    options=(),
    invoke=_stop_or_ask,
)
def cancel(
    scene: bpy.types.Scene,
    by_key: Annotated[
        bool, Option("Pressed as a shortcut, which may have been meant for something else", shown=HIDDEN)
    ] = False,
) -> None:
    """Stop the running job within two seconds. Finished stages are kept, and Resume continues from there."""
    running.cancel()


def _ask_before_quit(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
    job = running.current()
    title = "" if job is None else iface_("Quit and stop '{}'?").format(iface_(job.title))
    message = iface_("Finished stages are kept. Save the file, open it again and press Resume.")
    return context.window_manager.invoke_confirm(
        self, event, title=title, message=message, confirm_text=iface_("Quit")
    )


@action(
    "Quit During a Job",
    needs=(needs(lambda _: running.current(), "No job is running"),),
    options={"INTERNAL"},
    invoke=_ask_before_quit,
    listed=False,
)
def quit_during_job(context: bpy.types.Context) -> None:
    """Quit Blender, which stops the running job."""
    bpy.ops.wm.quit_blender("INVOKE_DEFAULT")


@action(
    "Use a Smaller Preset",
    needs=(
        needs(
            lambda context: smaller_preset_of(context.scene.fipt.estimate.preset) is not None,
            "Draft is the smallest preset. Use fewer or smaller photographs",
        ),
        *_can_start,
    ),
    listed=False,
)
def smaller_preset(scene: bpy.types.Scene) -> Task:
    """Select the next smaller preset, reset changed settings, and estimate again. Stages that are the same in
    both presets are kept.
    """
    settings = scene.fipt.estimate
    settings.preset = smaller_preset_of(settings.preset) or settings.preset
    settings.reset()
    return estimating.estimation(keep_stages=True)


@action("Reset to Preset", options={*UNDO, "INTERNAL"})
def reset_setting(
    scene: bpy.types.Scene,
    setting: Annotated[str, "Name of the setting. If empty, all settings are reset"] = "",
) -> None:
    """Reset this setting to the value of the preset."""
    scene.fipt.estimate.reset(*([setting] if setting else []))


def smaller_preset_of(preset: str) -> str | None:
    """The preset below one, or None."""
    names = list(PRESETS)
    index = names.index(preset)
    return names[index - 1] if index else None


@action(
    "Show Parts",
    needs=(
        needs(
            lambda context: context.scene.fipt.parts.counts,
            "Use Check Views first, in the section Capture; it finds the parts as well",
        ),
    ),
    options=REGISTER,
)
def show_parts(scene: bpy.types.Scene, show: Annotated[bool, "Show or hide the colors"] = True) -> None:
    """Display the parts of the room, each in its own color."""
    from ..blend.capture import overlay, survey

    survey.show_parts(scene) if show else overlay.hide()


Version = Annotated[str, Option("Name of its run folder", shown=HIDDEN)]


@action("Apply Version", needs=(no_job, has_run, in_object_mode), listed=False)
def use_version(scene: bpy.types.Scene, version: Version = "") -> Task:
    """Apply this estimate to the room; the scene goes on with its run folder."""
    return applying.version_change(version)


def _confirm(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
    return context.window_manager.invoke_confirm(
        self,
        event,
        title=iface_("Delete '{}'?").format(self.version),
        message=iface_("This can't be undone."),
        confirm_text=iface_("Delete"),
    )


@action(
    "Delete Version",
    needs=(needs(lambda context: running.current() is None, "Wait for the end of the running job"), has_run),
    options=REGISTER,
    invoke=_confirm,
    listed=False,
)
def delete_version(scene: bpy.types.Scene, version: Version = "") -> None:
    """Delete the run folder of this estimate from the disk. This can't be undone."""
    applying.delete_version(scene, version)


NAME = "Example Room"
FOLDER = "example"  # of the package, and of the data folder that gets its copy


@action("Try the Example", needs=(has_no_capture, in_object_mode, no_job))
def try_example(context: bpy.types.Context) -> Task:
    """Import a small room, estimate it and apply the results, in a scene of its own. Takes one to three
    minutes, because its 20 photographs have only 128 x 72 pixels.
    """
    from ..jobs.run_job import find_launch

    launch = find_launch()  # raises before anything is created
    if context.scene.objects and context.window is not None:
        context.window.scene = bpy.data.scenes.new(NAME)

    def make(scene: bpy.types.Scene) -> Job:
        from ..blend.capture.importing import import_capture
        from ..core.capture.options import CaptureOptions
        from ..jobs import scene_steps
        from ..jobs.run_job import open_job

        path = copy_example(machine.data_folder())
        scene.fipt.capture.path = str(path)
        scene.fipt.estimate.preset = "draft"
        settings = estimating.scene_settings(scene)
        run = RunFolder(machine.new_run_folder(NAME))
        run.create(settings)
        run.unsaved.write_text(str(path), encoding="utf-8")
        scene.fipt.run_folder = str(run.root)
        steps = [
            *scene_steps.import_steps(run, path, CaptureOptions(), partial(import_capture, run, str(path))),
            scene_steps.camera_step(run),
            *scene_steps.estimation_steps(run, settings, resume=False),
            *scene_steps.apply_steps(run, settings),
        ]
        return open_job(run, steps, launch, note=True)

    return Task("Example", "estimate", make, finished=applying.applied, undo=True)


def copy_example(data: Path) -> Path:
    """Copy the example to the data folder, since upgrades of the extension delete its own; its place."""
    import shutil

    from ..bridge.places import PACKAGE_FOLDER

    target = data / FOLDER
    with explained_write_errors(target):
        shutil.copytree(PACKAGE_FOLDER / FOLDER, target, dirs_exist_ok=True)
    return target
